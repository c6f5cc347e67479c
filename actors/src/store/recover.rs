//! When a majority of the voters is gone for good: what is left becomes the ledger of one voter, on somebody's word.

use super::DurableStore;
use crate::raft::{LogStore, LogStoreContents, inspect_log_store, recover_as_only_voter, with_repair_advice};
use consort_protocol::ids::ClusterId;
use consort_protocol::ledger::Ledger;
use std::io;
use std::path::PathBuf;

/// What a store holds of the mission ledger; blocks until it is read.
///
/// # Errors
/// The store cannot be read, or what it holds is not whole.
pub fn inspect_ledger(store: &DurableStore) -> io::Result<LogStoreContents<Ledger>> {
    store
        .persistent_state()
        .and_then(inspect_log_store)
        .map_err(|problem| with_repair_advice(problem, store.repair_advice()))
}

/// Makes the store that of its fleet's only voter: all that it holds counts as committed from now on, as the ledger of
/// `cluster`, an id that no other founding has. Whoever still holds the former one is a stranger to it, and is not listened
/// to; all the same, the others must not come back with theirs. Gives the files of the copy that it made before, named after
/// `moment`; blocks until all is on disk.
///
/// # Errors
/// The store is not whole, holds nothing, or cannot be copied or written; it is as it was then.
pub fn recover(store: &DurableStore, moment: u64, cluster: ClusterId) -> io::Result<Vec<PathBuf>> {
    let refound = |ledger: &mut Ledger| ledger.replace_cluster(cluster);
    let recovered = store
        .persistent_state()
        .and_then(|all| recover_as_only_voter(all, &store.owner().node, store.identity(), refound));
    let recovered = recovered.map_err(|problem| with_repair_advice(problem, store.repair_advice()))?;
    let copies = store.copy_files(&format!("before-recovery-{moment}"))?;
    store.replace(recovered)?;
    Ok(copies)
}
