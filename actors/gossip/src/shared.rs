//! Knowledge received by a node, readable by its other actors.

use consort_protocol::ids::NodeId;
use consort_protocol::knowledge::KnowledgeBase;
use consort_protocol::units::NodeTime;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;

/// State of a node in this node's view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MemberStatus {
    /// Not in contact yet, or removed.
    Unknown,
    /// Alive in every received update.
    Alive {
        /// Start of the state, on this node's clock.
        since: NodeTime,
    },
    /// A probe or query of this node was not answered. The node counts as alive until it is
    /// declared down; if it receives the suspicion and its refutation arrives, it is alive again.
    Suspect {
        /// Start of the state, on this node's clock.
        since: NodeTime,
    },
    /// Declared down.
    Down {
        /// Start of the state, on this node's clock.
        since: NodeTime,
    },
}

impl MemberStatus {
    /// Checks whether the node counts as alive: in contact, and not declared down.
    pub fn is_alive(&self) -> bool {
        match self {
            MemberStatus::Alive { .. } | MemberStatus::Suspect { .. } => true,
            MemberStatus::Unknown | MemberStatus::Down { .. } => false,
        }
    }

    /// Returns the state as text: `unknown`, `alive`, `suspect` or `down`.
    pub fn as_str(&self) -> &'static str {
        match self {
            MemberStatus::Unknown => "unknown",
            MemberStatus::Alive { .. } => "alive",
            MemberStatus::Suspect { .. } => "suspect",
            MemberStatus::Down { .. } => "down",
        }
    }
}

/// Counters of a node's gossip.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct GossipCounters {
    /// Publications of the own record.
    pub published: u64,
    /// Sent packets of failure detection.
    pub packets: u64,
    /// Digests sent to a peer.
    pub requests_sent: u64,
    /// Replies to digests of peers.
    pub requests_answered: u64,
    /// Malformed messages, dropped.
    pub malformed: u64,
    /// Messages not sent because the bus was slow or failed.
    pub unsent: u64,
    /// Refutations of a wrong down verdict on this node, by a rejoin under a new identity.
    pub refutations: u64,
    /// Down verdicts of this node on other nodes.
    pub down_verdicts: u64,
}

/// Readable state of gossip.
#[derive(Debug, Default)]
pub(super) struct GossipState {
    pub(super) base: KnowledgeBase,
    pub(super) status: BTreeMap<NodeId, MemberStatus>,
    pub(super) counters: GossipCounters,
    /// The node receives the motion of robots.
    pub(super) receives_motion: bool,
}

impl GossipState {
    pub(super) fn is_alive(&self, node: &NodeId) -> bool {
        self.status.get(node).is_some_and(MemberStatus::is_alive)
    }
}

/// Handle of the knowledge received by a node. The gossip actor is the only writer. The knowledge
/// outlives that actor: a replacement actor continues with it, and readers notice nothing.
#[derive(Debug, Clone)]
pub struct SharedKnowledge {
    state: Arc<Mutex<GossipState>>,
    changes: Arc<watch::Sender<u64>>,
}

impl Default for SharedKnowledge {
    fn default() -> Self {
        SharedKnowledge { state: Arc::default(), changes: Arc::new(watch::Sender::new(0)) }
    }
}

impl SharedKnowledge {
    /// Reads the knowledge base. The gossip actor waits meanwhile: copy the needed values and
    /// return.
    pub fn read<T>(&self, look: impl FnOnce(&KnowledgeBase) -> T) -> T {
        look(&self.lock().base)
    }

    /// Checks whether the node receives the motion of robots and the heartbeats of a large fleet. Otherwise
    /// the places, poses and charges of other robots, and the ages of records, are those of the latest changes of records.
    pub fn receives_motion(&self) -> bool {
        self.lock().receives_motion
    }

    /// Subscribes to a counter that increases on every change of knowledge or status. A
    /// confirmation is no change: to detect stale knowledge, use a timer.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.changes.subscribe()
    }

    /// Checks whether a node counts as alive, suspected or not. This node always does.
    pub fn is_alive(&self, node: &NodeId) -> bool {
        self.lock().is_alive(node)
    }

    /// Returns the status of a node.
    pub fn status(&self, node: &NodeId) -> MemberStatus {
        self.lock().status.get(node).copied().unwrap_or(MemberStatus::Unknown)
    }

    /// Returns the status of all nodes with a known status, ordered by name.
    pub fn statuses(&self) -> BTreeMap<NodeId, MemberStatus> {
        self.lock().status.clone()
    }

    /// Returns the counters.
    pub fn counters(&self) -> GossipCounters {
        self.lock().counters
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, GossipState> {
        // A reader that panicked has written nothing.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn notify_change(&self) {
        self.changes.send_modify(|number| *number += 1);
    }
}
