//! Store of a robot's checkpoint: the state of its current role, from which it continues after a
//! restart.

use async_trait::async_trait;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};

/// Store of a single checkpoint, which survives the process. The content is opaque bytes.
#[async_trait]
pub trait CheckpointStore: Send + Sync + 'static {
    /// Reads the checkpoint, if there is any.
    ///
    /// # Errors
    /// The store cannot be read.
    async fn read(&self) -> io::Result<Option<Vec<u8>>>;

    /// Replaces the checkpoint; `None` deletes it. When this returns `Ok`, the change survives a
    /// crash.
    ///
    /// # Errors
    /// The store cannot be written; the previous checkpoint is still there.
    async fn write(&self, checkpoint: Option<Vec<u8>>) -> io::Result<()>;
}

/// Checkpoint store in memory. Clones share the same store.
#[derive(Debug, Clone, Default)]
pub(super) struct MemoryCheckpointStore {
    checkpoint: Arc<Mutex<Option<Vec<u8>>>>,
}

#[async_trait]
impl CheckpointStore for MemoryCheckpointStore {
    async fn read(&self) -> io::Result<Option<Vec<u8>>> {
        Ok(self.checkpoint.lock().unwrap_or_else(PoisonError::into_inner).clone())
    }

    async fn write(&self, checkpoint: Option<Vec<u8>>) -> io::Result<()> {
        *self.checkpoint.lock().unwrap_or_else(PoisonError::into_inner) = checkpoint;
        Ok(())
    }
}
