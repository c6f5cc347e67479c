//! `consort explain`: why each robot did or did not get each role of a mission.

use crate::client::{Client, QueryFlags};
use crate::exit::Failure;
use consort_protocol::keys::ApiCall;
use serde_json::{Value, json};

/// Say why each robot did or did not get each role of a mission
///
/// From the mission's latest auction: who won and by how much, who was outbid, whose bid could not be taken, who refused and
/// why, who is not a member; and from whom a role was taken since. With --json the same as values.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort explain lab-samples-1
  consort explain lab-samples-1 --json --connect tcp/192.0.2.7:7447")]
pub struct Args {
    /// The mission
    mission: String,
    #[command(flatten)]
    ask: QueryFlags,
}

/// Runs the command.
///
/// # Errors
/// As [`Client::api`]; a mission that is not there is [`Failure::Unsuccessful`].
pub fn run(args: Args) -> Result<(), Failure> {
    let Args { mission, ask } = args;
    ask.print(
        async |client: &mut Client| client.api(ApiCall::Explain, &json!({ "mission": mission })).await,
        |answer| {
            let lines = answer["words"].as_array().into_iter().flatten().filter_map(Value::as_str);
            lines.collect::<Vec<_>>().join("\n")
        },
    )
}
