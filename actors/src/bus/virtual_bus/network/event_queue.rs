//! What will happen, in the order in which it will.

use super::publications::Publication;
use super::{EntityId, Incarnation, NodeIndex};
use crate::bus::Reply;
use crate::bus::virtual_bus::responder::QueryPart;
use std::cmp::Ordering;
use std::sync::Arc;
use tokio::time::Instant;

/// Something that happens at its time.
pub(super) struct ScheduledEvent {
    pub(super) due: Instant,
    pub(super) id: u64,
    pub(super) event: Event,
}

pub(super) enum Event {
    /// A publication reaches a node.
    Publication { from: NodeIndex, to: Incarnation, publication: Arc<Publication> },
    /// A question reaches a service.
    Query { from: NodeIndex, to: Incarnation, leg: QueryPart },
    /// An answer reaches the asker.
    Reply { from: NodeIndex, to: NodeIndex, leg: QueryPart, reply: Reply },
    /// A service has said all it will.
    Finished { from: NodeIndex, to: NodeIndex, leg: QueryPart },
    /// A query has reached its limit.
    QueryTimeout { query: EntityId },
    /// `at` learns where `of` stands: connected or not, and with which tokens.
    PresenceUpdate { at: NodeIndex, of: NodeIndex },
    /// `at` gives `of` up, if it has been silent since `change`.
    LeaseExpired { at: NodeIndex, of: NodeIndex, change: u32 },
}

impl Event {
    /// Between whom a message travels; `None` for what is no message.
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
