//! What a node remembers from one life to the next.

mod backup;
mod durable;
mod notebook;
mod recover;

use crate::replica::{Journal, MemoryJournal};
pub use backup::{Backup, restore};
pub use durable::{ADVICE, DurableStore, LEDGER, LOCK, OpenError, Owner, SEAL, StorageBackend};
pub use notebook::{MemoryNotebook, Notebook};
pub use recover::{ledger_of, recover};
use std::sync::Arc;

/// A node's memory. Clones are the same memory.
#[derive(Clone)]
pub struct Store {
    /// Its copy of the ledger.
    pub journal: Arc<dyn Journal>,
    /// What its robot is at.
    pub notebook: Arc<dyn Notebook>,
}

impl Store {
    /// A memory that is gone with its last clone. A clone given to a restarted node plays a disk that survived.
    pub fn in_memory(identity_seed: u64) -> Store {
        Store { journal: Arc::new(MemoryJournal::new(identity_seed)), notebook: Arc::new(MemoryNotebook::default()) }
    }
}
