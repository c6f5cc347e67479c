//! `consort upgrade`: shows the progress of a rolling upgrade, and finishes it.

use crate::client::ClientFlags;
use crate::exit::Failure;
use crate::output;
use consort_protocol::keys::ApiCall;
use serde_json::{Value, json};

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
pub struct Args {
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
pub fn run(args: Args) -> Result<(), Failure> {
    let Args { finish, json, client } = args;
    let asked = json!({ "finish": finish });
    let status = client.with_client(async |client| client.api(ApiCall::Upgrade, &asked).await)?;
    match json {
        true => output::line(status),
        false => output::line(format_status(&status)),
    }
}

fn format_status(status: &Value) -> String {
    let heads = ["NODE", "ALIVE", "READS", "NEXT"].map(str::to_owned).to_vec();
    let nodes = status["nodes"].as_array().map_or(&[][..], Vec::as_slice);
    let rows: Vec<Vec<String>> = std::iter::once(heads).chain(nodes.iter().map(row)).collect();
    let (wire, next) = (&status["wire"], &status["next"]);
    let behind = nodes.iter().filter(|node| node["ready"] == false).count();
    let head = match (next.is_null(), behind) {
        (true, _) => format!("the fleet writes wire version {wire}; the coordinator's release reads no later version"),
        (false, 0) => format!(
            "the fleet writes wire version {wire}; every node reads {next}: switch with `consort upgrade --finish`"
        ),
        (false, behind) => {
            format!("the fleet writes wire version {wire}; {behind} of {} nodes do not read {next} yet", nodes.len())
        }
    };
    format!("{head}\n{}", output::table(&rows))
}

fn row(node: &Value) -> Vec<String> {
    let yes_no = |key: &str| match node[key].as_bool() {
        Some(true) => "yes",
        Some(false) => "no",
        None => "-",
    };
    let reads = match (node["oldest"].as_u64(), node["newest"].as_u64()) {
        (Some(oldest), Some(newest)) if oldest == newest => newest.to_string(),
        (Some(oldest), Some(newest)) => format!("{oldest} to {newest}"),
        _ => "unknown".to_owned(),
    };
    vec![node["node"].as_str().unwrap_or("?").to_owned(), yes_no("alive").to_owned(), reads, yes_no("ready").to_owned()]
}
