//! `consort cancel`: cancels a mission.

use super::mission_action::MissionActionFlags;
use crate::exit::Failure;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::MissionState;

/// Cancel a mission
///
/// Its robots stop safely and become free. A mission that has ended keeps its result.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort cancel lab-samples-1
  consort cancel lab-samples-1 --by 'ward 3, Nia'")]
pub struct Args {
    #[command(flatten)]
    on_word: MissionActionFlags,
}

/// Runs the command.
///
/// # Errors
/// See `Client::api`; a mission that has ended otherwise, or does not
/// exist, is [`Failure::Unsuccessful`].
pub fn run(args: Args) -> Result<(), Failure> {
    args.on_word.request(ApiCall::Cancel, |state| state.map_or("canceled", MissionState::as_str))
}
