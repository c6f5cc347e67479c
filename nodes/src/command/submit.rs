//! `consort submit`: ask the fleet for a mission.

use super::flags::key_value;
use crate::client::{Client, ClientFlags};
use crate::exit::Failure;
use crate::{output, running, source};
use consort_protocol::ids::RequestId;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::{Priority, time_until_deadline};
use rand::TryRng;
use rand::rngs::SysRng;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::Duration;

/// Ask the fleet for a mission
///
/// The request is answered once the mission is committed to the ledger; from then on it is not lost, whoever dies. The
/// same --request again gets the same mission again, so that a request may be repeated safely.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort submit lab-samples --set room='IC Room 6'
  consort submit lab-samples --set room='PC Room 3' --request order-7 --wait
  consort submit lab-samples --priority 10 --deadline 900
  consort submit my-mission.yaml --connect tcp/192.0.2.7:7447")]
pub struct Args {
    /// The mission: the name of one that is shipped (lab-samples, …) or a file
    #[arg(value_name = "FILE|NAME")]
    mission: String,
    /// A parameter of the mission; may be repeated
    #[arg(long = "set", value_name = "NAME=VALUE", value_parser = key_value)]
    parameters: Vec<(String, String)>,
    /// A name for the request, by which it may be repeated safely. Default: one by chance
    #[arg(long, value_name = "ID")]
    request: Option<RequestId>,
    /// Which of several waiting missions is served first: -100 to 100, higher first
    #[arg(long, value_name = "NUMBER", default_value = "0", allow_negative_numbers = true, value_parser = priority)]
    priority: Priority,
    /// Give the mission up if it is not done after so many seconds, by the coordinators' wall clocks. Default: never
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, value_parser = deadline)]
    deadline: Option<f64>,
    /// Wait until the mission has ended, and fail if it does not complete
    #[arg(long)]
    wait: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    client: ClientFlags,
}

/// How often a mission that is waited for is looked at.
const LOOK: Duration = Duration::from_millis(500);

/// Runs the command.
///
/// # Errors
/// As [`Client::api`]; [`Failure::Unsuccessful`] if the mission is waited for and does not complete.
pub fn run(args: Args) -> Result<(), Failure> {
    let mission = source::mission_request(&args.mission)?;
    let parameters: BTreeMap<&str, &str> = args.parameters.iter().map(|(k, v)| (k.as_str(), v.as_str())).collect();
    let request = args.request.as_ref().map_or_else(by_chance, ToString::to_string);
    let mut request = json!({ "mission": mission, "parameters": parameters, "request": request });
    request["priority"] = json!(args.priority.get());
    if let Some(deadline) = args.deadline {
        request["deadline_s"] = json!(deadline);
    }
    running::runtime()?.block_on(async {
        let mut client = Client::open(&args.client).await?;
        let answer = client.api(ApiCall::Submit, &request).await?;
        let Some(id) = answer.get("mission").and_then(Value::as_str) else {
            return Err(Failure::Unsuccessful(format!("the coordinator answered {answer}")));
        };
        if args.json && !args.wait {
            output::line(&answer)?;
        } else if !args.json {
            let again = answer.get("again") == Some(&Value::Bool(true));
            output::line(format_args!("{id}{}", if again { " (asked for before)" } else { "" }))?;
        }
        let ended = if args.wait { wait(&mut client, id, args.json).await } else { Ok(()) };
        client.close().await;
        ended
    })
}

fn priority(text: &str) -> Result<Priority, String> {
    let number = text.parse().map_err(|_| format!("{text:?} is no whole number; allowed are -100 to 100"))?;
    Priority::new(number).map_err(|problem| problem.to_string())
}

fn deadline(text: &str) -> Result<f64, String> {
    let number = text.parse().map_err(|_| format!("{text:?} is no number of seconds from now"))?;
    time_until_deadline(number).map(|_| number).map_err(|problem| problem.to_string())
}

fn by_chance() -> String {
    let number = SysRng.try_next_u64().expect("the system has random numbers");
    format!("cli-{number:016x}")
}

async fn wait(client: &mut Client, id: &str, in_json: bool) -> Result<(), Failure> {
    loop {
        let mission = client.api(ApiCall::Get, &json!({ "mission": id })).await?;
        let state = mission.get("state").and_then(Value::as_str).unwrap_or("unknown");
        let number = |key: &str| mission.get(key).and_then(Value::as_u64).unwrap_or(0);
        if !["pending", "running"].contains(&state) {
            client.waiting().clear();
            if in_json {
                output::line(&mission)?;
            } else {
                output::line(format_args!("{id} {}", state.replace('_', " ")))?;
            }
            let state = state.replace('_', " ");
            let detail = mission.get("detail").map(super::missions::detail).unwrap_or_default();
            return match state.as_str() {
                "completed" => Ok(()),
                _ => Err(Failure::Unsuccessful(format!("{id} {state}{detail}"))),
            };
        }
        let why = mission.pointer("/auction/failure").and_then(Value::as_str).filter(|_| state == "pending");
        let why = why.map(|why| format!(" ({why})")).unwrap_or_default();
        client.waiting().say(format_args!("{id} {state}{why}: {} of {} steps", number("done"), number("steps")));
        tokio::time::sleep(LOOK).await;
    }
}
