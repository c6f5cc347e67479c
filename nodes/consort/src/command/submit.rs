//! `consort submit`: submits a mission.

use super::flag_values::{InvalidValue, parse_duration};
use super::flags::MissionFlags;
use crate::client::{Client, ClientFlags, new_request_id, read_answer};
use crate::exit::Failure;
use crate::{node_runtime, output};
use consort_protocol::api::{MissionQuery, StartTime, SubmitReply, SubmitRequest};
use consort_protocol::ids::{MissionId, RequestId};
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::MissionState;
use consort_protocol::view::{MissionBrief, MissionView};
use serde_json::{Map, Value};
use std::env;
use std::time::Duration;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Submit a mission
///
/// The request is acknowledged after the mission is committed to the ledger; from then on it
/// survives the failure of any node. The same --request returns the same mission until a day after
/// its end, so a request may be repeated safely. If there is no reply, the command prints how to repeat it.
///
/// With --json there is a line for the reply, with the mission and the request; with --wait a
/// second line with the final state after the mission has ended.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort submit lab-samples --set room='IC Room 6'
  consort submit lab-samples --set room='PC Room 3' --request order-7 --wait
  consort submit lab-samples --priority 10 --deadline 900
  consort submit lab-samples --not-before 2026-11-27T08:00:00+01:00
  consort submit lab-samples --not-before 15m
  consort submit my-mission.yaml --connect tcp/192.0.2.7:7447
  consort submit rounds                      # a mission of the fleet file
  consort submit my-ihtn.json --person nurse")]
pub(crate) struct Args {
    #[command(flatten)]
    mission: MissionFlags,
    /// A name for the request, for safe repetition. Default: a UUID of version 7
    #[arg(long, value_name = "ID")]
    request: Option<RequestId>,
    /// Give no robot a role and ask no person before this time: a date and time, or the time from now
    ///
    /// A date and time is written as in RFC 3339 (2026-11-27T08:00:00+01:00, or Z for UTC), a time
    /// from now with s, m, h or d. The clocks of a majority of the voters decide.
    #[arg(long, value_name = "TIME", value_parser = start_time)]
    not_before: Option<StartTime>,
    /// Wait until the mission has ended, and fail if it does not complete
    #[arg(long)]
    wait: bool,
    /// Print JSON, an object per line
    #[arg(long)]
    json: bool,
    /// Name of the person who asks, for the record. In a closed fleet the name in your certificate is
    /// recorded, too
    #[arg(long, env = "CONSORT_BY", value_name = "NAME")]
    by: Option<String>,
    #[command(flatten)]
    client: ClientFlags,
}

/// Poll interval while waiting for a mission.
const LOOK: Duration = Duration::from_millis(500);

/// Runs the command.
///
/// # Errors
/// See [`Client::api`]; without a reply the error contains the command that repeats the request.
/// [`Failure::Unsuccessful`] if the command waits for the mission and the mission does not
/// complete.
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let name = args.request.clone().unwrap_or_else(new_request_id);
    let request = SubmitRequest {
        request: Some(name.clone()),
        not_before: args.not_before.clone(),
        by: args.by.clone(),
        ..args.mission.request()?
    };
    node_runtime::build_runtime()?.block_on(async {
        let mut client = Client::open(&args.client).await?;
        let ended = submit(&mut client, &args, &name, &request).await;
        client.close().await;
        ended
    })
}

