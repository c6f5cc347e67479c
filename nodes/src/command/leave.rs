//! `consort leave`: a node leaves the fleet for good.

use crate::client::QueryFlags;
use crate::exit::Failure;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::Key;
use serde_json::Value;
use std::time::Duration;

/// How long a node may take to leave: its robot waits for a lease and its grace, its vote for the autopilot.
const LEAVES_WITHIN: Duration = Duration::from_secs(60);

/// Have a node leave the fleet for good
///
/// If it coordinates, it hands over; another takes its vote; its robot puts its role down, so that another can take it. Then
/// its process ends. A node without which the ledger would be lost stays, says why, and works on. To stop a node for a while, end its process (Ctrl-C or SIGTERM): it keeps its vote, and its robot
/// goes on with its role if it is back in time.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort leave ward-3
  consort leave ada --connect tcp/192.0.2.7:7447")]
pub struct Args {
    /// The node, as `consort fleet` names it
    node: NodeId,
    #[command(flatten)]
    ask: QueryFlags,
}

/// Runs the command.
///
/// # Errors
/// As [`Client::ask_node`](crate::client::Client::ask_node); a node that must stay is [`Failure::Unsuccessful`].
pub fn run(args: Args) -> Result<(), Failure> {
    let leave = Key::Leave(args.node.clone());
    args.ask.print(
        async |client| {
            client
                .progress()
                .show(format_args!("{} is leaving: its robot's role and its vote go to others", args.node));
            client.query_node(&leave, &args.node, LEAVES_WITHIN).await
        },
        |answer| words(&args.node, answer),
    )
}

fn words(node: &NodeId, answer: &Value) -> String {
    let is = |key: &str| answer.get(key).and_then(Value::as_bool).unwrap_or(false);
    let successor = answer.get("successor").and_then(Value::as_str);
    let mut words = format!("{node} has left");
    if let Some(successor) = successor {
        words += &format!("; {successor} coordinates");
    }
    if is("kept_ledger") {
        words += if is("released") { "; it keeps the ledger no more" } else { "; its vote is not removed yet" };
    }
    if !is("role_given_back") {
        words += "; its robot's role was not given back in time, and is given to another when its lease has ended";
    }
    words
}
