//! `consort cancel`: withdraw a mission.

use super::mission_action::MissionActionFlags;
use crate::exit::Failure;
use consort_protocol::keys::ApiCall;
use serde_json::Value;

/// Withdraw a mission
///
/// Its robots stop safely and are free again. A mission that has ended stays as it ended.
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
/// As [`Client::api`](crate::client::Client::api); a mission that has ended otherwise, or is not there, is
/// [`Failure::Unsuccessful`].
pub fn run(args: Args) -> Result<(), Failure> {
    args.on_word.request(ApiCall::Cancel, |state| {
        let word = state.as_str().or_else(|| state.as_object().and_then(first_key));
        word.unwrap_or("canceled").to_owned()
    })
}

fn first_key(map: &serde_json::Map<String, Value>) -> Option<&str> {
    map.keys().next().map(String::as_str)
}