async fn submit(client: &mut Client, args: &Args, name: &RequestId, request: &SubmitRequest) -> Result<(), Failure> {
    let words = || env::args_os().map(|word| word.to_string_lossy().into_owned());
    let repeat_command = || repeat_command(words(), args.request.is_none(), name.as_str());
    let answer = client.api(ApiCall::Submit, request).await.map_err(|failure| match failure {
        Failure::Unreachable(problem) => Failure::Unreachable(format!(
            "{problem}\nIt is unknown if request {name} was accepted. It can be repeated safely: it creates a single mission, \
             however often it is sent:\n  {}",
            repeat_command()
        )),
        other => other,
    })?;
    let Ok(SubmitReply { mission: id, again, .. }) = read_answer(&answer) else {
        return Err(Failure::Unsuccessful(format!("the coordinator answered {answer}")));
    };
    if args.json {
        let mut fields = read_answer::<Map<String, Value>>(&answer)?;
        fields.insert("request".to_owned(), name.as_str().into());
        output::line(Value::Object(fields))?;
    } else {
        output::line(format_args!("{id}{}", if again { " (requested before)" } else { "" }))?;
    }
    if !args.wait {
        return Ok(());
    }
    wait(client, &id, args.json).await.map_err(|failure| match failure {
        Failure::Unreachable(problem) => Failure::Unreachable(format!(
            "{problem}\n{id} was acknowledged, and is not lost; its end was not received. To wait for it again:\n  {}",
            repeat_command()
        )),
        other => other,
    })
}

/// Returns the command line that repeats the request: the given words and, if they lack it, the
/// request's name.
fn repeat_command(words: impl Iterator<Item = String>, add_request: bool, name: &str) -> String {
    let mut words: Vec<String> = words.collect();
    if add_request {
        // Directly after the subcommand's name, where no other flag expects a value.
        let behind = words.iter().position(|word| word == "submit").map_or(words.len(), |at| at + 1);
        words.splice(behind..behind, ["--request".to_owned(), name.to_owned()]);
    }
    shlex::try_join(words.iter().map(String::as_str)).expect("the words of a command line hold no NUL")
}

fn start_time(text: &str) -> Result<StartTime, InvalidValue> {
    if let Ok(time) = parse_duration(text) {
        return Ok(StartTime::In(time.as_secs_f64()));
    }
    let is_date = OffsetDateTime::parse(text, &Rfc3339).is_ok();
    is_date.then(|| StartTime::At(text.to_owned())).ok_or_else(|| {
        InvalidValue::new(format_args!(
            "{text:?} is no time; allowed is a date and time with its offset, as 2026-11-27T08:00:00+01:00, or a time from \
             now, as 15m"
        ))
    })
}

async fn wait(client: &mut Client, id: &MissionId, in_json: bool) -> Result<(), Failure> {
    loop {
        let answer = client.api(ApiCall::Get, &MissionQuery { mission: id.clone(), linearizable: false }).await?;
        let MissionView { brief: MissionBrief { status, progress, result, .. }, auction, .. } = read_answer(&answer)?;
        let state = status.detail.as_str().replace('_', " ");
        if !matches!(status.detail, MissionState::Pending | MissionState::Running) {
            client.progress().clear();
            if in_json {
                output::line(&answer)?;
            } else {
                output::line(format_args!("{id} {state}"))?;
                for (name, value) in result {
                    output::line(format_args!("  {name}: {value}"))?;
                }
            }
            return match &status.detail {
                MissionState::Completed => Ok(()),
                detail => Err(Failure::Unsuccessful(format!("{id} {state}{}", super::missions::detail(detail)))),
            };
        }
        let why = auction.and_then(|auction| auction.failure).filter(|_| status.detail == MissionState::Pending);
        let why = why.map(|why| format!(" ({why})")).unwrap_or_default();
        client.progress().show(format_args!("{id} {state}{why}: {} of {} steps", progress.done, progress.steps));
        tokio::time::sleep(LOOK).await;
    }
}

#[cfg(test)]
mod tests {
    use super::repeat_command;

    fn line(words: &[&str], add_request: bool) -> String {
        repeat_command(words.iter().map(|word| (*word).to_owned()), add_request, "cli-7")
    }

    #[test]
    fn the_repeat_command_has_the_request_once_and_is_quoted_for_a_shell() {
        let words = ["consort", "submit", "lab-samples", "--set", "room=IC Room 6", "--connect", "tcp/[::1]:7447"];
        assert_eq!(
            line(&words, true),
            "consort submit --request cli-7 lab-samples --set 'room=IC Room 6' --connect 'tcp/[::1]:7447'"
        );
        let words = ["./consort", "submit", "--request", "cli-7", "--", "Nia's file.yaml"];
        assert_eq!(line(&words, false), r#"./consort submit --request cli-7 -- "Nia's file.yaml""#);
    }
}
