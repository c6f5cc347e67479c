//! What a node remembers from one life to the next.

mod backup;
mod checkpoint_store;
mod durable;
mod recover;

use crate::raft::{LogStore, MemoryLogStore};
pub use backup::{Backup, restore};
pub use checkpoint_store::{CheckpointStore, MemoryCheckpointStore};
pub use durable::{
    COMMIT_MARKER_FILE, DurableStore, LEDGER_FILE, LOCK_FILE, OpenError, REPAIR_ADVICE, StorageBackend, StoreOwner,
};
pub use recover::{inspect_ledger, recover};
use std::sync::Arc;

/// A node's memory. Clones are the same memory.
#[derive(Clone)]
pub struct NodeStore {
    /// Its copy of the ledger.
    pub log_store: Arc<dyn LogStore>,
    /// What its robot is at.
    pub checkpoints: Arc<dyn CheckpointStore>,
}

impl NodeStore {
    /// A memory that is gone with its last clone. A clone given to a restarted node plays a disk that survived.
    pub fn in_memory(identity_seed: u64) -> NodeStore {
        NodeStore {
            log_store: Arc::new(MemoryLogStore::new(identity_seed)),
            checkpoints: Arc::new(MemoryCheckpointStore::default()),
        }
    }
}
