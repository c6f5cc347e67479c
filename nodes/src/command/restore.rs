//! `consort restore`: the store of a first voter, made of a copy of the ledger.

use crate::certs::unix_time;
use crate::exit::Failure;
use crate::output;
use crate::wiring::{new_store_identity, random_u64};
use consort_actors::store::{Backup, DurableStore, OpenError, StoreOwner, restore};
use consort_protocol::count::count;
use consort_protocol::ids::{ClusterId, NodeId};
use std::fs;
use std::path::PathBuf;

/// Make a node's store of a copy of the ledger, when all data directories are lost
///
/// The store is that of the fleet's only voter, with all missions as they stood when `consort backup` made the copy; the node is then
/// started as usual, and the others join it with empty data directories. What was acknowledged, awarded, carried out or canceled
/// since is not in it: work that was done since is done again unless somebody cancels it. As long as the data directory of one voter is
/// left, `consort recover` loses less.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort restore --from ward.json --node station-1 --data-dir /var/lib/consort/station-1
  consort station --config station-1.toml --data-dir /var/lib/consort/station-1")]
pub struct Args {
    /// The copy, as `consort backup` wrote it
    #[arg(long, value_name = "FILE.json")]
    from: PathBuf,
    /// The node whose store it becomes: one that may vote
    #[arg(long, value_name = "NAME")]
    node: NodeId,
    /// Its data directory, in which there is no ledger
    #[arg(long, value_name = "DIR")]
    data_dir: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] if the copy is none, or the directory has a ledger; [`Failure::Unsuccessful`] if it cannot be written. Nothing
/// that was there is changed.
pub fn run(args: Args) -> Result<(), Failure> {
    let Args { from, node, data_dir } = args;
    let wrong = |problem: &dyn std::fmt::Display| Failure::Usage(format!("{}: {problem}", from.display()));
    let text = fs::read_to_string(&from).map_err(|problem| wrong(&problem))?;
    let backup: Backup =
        serde_json::from_str(&text).map_err(|problem| wrong(&format!("it is no copy of a ledger: {problem}")))?;
    let (ledger, last) = backup.decode().map_err(|problem| wrong(&problem))?;
    match DurableStore::open_existing(&data_dir) {
        Err(OpenError::NotFound { .. }) => {}
        Ok(store) => {
            let what = format!("{}: this is the store of {}; nothing was changed", data_dir.display(), store.owner());
            return Err(Failure::Usage(format!("{what}. A copy becomes a new store: name an empty directory")));
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
        "{} is the store of {node}, the only voter of {fleet}, with {missions}, of which {under_way}, as they \
         stood {ago} s ago.\n\
         End all other nodes of {fleet}, and take their data directories away: old and new ledger do not merge. Start {node} as usual, \
         with --data-dir {0}; then the others, with empty data directories.",
        data_dir.display()
    ))
}
