//! `consort cancel`: cancels a mission.

use super::mission_action::MissionActionFlags;
use crate::exit::Failure;
use consort_protocol::keys::ApiCall;
use serde_json::Value;

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
/// See [`Client::api`](crate::client::Client::api); a mission that has ended otherwise, or does not
/// exist, is [`Failure::Unsuccessful`].
pub fn run(args: Args) -> Result<(), Failure> {
    args.on_word.request(ApiCall::Cancel, |state| {
        let word = state.as_str().or_else(|| state.as_object().and_then(first_key));
        word.unwrap_or("canceled").to_owned()
    })
}

fn first_key(map: &serde_json::Map<String, Value>) -> Option<&str> {
    map.keys().next().map(String::as_str)
}
