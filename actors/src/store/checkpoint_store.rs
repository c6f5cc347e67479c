//! What a robot writes down about the role it holds, so that its next life can go on where this one ended.

use async_trait::async_trait;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};

/// One page of bytes that outlives the process. A notebook knows nothing of what is written in it.
#[async_trait]
pub trait CheckpointStore: Send + Sync + 'static {
    /// The page, if one was written and not torn out.
    ///
    /// # Errors
    /// The store cannot be read.
    async fn read(&self) -> io::Result<Option<Vec<u8>>>;

    /// Replaces the page; `None` tears it out. When it returns `Ok`, this survives a crash.
    ///
    /// # Errors
    /// The store cannot be written; the former page is still there.
    async fn write(&self, page: Option<Vec<u8>>) -> io::Result<()>;
}

/// A notebook in memory. Clones are the same notebook.
#[derive(Debug, Clone, Default)]
pub struct MemoryCheckpointStore {
    page: Arc<Mutex<Option<Vec<u8>>>>,
}

#[async_trait]
impl CheckpointStore for MemoryCheckpointStore {
    async fn read(&self) -> io::Result<Option<Vec<u8>>> {
        Ok(self.page.lock().unwrap_or_else(PoisonError::into_inner).clone())
    }

    async fn write(&self, page: Option<Vec<u8>>) -> io::Result<()> {
        *self.page.lock().unwrap_or_else(PoisonError::into_inner) = page;
        Ok(())
    }
}
