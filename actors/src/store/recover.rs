//! When a majority of the voters is gone for good: what is left becomes the ledger of one voter, on somebody's word.

use super::DurableStore;
use crate::replica::{Holdings, Journal, advised, holdings, sole_voter};
use consort_protocol::ids::ClusterId;
use consort_protocol::ledger::Ledger;
use std::io;
use std::path::PathBuf;

/// What a store holds of the mission ledger; blocks until it is read.
///
/// # Errors
/// The store cannot be read, or what it holds is not whole.
pub fn ledger_of(store: &DurableStore) -> io::Result<Holdings<Ledger>> {
    store.recorded().and_then(holdings).map_err(|problem| advised(problem, store.advice()))
}

/// Makes the store that of its fleet's only voter: all that it holds counts as committed from now on, as the ledger of
/// `cluster`, an id that no other founding has. Whoever still holds the former one is a stranger to it, and is not listened
/// to; all the same, the others must not come back with theirs. Gives the files of the copy that it made before, named after
/// `moment`; blocks until all is on disk.
///
/// # Errors
/// The store is not whole, holds nothing, or cannot be copied or written; it is as it was then.
pub fn recover(store: &DurableStore, moment: u64, cluster: ClusterId) -> io::Result<Vec<PathBuf>> {
    let refound = |ledger: &mut Ledger| ledger.refound(cluster);
    let recovered = store.recorded().and_then(|all| sole_voter(all, &store.owner().node, store.identity(), refound));
    let recovered = recovered.map_err(|problem| advised(problem, store.advice()))?;
    let copies = store.back_up(&format!("before-recovery-{moment}"))?;
    store.replace(recovered)?;
    Ok(copies)
}
