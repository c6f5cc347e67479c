//! `consort resolve`: closes a mission after its items were taken care of by hand.

use super::mission_action::MissionActionFlags;
use crate::exit::Failure;
use consort_protocol::keys::ApiCall;

/// Close a mission that needs intervention
///
/// Use it after the items in robots' hands have been taken care of: the mission is then failed,
/// with the name of the person, and its robots become available again. `consort missions` shows the
/// items and their places.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort resolve lab-samples-1 --by 'ward 3, Nia'")]
pub(crate) struct Args {
    #[command(flatten)]
    on_word: MissionActionFlags,
}

/// Runs the command.
///
/// # Errors
/// See [`Client::api`](crate::client::Client::api); a mission that does not need intervention, or
/// does not exist, is [`Failure::Unsuccessful`].
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    args.on_word.request(ApiCall::Resolve, |_| "closed")
}
