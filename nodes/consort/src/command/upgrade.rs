//! `consort upgrade`: shows the progress of a rolling upgrade, and finishes it.

use crate::client::{ClientFlags, read_answer};
use crate::exit::Failure;
use crate::output;
use consort_protocol::api::{NodeVersions, UpgradeReply, UpgradeRequest};
use consort_protocol::keys::ApiCall;

/// Show the progress of a rolling upgrade, and finish it
///
/// Nodes of neighbouring releases work together: upgrade them individually, in any order, while
/// missions continue. Until every node reads the later wire version, all nodes write the earlier
/// version, and each node can go back to its former release. --finish switches the fleet to the
/// later version. It is rejected, and nothing changes, while a known node does not read that
/// version. A node that has been down for half a minute is forgotten, unless it is a voter or holds
/// a role: check nodes that are switched off. Afterwards no node can go back, and a node of the
/// former release ends with an error.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort upgrade
  consort upgrade --finish --certs certs/kim --connect tls/192.0.2.1:7447

Exit codes: 0 success; 1 a node does not read the next version yet, and --finish was given.")]
pub(crate) struct Args {
    /// Switch the fleet to the next wire version
    #[arg(long)]
    finish: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    client: ClientFlags,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Unsuccessful`] if it cannot be finished yet; [`Failure::Unreachable`] if there is no
/// coordinator.
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let Args { finish, json, client } = args;
    let request = UpgradeRequest { finish };
    let status = client.with_client(async |client| client.api(ApiCall::Upgrade, &request).await)?;
    match json {
        true => output::line(status),
        false => output::line(format_status(&read_answer(&status)?)),
    }
}

fn format_status(UpgradeReply { wire, next, nodes }: &UpgradeReply) -> String {
    let heads = ["NODE", "ALIVE", "READS", "NEXT"].map(str::to_owned).to_vec();
    let rows: Vec<Vec<String>> = std::iter::once(heads).chain(nodes.iter().map(row)).collect();
    let behind = nodes.iter().filter(|node| node.ready == Some(false)).count();
    let head = match (next, behind) {
        (None, _) => format!("the fleet writes wire version {wire}; the coordinator's release reads no later version"),
        (Some(next), 0) => format!(
            "the fleet writes wire version {wire}; every node reads {next}: switch with `consort upgrade --finish`"
        ),
        (Some(next), behind) => {
            format!("the fleet writes wire version {wire}; {behind} of {} nodes do not read {next} yet", nodes.len())
        }
    };
    format!("{head}\n{}", output::table(&rows))
}

fn row(NodeVersions { node, alive, oldest, newest, ready }: &NodeVersions) -> Vec<String> {
    let yes_no = |value: Option<bool>| match value {
        Some(true) => "yes",
        Some(false) => "no",
        None => "-",
    };
    let reads = match (oldest, newest) {
        (Some(oldest), Some(newest)) if oldest == newest => newest.to_string(),
        (Some(oldest), Some(newest)) => format!("{oldest} to {newest}"),
        _ => "unknown".to_owned(),
    };
    vec![node.to_string(), yes_no(Some(*alive)).to_owned(), reads, yes_no(*ready).to_owned()]
}
