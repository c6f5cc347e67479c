//! Log store that calls a hook around its writes.

use async_trait::async_trait;
use consort_raft::{LogStore, PersistentState, StoreIdentity};
use std::io;

/// Kind of write.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Write {
    Vote,
    Append,
    Truncate,
    Purge,
    Snapshot,
}

/// Hook around the writes of a log store.
#[async_trait]
pub(super) trait WriteHook: Send + Sync + 'static {
    /// Called before each write. After an error the write is not carried out.
    async fn before(&self, write: Write) -> io::Result<()>;

    /// Called after each write, with the whole stored state.
    fn after(&self, _: Write, _: PersistentState) {}
}

/// Log store with a hook.
pub(super) struct HookedLogStore<J, H> {
    pub(super) inner: J,
    pub(super) hook: H,
}

impl<J: LogStore, H: WriteHook> HookedLogStore<J, H> {
    async fn with_hooks(&self, write: Write, operation: impl Future<Output = io::Result<()>>) -> io::Result<()> {
        self.hook.before(write).await?;
        operation.await?;
        self.hook.after(write, self.inner.load().await?);
        Ok(())
    }
}

#[async_trait]
impl<J: LogStore, H: WriteHook> LogStore for HookedLogStore<J, H> {
    fn identity(&self) -> StoreIdentity {
        self.inner.identity()
    }

    async fn load(&self) -> io::Result<PersistentState> {
        self.inner.load().await
    }

    async fn save_vote(&self, vote: Vec<u8>) -> io::Result<()> {
        self.with_hooks(Write::Vote, self.inner.save_vote(vote)).await
    }

    async fn save_committed(&self, committed: Option<Vec<u8>>) -> io::Result<()> {
        self.inner.save_committed(committed).await
    }

    async fn append(&self, entries: Vec<(u64, Vec<u8>)>) -> io::Result<()> {
        self.with_hooks(Write::Append, self.inner.append(entries)).await
    }

    async fn truncate(&self, index: u64) -> io::Result<()> {
        self.with_hooks(Write::Truncate, self.inner.truncate(index)).await
    }

    async fn purge(&self, index: u64, last: Vec<u8>) -> io::Result<()> {
        self.with_hooks(Write::Purge, self.inner.purge(index, last)).await
    }

    async fn save_snapshot(&self, snapshot: Vec<u8>) -> io::Result<()> {
        self.with_hooks(Write::Snapshot, self.inner.save_snapshot(snapshot)).await
    }
}
