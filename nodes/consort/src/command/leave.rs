//! `consort leave`: decommissions a node.

use crate::client::QueryFlags;
use crate::exit::Failure;
use consort_fleet::autopilot::DecommissionReport;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::Key;
use std::time::Duration;

/// Time limit for a node to leave: its robot waits for a lease and its grace time, its vote for the
/// autopilot.
const LEAVES_WITHIN: Duration = Duration::from_secs(60);

/// Decommission a node
///
/// A coordinator transfers the leadership; another node replaces it as voter; its robot releases
/// its role, so that another robot can take it. Then the process ends. A node that holds the only
/// copy of ledger entries stays, reports why, and keeps working. To stop a node for a while, end
/// its process (Ctrl-C or SIGTERM): it keeps its vote, and its robot resumes its role if the node
/// is back in time.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort leave ward-3
  consort leave ada --connect tcp/192.0.2.7:7447")]
pub struct Args {
    /// The node, as named by `consort fleet`
    node: NodeId,
    #[command(flatten)]
    ask: QueryFlags,
}

/// Runs the command.
///
/// # Errors
/// See `Client::query_node`; a node that must stay is
/// [`Failure::Unsuccessful`].
pub fn run(args: Args) -> Result<(), Failure> {
    let leave = Key::Leave(args.node.clone());
    args.ask.print(
        async |client| {
            client
                .progress()
                .show(format_args!("{} is leaving: its robot's role and its vote go to others", args.node));
            client.query_node(&leave, &args.node, LEAVES_WITHIN).await
        },
        words,
    )
}

fn words(report: &DecommissionReport) -> String {
    let DecommissionReport { node, successor, was_member, vote_released, role_released } = report;
    let mut words = format!("{node} has left");
    if let Some(successor) = successor {
        words += &format!("; {successor} is the coordinator");
    }
    if *was_member {
        words += if *vote_released { "; it is no longer a voter" } else { "; its vote is not removed yet" };
    }
    if !role_released {
        words += "; its robot's role was not released in time; another robot gets it when the lease has expired";
    }
    words
}
