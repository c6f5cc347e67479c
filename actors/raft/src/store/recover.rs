//! Recovery after the permanent loss of a majority of the voters: on an operator's request, the
//! remaining store becomes the ledger of a single voter.

use super::durable::DurableStore;
use crate::log_store::{LogStore, with_repair_advice};
use crate::offline_recovery::{LogStoreContents, inspect_log_store, recover_as_only_voter};
use consort_protocol::ids::ClusterId;
use consort_protocol::ledger::Ledger;
use std::io;
use std::path::PathBuf;

/// Returns the ledger in a store. Blocks until it is read.
///
/// # Errors
/// The store cannot be read, or is damaged.
pub fn inspect_ledger(store: &DurableStore) -> io::Result<LogStoreContents<Ledger>> {
    store
        .persistent_state()
        .and_then(inspect_log_store)
        .map_err(|error| with_repair_advice(error, store.repair_advice()))
}

/// Turns the store into that of its fleet's only voter: everything in it counts as committed from
/// now on, as the ledger of `cluster`, an id that no other bootstrap has used. Nodes with the
/// former ledger belong to a different cluster, and their messages are rejected. Nevertheless, the
/// other voters must not be restarted with their stores. Returns the files of the copy that was
/// made before the change, named after `moment`. Blocks until everything is on disk.
///
/// # Errors
/// The store is damaged or empty, or cannot be copied or written; its content is unchanged then.
pub fn recover(store: &DurableStore, moment: u64, cluster: ClusterId) -> io::Result<Vec<PathBuf>> {
    let set_cluster = |ledger: &mut Ledger| ledger.replace_cluster(cluster);
    let recovered = store
        .persistent_state()
        .and_then(|state| recover_as_only_voter(state, &store.owner().node, store.identity(), set_cluster));
    let recovered = recovered.map_err(|error| with_repair_advice(error, store.repair_advice()))?;
    let copies = store.copy_files(&format!("before-recovery-{moment}"))?;
    store.replace(recovered)?;
    Ok(copies)
}
