//! `consort rescue`: say that what a mission left in robots' hands has been taken care of.

use super::mission_action::MissionActionFlags;
use crate::exit::Failure;
use consort_protocol::keys::ApiCall;

/// Close a mission that needs rescue
///
/// Say so when what it left in robots' hands has been taken care of: the mission is then failed, with the name of whoever
/// closed it, and its robots are given work again. `consort missions` says what is where.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort rescue lab-samples-1 --by 'ward 3, Nia'")]
pub struct Args {
    #[command(flatten)]
    on_word: MissionActionFlags,
}

/// Runs the command.
///
/// # Errors
/// As [`Client::api`](crate::client::Client::api); a mission that does not need rescue, or is not there, is
/// [`Failure::Unsuccessful`].
pub fn run(args: Args) -> Result<(), Failure> {
    args.on_word.request(ApiCall::Resolve, |_| "closed".to_owned())
}
