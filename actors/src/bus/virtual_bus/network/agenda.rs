//! What will happen, in the order in which it will.

use super::publications::Publication;
use super::{Life, Number, Place};
use crate::bus::Reply;
use crate::bus::virtual_bus::responder::Leg;
use std::cmp::Ordering;
use std::sync::Arc;
use tokio::time::Instant;

/// Something that happens at its time.
pub(super) struct Entry {
    pub(super) due: Instant,
    pub(super) number: u64,
    pub(super) event: Event,
}

pub(super) enum Event {
    /// A publication reaches a node.
    Publication { from: Place, to: Life, publication: Arc<Publication> },
    /// A question reaches a service.
    Question { from: Place, to: Life, leg: Leg },
    /// An answer reaches the asker.
    Answer { from: Place, to: Place, leg: Leg, reply: Reply },
    /// A service has said all it will.
    Finished { from: Place, to: Place, leg: Leg },
    /// A query has reached its limit.
    Limit { query: Number },
    /// `at` learns where `of` stands: connected or not, and with which tokens.
    News { at: Place, of: Place },
    /// `at` gives `of` up, if it has been silent since `change`.
    LeaseOver { at: Place, of: Place, change: u32 },
}

impl Event {
    /// Between whom a message travels; `None` for what is no message.
    pub(super) fn ends(&self) -> Option<(Place, Place)> {
        match self {
            Event::Publication { from, to, .. } | Event::Question { from, to, .. } => Some((*from, to.place)),
            Event::Answer { from, to, .. } | Event::Finished { from, to, .. } => Some((*from, *to)),
            Event::Limit { .. } | Event::News { .. } | Event::LeaseOver { .. } => None,
        }
    }
}

impl PartialEq for Entry {
    fn eq(&self, other: &Self) -> bool {
        (self.due, self.number) == (other.due, other.number)
    }
}

impl Eq for Entry {}

impl PartialOrd for Entry {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Entry {
    fn cmp(&self, other: &Self) -> Ordering {
        (self.due, self.number).cmp(&(other.due, other.number))
    }
}
