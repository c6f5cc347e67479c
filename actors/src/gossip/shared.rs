//! What a node has heard, for its other actors to read.

use consort_protocol::ids::NodeId;
use consort_protocol::knowledge::KnowledgeBase;
use consort_protocol::units::NodeTime;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;

/// Whether a node is alive, as far as this one can tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MemberStatus {
    /// Not met yet, or forgotten.
    Unknown,
    /// Alive, as far as anybody has said.
    Alive {
        /// Since when, on this node's clock.
        since: NodeTime,
    },
    /// Somebody waits in vain for its answer. It counts as alive until it is judged down; if it hears of the suspicion and
    /// is heard, it is alive again.
    Suspect {
        /// Since when, on this node's clock.
        since: NodeTime,
    },
    /// Judged down.
    Down {
        /// Since when, on this node's clock.
        since: NodeTime,
    },
}

impl MemberStatus {
    /// Whether it counts as alive: it was met, and not judged down.
    pub fn is_alive(&self) -> bool {
        match self {
            MemberStatus::Alive { .. } | MemberStatus::Suspect { .. } => true,
            MemberStatus::Unknown | MemberStatus::Down { .. } => false,
        }
    }

    /// In a word, for people: `unknown`, `alive`, `suspect` or `down`.
    pub fn as_str(&self) -> &'static str {
        match self {
            MemberStatus::Unknown => "unknown",
            MemberStatus::Alive { .. } => "alive",
            MemberStatus::Suspect { .. } => "suspect",
            MemberStatus::Down { .. } => "down",
        }
    }
}

/// What gossip has done so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct GossipCounters {
    /// Times that the own record was published.
    pub published: u64,
    /// Packets of failure detection sent.
    pub packets: u64,
    /// Digests sent to a peer.
    pub requests_sent: u64,
    /// Digests of peers answered.
    pub requests_answered: u64,
    /// Messages that could not be read, and were dropped.
    pub malformed: u64,
    /// Messages not sent because the bus was slow or failed.
    pub unsent: u64,
    /// Times that others judged this node down wrongly and it came back.
    pub refutations: u64,
    /// Times that this node came to believe another down.
    pub down_verdicts: u64,
}

/// All that there is to read.
#[derive(Debug, Default)]
pub(super) struct GossipState {
    pub(super) base: KnowledgeBase,
    pub(super) status: BTreeMap<NodeId, MemberStatus>,
    pub(super) counters: GossipCounters,
}

impl GossipState {
    pub(super) fn is_alive(&self, node: &NodeId) -> bool {
        self.status.get(node).is_some_and(MemberStatus::is_alive)
    }
}

/// A handle on what a node has heard. The gossip actor is the only writer; it outlives that actor, so that one which is
/// started in its place goes on from here and no reader notices.
#[derive(Debug, Clone)]
pub struct SharedKnowledge {
    known: Arc<Mutex<GossipState>>,
    changes: Arc<watch::Sender<u64>>,
}

impl Default for SharedKnowledge {
    fn default() -> Self {
        SharedKnowledge { known: Arc::default(), changes: Arc::new(watch::Sender::new(0)) }
    }
}

impl SharedKnowledge {
    /// Reads what is known. The gossip actor waits meanwhile: take out what is needed, and return.
    pub fn read<T>(&self, look: impl FnOnce(&KnowledgeBase) -> T) -> T {
        look(&self.lock().base)
    }

    /// A number that grows whenever somebody's knowledge or status changes. Being confirmed is no change: to notice that
    /// knowledge grows old takes a timer.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.changes.subscribe()
    }

    /// Whether a node counts as alive, suspected or not; this one always does.
    pub fn is_alive(&self, node: &NodeId) -> bool {
        self.lock().is_alive(node)
    }

    /// The same in detail.
    pub fn status(&self, node: &NodeId) -> MemberStatus {
        self.lock().status.get(node).copied().unwrap_or(MemberStatus::Unknown)
    }

    /// The status of all nodes that have one, in the order of their names.
    pub fn statuses(&self) -> BTreeMap<NodeId, MemberStatus> {
        self.lock().status.clone()
    }

    /// What gossip has done so far.
    pub fn counters(&self) -> GossipCounters {
        self.lock().counters
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, GossipState> {
        // A reader that panicked has written nothing.
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn notify_change(&self) {
        self.changes.send_modify(|number| *number += 1);
    }
}
