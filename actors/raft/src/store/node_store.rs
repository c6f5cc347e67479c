//! Storage of a node.

use super::checkpoint_store::{CheckpointStore, MemoryCheckpointStore};
use crate::log_store::{LogStore, MemoryLogStore};
use std::sync::Arc;

/// Storage of a node. Clones share the same storage.
#[derive(Clone)]
pub struct NodeStore {
    /// Log, vote and snapshot of its replica of the ledger.
    pub log_store: Arc<dyn LogStore>,
    /// Checkpoint of its robot.
    pub checkpoints: Arc<dyn CheckpointStore>,
}

impl NodeStore {
    /// Creates storage in memory, lost with its last clone. A clone given to a restarted node
    /// simulates a disk that survived.
    pub fn in_memory(identity_seed: u64) -> NodeStore {
        NodeStore::with(MemoryLogStore::new(identity_seed))
    }

    /// Same, as a replacement of damaged storage.
    pub fn replacing_damaged(identity_seed: u64) -> NodeStore {
        NodeStore::with(MemoryLogStore::replacing_damaged(identity_seed))
    }

    fn with(log_store: MemoryLogStore) -> NodeStore {
        NodeStore { log_store: Arc::new(log_store), checkpoints: Arc::new(MemoryCheckpointStore::default()) }
    }
}
