//! `consort cancel`: withdraw a mission.

use crate::client::{Client, ClientFlags};
use crate::exit::Failure;
use crate::{output, running};
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use serde_json::{Value, json};

/// Withdraw a mission
///
/// Its robots stop safely and are free again. A mission that has ended stays as it ended.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort cancel lab-samples-1
  consort cancel lab-samples-1 --by 'ward 3, Nia'")]
pub struct Args {
    /// The mission, as `consort missions` names it
    mission: MissionId,
    /// On whose word, for the record
    #[arg(long, env = "CONSORT_BY", default_value = "an operator")]
    by: String,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    client: ClientFlags,
}

/// Runs the command.
///
/// # Errors
/// As [`Client::api`]; a mission that has ended otherwise, or is not there, is [`Failure::Unsuccessful`].
pub fn run(args: Args) -> Result<(), Failure> {
    running::runtime()?.block_on(async {
        let mut client = Client::open(&args.client).await?;
        let request = json!({ "mission": args.mission, "by": args.by });
        let answer = client.api(ApiCall::Cancel, &request).await?;
        client.close().await;
        if args.json {
            return output::line(&answer);
        }
        let state = answer.get("state").cloned().unwrap_or_default();
        let word = state.as_str().map(str::to_owned);
        let word = word
            .or_else(|| state.as_object().and_then(|map: &serde_json::Map<String, Value>| map.keys().next().cloned()));
        let detail = super::missions::detail(&state);
        output::line(format_args!("{} {}{detail}", args.mission, word.unwrap_or_else(|| "canceled".to_owned())))
    })
}
