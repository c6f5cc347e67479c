//! When a majority of the voters is gone for good: what is left becomes the ledger of one voter, on somebody's word.

use super::DurableStore;
use crate::replica::{Holdings, Journal, holdings, sole_voter};
use consort_protocol::ledger::Ledger;
use std::io;
use std::path::PathBuf;

/// What a store holds of the mission ledger; blocks until it is read.
///
/// # Errors
/// The store cannot be read, or what it holds is not whole.
pub fn ledger_of(store: &DurableStore) -> io::Result<Holdings<Ledger>> {
    holdings(store.recorded()?)
}

/// Makes the store that of its fleet's only voter: all that it holds counts as committed from now on, and the others must
/// never come back with theirs. Gives the files of the copy that it made before, named after `moment`; blocks until all is
/// on disk.
///
/// # Errors
/// The store is not whole, holds nothing, or cannot be copied or written; it is as it was then.
pub fn recover(store: &DurableStore, moment: u64) -> io::Result<Vec<PathBuf>> {
    let recorded = store.recorded()?;
    let recovered = sole_voter::<Ledger>(recorded, &store.owner().node, store.identity(), found_anew)?;
    let copies = store.back_up(&format!("before-recovery-{moment}"))?;
    store.replace(recovered)?;
    Ok(copies)
}

/// Makes a recovered ledger tell itself apart from the one it was: whoever still holds that one is a stranger to it.
///
/// This is where a recovered ledger gets a new cluster id, once ledgers have one.
fn found_anew(_ledger: &mut Ledger) {}
