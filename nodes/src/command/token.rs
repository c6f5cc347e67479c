//! `consort token`: what a person shows to the pages of a closed fleet.

use crate::certs::{read_fleet_of_authority, unix_time};
use crate::command::duration::parse_duration;
use crate::exit::Failure;
use crate::output;
use crate::trust::person_keyring;
use consort_actors::clock::Clock;
use consort_protocol::trust::{AccessScope, Principal};
use std::path::PathBuf;
use std::time::Duration;

/// Make a token for the dashboard, its API and the metrics of a closed fleet
///
/// Browsers and programs that speak HTTP show no certificate. They show a token instead, which this command signs with your key:
/// it says who you are, what it is good for and until when. No node and no authority is asked, and nothing is kept; it ends with
/// its time, or when your certificate ends or is revoked. Whoever has it is you for that long: give it the least scope that does.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Args {
    /// The folder with your certificate and key, as `consort cert person` makes it
    #[arg(long, env = "CONSORT_CERTS", value_name = "DIR")]
    certs: PathBuf,
    /// What it is good for: read; submit (and cancel) missions; operate (close rescues). Default: all that your certificate lets you do
    #[arg(long, value_name = "SCOPE")]
    scope: Option<AccessScope>,
    /// How long it is good: a number and s, m, h or d
    #[arg(long = "for", value_name = "TIME", default_value = "12h", value_parser = parse_duration)]
    time: Duration,
    /// Print a link to this dashboard that brings the token along, instead of the token alone
    #[arg(long, value_name = "URL")]
    link: Option<String>,
}

const EXAMPLES: &str = "\
Examples:
  # paste it where the dashboard asks for it
  consort token --certs certs/kim

  # or open the page with it; what stands behind # is not sent to anybody by the browser
  xdg-open \"$(consort token --certs certs/kim --link http://127.0.0.1:8088/)\"

  # a program
  curl -H \"Authorization: Bearer $(consort token --certs certs/kim --scope read --for 10m)\" http://127.0.0.1:8088/api/picture

  # Prometheus (authorization: { credentials_file: … })
  consort token --certs certs/prometheus --scope read --for 30d > consort.token";

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] names the file that is wrong, or says why there can be no such token.
pub fn run(args: Args) -> Result<(), Failure> {
    let Args { certs, scope, time, link } = args;
    let fleet = read_fleet_of_authority(&certs.join("ca.pem"))?;
    let (keyring, files) = person_keyring(&certs, &fleet, Clock::real())?;
    let wrong = |problem: String| Failure::Usage(format!("{}: {problem}", files.certificate.display()));
    let own = match &keyring.identity().principal {
        Principal::Person { scope, .. } => *scope,
        node @ Principal::Node { .. } => return Err(wrong(format!("it is {node}'s, and tokens are people's"))),
    };
    let made = keyring.issue_token(scope.unwrap_or(own), unix_time() + time);
    let token = made.map_err(|problem| wrong(problem.to_string()))?;
    match link {
        None => output::line(token),
        Some(page) => output::line(format_args!("{}/#token={token}", page.trim_end_matches('/'))),
    }
}
