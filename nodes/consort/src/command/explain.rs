//! `consort explain`: explains the assignment of each role of a mission.

use crate::client::{Client, QueryFlags};
use crate::exit::Failure;
use consort_protocol::api::{ExplainReply, MissionQuery};
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;

/// Explain why each robot did or did not get each role of a mission
///
/// Uses the mission's latest auction: the winner and its margin, the outbid robots, the bids that
/// could not be accepted, the refusals with their reasons, and the nodes that are not members; also
/// the roles that were taken from a robot since. With --json the same as values.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort explain lab-samples-1
  consort explain lab-samples-1 --json --connect tcp/192.0.2.7:7447")]
pub(crate) struct Args {
    /// The mission
    mission: MissionId,
    #[command(flatten)]
    ask: QueryFlags,
}

/// Runs the command.
///
/// # Errors
/// See [`Client::api`]; a mission that does not exist is [`Failure::Unsuccessful`].
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let Args { mission, ask } = args;
    ask.print(
        async |client: &mut Client| client.api(ApiCall::Explain, &MissionQuery { mission, linearizable: false }).await,
        |answer: &ExplainReply| answer.text.join("\n"),
    )
}
