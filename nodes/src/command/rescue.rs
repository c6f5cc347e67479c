//! `consort rescue`: say that what a mission left in robots' hands has been taken care of.

use crate::client::{Client, ClientFlags};
use crate::exit::Failure;
use crate::{output, running};
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use serde_json::json;

/// Close a mission that needs rescue
///
/// Say so when what it left in robots' hands has been taken care of: the mission is then failed, with the name of whoever
/// closed it, and its robots are given work again. `consort missions` says what is where.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort rescue lab-samples-1 --by 'ward 3, Nia'")]
pub struct Args {
    /// The mission, as `consort missions` names it
    mission: MissionId,
    /// Who took care of it, for the record
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
/// As [`Client::api`]; a mission that does not need rescue, or is not there, is [`Failure::Unsuccessful`].
pub fn run(args: Args) -> Result<(), Failure> {
    running::runtime()?.block_on(async {
        let mut client = Client::open(&args.client).await?;
        let request = json!({ "mission": args.mission, "by": args.by });
        let answer = client.api(ApiCall::Rescued, &request).await?;
        client.close().await;
        if args.json {
            return output::line(&answer);
        }
        let detail = answer.get("state").map(super::missions::detail).unwrap_or_default();
        output::line(format_args!("{} closed{detail}", args.mission))
    })
}
