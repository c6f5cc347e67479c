//! A journal with something in the way of its writes.

use async_trait::async_trait;
use consort_actors::replica::{Journal, Recorded, StoreIdentity};
use std::io;

/// A kind of write.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Write {
    Vote,
    Append,
    Truncate,
    Purge,
    Snapshot,
}

/// What is in the way.
#[async_trait]
pub(super) trait Hindrance: Send + Sync + 'static {
    /// Comes before each write, which is not carried out after an error.
    async fn before(&self, write: Write) -> io::Result<()>;

    /// Comes after each write, with all that the journal has recorded.
    fn after(&self, _: Write, _: Recorded) {}
}

/// The journal.
pub(super) struct Hindered<J, H> {
    pub(super) journal: J,
    pub(super) by: H,
}

impl<J: Journal, H: Hindrance> Hindered<J, H> {
    async fn around(&self, write: Write, carried_out: impl Future<Output = io::Result<()>>) -> io::Result<()> {
        self.by.before(write).await?;
        carried_out.await?;
        self.by.after(write, self.journal.load().await?);
        Ok(())
    }
}

#[async_trait]
impl<J: Journal, H: Hindrance> Journal for Hindered<J, H> {
    fn identity(&self) -> StoreIdentity {
        self.journal.identity()
    }

    async fn load(&self) -> io::Result<Recorded> {
        self.journal.load().await
    }

    async fn record_vote(&self, vote: Vec<u8>) -> io::Result<()> {
        self.around(Write::Vote, self.journal.record_vote(vote)).await
    }

    async fn record_committed(&self, committed: Option<Vec<u8>>) -> io::Result<()> {
        self.journal.record_committed(committed).await
    }

    async fn append(&self, entries: Vec<(u64, Vec<u8>)>) -> io::Result<()> {
        self.around(Write::Append, self.journal.append(entries)).await
    }

    async fn truncate(&self, index: u64) -> io::Result<()> {
        self.around(Write::Truncate, self.journal.truncate(index)).await
    }

    async fn purge(&self, index: u64, last: Vec<u8>) -> io::Result<()> {
        self.around(Write::Purge, self.journal.purge(index, last)).await
    }

    async fn keep_snapshot(&self, snapshot: Vec<u8>) -> io::Result<()> {
        self.around(Write::Snapshot, self.journal.keep_snapshot(snapshot)).await
    }
}
