//! The queries that a service has not ended, in any queue or task, and their limit.

use crate::bus::Query;
use crate::mailbox::BYTES_MAX;
use std::sync::Arc;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Size that each query counts in addition to its payload, in bytes.
const QUERY_BYTES: usize = 1024;

/// Reason of the refusal of a query by a busy service.
pub(crate) const BUSY: &str = "busy: too many open queries; repeat the query later";

/// Creates the mailbox of a service.
pub(crate) fn query_mailbox() -> (QuerySender, UnboundedReceiver<Query>) {
    let (queries, receiver) = unbounded_channel();
    (QuerySender { queries, room: Arc::new(Semaphore::new(BYTES_MAX / QUERY_BYTES)) }, receiver)
}

/// Sending end of the mailbox of a service.
#[derive(Clone)]
pub(crate) struct QuerySender {
    queries: UnboundedSender<Query>,
    /// Room for open queries, in units of [`QUERY_BYTES`].
    room: Arc<Semaphore>,
}

impl QuerySender {
    /// Admits a query of this size, until the replier that keeps the returned permit is dropped. `None` if the
    /// service is busy.
    pub(crate) fn admit(&self, bytes: usize) -> Option<OwnedSemaphorePermit> {
        let units = u32::try_from(1 + bytes / QUERY_BYTES).ok()?;
        Arc::clone(&self.room).try_acquire_many_owned(units).ok()
    }

    /// Adds an admitted query. Returns false if the service has ended.
    pub(crate) fn send(&self, query: Query) -> bool {
        self.queries.send(query).is_ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::MESSAGE_MAX;

    #[test]
    fn a_service_is_busy_until_queries_have_ended() {
        let (sender, _receiver) = query_mailbox();
        let large: Vec<_> = std::iter::from_fn(|| sender.admit(MESSAGE_MAX)).collect();
        assert_eq!(large.len(), 3, "the queries count more than their payloads");
        let small: Vec<_> = std::iter::from_fn(|| sender.admit(0)).collect();
        assert!(small.len() > 1000 && sender.admit(0).is_none());
        drop(large);
        assert!(sender.admit(MESSAGE_MAX).is_some());
    }
}
