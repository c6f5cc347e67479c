//! Limit of the number of large tests that run at the same time. Test crates include this file with
//! `#[path]`.
//!
//! Laboratories of hosts and browsers need more processor time than other tests. More of them than
//! the machine has cores would delay heartbeats and frames.

use std::sync::{Condvar, Mutex, PoisonError};
use std::thread::available_parallelism;

/// Number of slots in use.
static USED: Mutex<usize> = Mutex::new(0);

/// Signals that a slot is free again.
static FREED: Condvar = Condvar::new();

/// A slot, freed on drop.
pub(crate) struct Slot(());

impl Slot {
    /// Waits for a free slot. There is a slot for each core, and at least two.
    pub(crate) fn take() -> Slot {
        let slots = available_parallelism().map_or(2, |cores| cores.get().max(2));
        let used = USED.lock().unwrap_or_else(PoisonError::into_inner);
        let mut used = FREED.wait_while(used, |used| *used >= slots).unwrap_or_else(PoisonError::into_inner);
        *used += 1;
        Slot(())
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        *USED.lock().unwrap_or_else(PoisonError::into_inner) -= 1;
        FREED.notify_one();
    }
}
