//! Scheduled events, in the order of their processing.

use super::publication::Publication;
use crate::bus::Reply;
use crate::virtual_bus::ids::{EntityId, Incarnation, NodeIndex, QueryPart};
use std::cmp::Ordering;
use std::sync::Arc;
use tokio::time::Instant;

/// An event and its time.
pub(super) struct ScheduledEvent {
    pub(super) due: Instant,
    pub(super) id: u64,
    pub(super) event: Event,
}

pub(super) enum Event {
    /// A publication reaches a node.
    Publication { from: NodeIndex, to: Incarnation, publication: Arc<Publication> },
    /// A query reaches a service.
    Query { from: NodeIndex, to: Incarnation, part: QueryPart },
    /// A reply reaches the requester.
    Reply { from: NodeIndex, to: NodeIndex, part: QueryPart, reply: Reply },
    /// A service has sent its last reply.
    Finished { from: NodeIndex, to: NodeIndex, part: QueryPart },
    /// A query has reached its timeout.
    QueryTimeout { query: EntityId },
    /// `at` receives the state of `of`: connected or not, and its tokens.
    PresenceUpdate { at: NodeIndex, of: NodeIndex },
    /// The lease of `of` at `at` expires, if `of` has been silent since `change`.
    LeaseExpired { at: NodeIndex, of: NodeIndex, change: u32 },
}

impl Event {
    /// Returns the sender and the receiver of a message; `None` for other events.
    pub(super) fn endpoints(&self) -> Option<(NodeIndex, NodeIndex)> {
        match self {
            Event::Publication { from, to, .. } | Event::Query { from, to, .. } => Some((*from, to.index)),
            Event::Reply { from, to, .. } | Event::Finished { from, to, .. } => Some((*from, *to)),
            Event::QueryTimeout { .. } | Event::PresenceUpdate { .. } | Event::LeaseExpired { .. } => None,
        }
    }
}

impl PartialEq for ScheduledEvent {
    fn eq(&self, other: &Self) -> bool {
        (self.due, self.id) == (other.due, other.id)
    }
}

impl Eq for ScheduledEvent {}

impl PartialOrd for ScheduledEvent {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for ScheduledEvent {
    fn cmp(&self, other: &Self) -> Ordering {
        (self.due, self.id).cmp(&(other.due, other.id))
    }
}
