//! Log stores with a bug.

use super::Mutant;
use async_trait::async_trait;
use consort_raft::{LogStore, PersistentState, StoreIdentity};
use std::io;
use std::sync::Arc;

/// Log store that acknowledges writes too early ([`Mutant::SkipFsync`]), or drops votes
/// ([`Mutant::DoubleVote`]), or keeps the identity of the store that it replaces
/// ([`Mutant::IdentityKept`]). For other mutants it equals the wrapped store.
pub(super) struct FaultyLogStore {
    pub(super) mutant: Mutant,
    /// Identity of the node's first store.
    pub(super) first: StoreIdentity,
    pub(super) inner: Arc<dyn LogStore>,
}

#[async_trait]
impl LogStore for FaultyLogStore {
    fn identity(&self) -> StoreIdentity {
        if self.mutant == Mutant::IdentityKept { self.first } else { self.inner.identity() }
    }

    fn replaces_damaged(&self) -> bool {
        self.inner.replaces_damaged()
    }

    fn location(&self) -> String {
        self.inner.location()
    }

    fn repair_advice(&self) -> Option<&'static str> {
        self.inner.repair_advice()
    }

    async fn load(&self) -> io::Result<PersistentState> {
        self.inner.load().await
    }

    async fn save_vote(&self, vote: Vec<u8>) -> io::Result<()> {
        match self.mutant {
            Mutant::SkipFsync => {
                let inner = Arc::clone(&self.inner);
                tokio::spawn(async move { inner.save_vote(vote).await });
                Ok(())
            }
            Mutant::DoubleVote => Ok(()),
            _ => self.inner.save_vote(vote).await,
        }
    }

    async fn save_committed(&self, committed: Option<Vec<u8>>) -> io::Result<()> {
        self.inner.save_committed(committed).await
    }

    async fn append(&self, entries: Vec<(u64, Vec<u8>)>) -> io::Result<()> {
        match self.mutant {
            Mutant::SkipFsync => {
                let inner = Arc::clone(&self.inner);
                tokio::spawn(async move { inner.append(entries).await });
                Ok(())
            }
            _ => self.inner.append(entries).await,
        }
    }

    async fn truncate(&self, index: u64) -> io::Result<()> {
        self.inner.truncate(index).await
    }

    async fn purge(&self, index: u64, last: Vec<u8>) -> io::Result<()> {
        self.inner.purge(index, last).await
    }

    async fn save_snapshot(&self, snapshot: Vec<u8>) -> io::Result<()> {
        self.inner.save_snapshot(snapshot).await
    }
}
