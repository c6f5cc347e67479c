//! `consort resolve`: closes a mission after its items were taken care of by hand.

use super::missions::detail;
use crate::client::QueryFlags;
use crate::exit::Failure;
use consort_protocol::api::{MissionChangeReply, MissionChangeRequest};
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;

/// Close a mission that needs intervention
///
/// Use it after the items in robots' hands have been taken care of: the mission is then failed,
/// with the name of the person, and its robots become available again. `consort missions` shows the
/// items and their places. In a simulated world, the request itself takes all items off these robots.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort resolve lab-samples-1 --by 'ward 3, Nia'")]
pub(crate) struct Args {
    /// The mission, as named by `consort missions`
    mission: MissionId,
    /// Name of the responsible person, for the record. Default: in a closed fleet the name in your
    /// certificate, else "an operator"
    #[arg(long, env = "CONSORT_BY", value_name = "NAME")]
    by: Option<String>,
    #[command(flatten)]
    query: QueryFlags,
}

/// Runs the command.
///
/// # Errors
/// See [`Client::api`](crate::client::Client::api); a mission that does not need intervention, or
/// does not exist, is [`Failure::Unsuccessful`].
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let Args { mission, by, query } = args;
    query.print(
        async |client| {
            let by = by.or_else(|| client.is_anonymous().then(|| "an operator".to_owned()));
            client.api(ApiCall::Resolve, &MissionChangeRequest { mission, by }).await
        },
        |MissionChangeReply { mission, state }: &MissionChangeReply| {
            format!("{mission} closed{}", state.as_ref().map(detail).unwrap_or_default())
        },
    )
}
