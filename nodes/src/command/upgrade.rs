//! `consort upgrade`: how far a fleet is on its way to a later release, and its last step.

use crate::client::ClientFlags;
use crate::exit::Failure;
use crate::output;
use consort_protocol::keys::ApiCall;
use serde_json::{Value, json};

/// Show how far a fleet is on its way to a later release, and finish it
///
/// Nodes of neighbouring releases work together: upgrade them one at a time, in any order, while missions go on. Until every
/// node reads the later version of the wire all write the earlier one, and each node can go back to its former release. --finish
/// has the fleet write the later version from then on; it is refused, and nothing is changed, as long as a node is known that does
/// not read it. Who has been down for half a minute is known no more, unless it keeps the ledger or holds a role: see to those that
/// are switched off. After it no node can go back, and one of the former release that comes is told so and ends.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort upgrade
  consort upgrade --finish --certs certs/kim --connect tls/192.0.2.1:7447

Exit codes: 0 it was shown, or finished; 1 some node does not read the next version yet, and --finish was given.")]
pub struct Args {
    /// Have the fleet write the next version of the wire from now on
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
/// [`Failure::Unsuccessful`] if it cannot be finished yet; [`Failure::Unreached`] if nobody coordinates.
pub fn run(args: Args) -> Result<(), Failure> {
    let Args { finish, json, client } = args;
    let asked = json!({ "finish": finish });
    let told = client.with_client(async |client| client.api(ApiCall::Upgrade, &asked).await)?;
    match json {
        true => output::line(told),
        false => output::line(words(&told)),
    }
}

fn words(told: &Value) -> String {
    let heads = ["NODE", "ALIVE", "READS", "NEXT"].map(str::to_owned).to_vec();
    let nodes = told["nodes"].as_array().map_or(&[][..], Vec::as_slice);
    let rows: Vec<Vec<String>> = std::iter::once(heads).chain(nodes.iter().map(row)).collect();
    let (wire, next) = (&told["wire"], &told["next"]);
    let behind = nodes.iter().filter(|node| node["ready"] == false).count();
    let head = match (next.is_null(), behind) {
        (true, _) => format!("the fleet writes version {wire} of the wire; its coordinator's release reads none later"),
        (false, 0) => format!(
            "the fleet writes version {wire} of the wire; every node reads {next}: `consort upgrade --finish` has it written"
        ),
        (false, behind) => format!(
            "the fleet writes version {wire} of the wire; {behind} of {} nodes do not read {next} yet",
            nodes.len()
        ),
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
        _ => "nothing is known".to_owned(),
    };
    vec![node["node"].as_str().unwrap_or("?").to_owned(), yes_no("alive").to_owned(), reads, yes_no("ready").to_owned()]
}
