//! `consort token`: makes a token for the HTTP pages of a closed fleet.

use super::flag_values::parse_duration;
use crate::certs::{read_fleet_of_authority, unix_time};
use crate::exit::Failure;
use crate::output;
use crate::trust::person_keyring;
use consort_bus::clock::Clock;
use consort_protocol::trust::{AccessScope, Principal};
use std::path::PathBuf;
use std::time::Duration;

/// Make a token for the dashboard, its API and the metrics of a closed fleet
///
/// HTTP clients do not use certificates. They use a token instead, which this command signs with
/// your key. The token contains your name, its scope and its expiry. No node and no authority is
/// contacted, and nothing is stored. It ends when it expires, or when your certificate expires or
/// is revoked. Its holder has your permissions for that time: give it the smallest sufficient
/// scope.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    /// The folder with your certificate and key, as written by `consort cert person`
    #[arg(long, env = "CONSORT_CERTS", value_name = "DIR")]
    certs: PathBuf,
    /// Scope: read; submit (and cancel) missions; operate (resolve missions). Default: the scope of
    /// your certificate
    #[arg(long, value_name = "SCOPE")]
    scope: Option<AccessScope>,
    /// Validity: a number and s, m, h or d
    #[arg(long = "for", value_name = "TIME", default_value = "12h", value_parser = parse_duration)]
    time: Duration,
    /// Print a link to this dashboard that contains the token, instead of the token alone
    #[arg(long, value_name = "URL")]
    link: Option<String>,
}

const EXAMPLES: &str = "\
Examples:
  # paste it into the dashboard's dialog
  consort token --certs certs/kim

  # or open the page with it; the browser does not send the part after #
  xdg-open \"$(consort token --certs certs/kim --link http://127.0.0.1:8088/)\"

  # a program
  curl -H \"Authorization: Bearer $(consort token --certs certs/kim --scope read --for 10m)\" http://127.0.0.1:8088/api/fleet

  # Prometheus (authorization: { credentials_file: … })
  consort token --certs certs/prometheus --scope read --for 30d > consort.token";

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] with the wrong file, or the reason why there can be no such token.
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let Args { certs, scope, time, link } = args;
    let fleet = read_fleet_of_authority(&certs.join("ca.pem"))?;
    let (keyring, files) = person_keyring(&certs, &fleet, Clock::real())?;
    let wrong = |problem: String| Failure::Usage(format!("{}: {problem}", files.certificate.display()));
    let own = match &keyring.identity().principal {
        Principal::Person { scope, .. } => *scope,
        node @ Principal::Node { .. } => {
            return Err(wrong(format!("it belongs to {node}, and only people have tokens")));
        }
    };
    let token = keyring.issue_token(scope.unwrap_or(own), unix_time() + time);
    let token = token.map_err(|problem| wrong(problem.to_string()))?;
    match link {
        None => output::line(token),
        Some(page) => output::line(format_args!("{}/#token={token}", page.trim_end_matches('/'))),
    }
}
