//! `consort restore`: creates the store of a first voter from a copy of the ledger.

use crate::certs::unix_time;
use crate::exit::Failure;
use crate::output;
use crate::wiring::{new_store_identity, random_u64};
use consort_protocol::ids::{ClusterId, NodeId};
use consort_raft::store::{Backup, DurableStore, OpenError, StoreOwner, restore};
use consort_text::count;
use std::fs;
use std::path::PathBuf;

/// Create a node's store from a copy of the ledger, when all data directories are lost
///
/// The store belongs to the fleet's only voter, with all missions in their state at the time of
/// `consort backup`. The node is then started as usual, and the others join it with empty data
/// directories. Later acknowledgements, awards, completions and cancellations are not in it: work
/// that was done since is done again unless it is canceled. While the data directory of any voter
/// is left, `consort recover` loses less.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort restore --from ward.json --node station-1 --data-dir /var/lib/consort/station-1
  consort station --config station-1.toml --data-dir /var/lib/consort/station-1")]
pub(crate) struct Args {
    /// The copy, as written by `consort backup`
    #[arg(long, value_name = "FILE.json")]
    from: PathBuf,
    /// The node that gets the store: a node with may_vote
    #[arg(long, value_name = "NAME")]
    node: NodeId,
    /// Its data directory, without a ledger
    #[arg(long, value_name = "DIR")]
    data_dir: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] if the copy is invalid, or the directory has a ledger;
/// [`Failure::Unsuccessful`] if it cannot be written. Existing files are not changed.
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let Args { from, node, data_dir } = args;
    let wrong = |problem: &dyn std::fmt::Display| Failure::Usage(format!("{}: {problem}", from.display()));
    let text = fs::read_to_string(&from).map_err(|problem| wrong(&problem))?;
    let backup: Backup =
        serde_json::from_str(&text).map_err(|problem| wrong(&format!("it is not a copy of a ledger: {problem}")))?;
    let (ledger, last) = backup.decode().map_err(|problem| wrong(&problem))?;
    match DurableStore::open_existing(&data_dir) {
        Err(OpenError::NotFound { .. }) => {}
        Ok(store) => {
            let what = format!("{}: this is the store of {}; nothing was changed", data_dir.display(), store.owner());
            return Err(Failure::Usage(format!("{what}. A copy becomes a new store: give an empty directory")));
        }
        Err(problem) => return Err(Failure::Usage(problem.to_string())),
    }
    let failed = |problem: &dyn std::fmt::Display| Failure::Unsuccessful(problem.to_string());
    let owner = StoreOwner { fleet: backup.fleet.clone(), node: node.clone() };
    let store = DurableStore::open(&data_dir, &owner, new_store_identity()).map_err(|problem| failed(&problem))?;
    restore(&store, ledger, last, ClusterId(random_u64())).map_err(|problem| failed(&problem))?;
    let Backup { fleet, at_ms, missions, under_way, .. } = backup;
    let ago = unix_time().as_secs().saturating_sub(at_ms / 1000);
    let missions = count(missions, "mission", "missions");
    let under_way = count(under_way, "has not ended", "have not ended");
    output::line(format_args!(
        "{} is the store of {node}, the only voter of {fleet}, with {missions}, of which {under_way}, in their \
         state of {ago} s ago.\n\
         End all other nodes of {fleet}, and remove their data directories: the old and the new ledger do not merge. Start {node} as usual, \
         with --data-dir {0}; then the others, with empty data directories.",
        data_dir.display()
    ))
}
