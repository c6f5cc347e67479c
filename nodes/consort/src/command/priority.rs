//! `consort priority`: changes the priority of a mission.

use super::change_flags::ChangeFlags;
use super::flag_values;
use crate::exit::Failure;
use consort_protocol::api::{PriorityReply, PriorityRequest};
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::Priority;

/// Change the priority of a mission that waits or runs
///
/// Missions with a higher priority get free robots first, and a robot starts the promised roles of such missions first.
/// Roles that robots hold stay with them.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort priority lab-samples-1 50
  consort priority lab-samples-1 -10 --by Nia")]
pub(crate) struct Args {
    /// The mission, as named by `consort missions`
    mission: MissionId,
    /// Order in which missions are served: -100 to 100, higher first
    #[arg(value_name = "NUMBER", allow_negative_numbers = true, value_parser = flag_values::priority)]
    priority: Priority,
    #[command(flatten)]
    change: ChangeFlags,
}

/// Runs the command.
///
/// # Errors
/// See [`Client::api`](crate::client::Client::api); a mission that has ended, or does not exist, is
/// [`Failure::Unsuccessful`].
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let Args { mission, priority, change } = args;
    let priority = priority.get().into();
    change.send(
        ApiCall::Priority,
        |by, request| PriorityRequest { mission, priority, by, request },
        |PriorityReply { mission, priority }: &PriorityReply| match priority {
            Some(priority) => format!("{mission} has priority {}", priority.get()),
            None => format!("{mission} has ended"),
        },
    )
}
