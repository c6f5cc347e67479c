//! State of a virtual network, and the operations on it that all parts use.

use super::event_queue::{Event, ScheduledEvent};
use super::pending_query::PendingQuery;
use super::presence_watch::PresenceWatch;
use super::publication::EARLIEST_ARRIVALS_MIN;
use super::routing_table::RoutingTable;
use crate::bus::Sample;
use crate::mailbox::MailboxSender;
use crate::open_queries::QuerySender;
use crate::virtual_bus::faults::Faults;
use crate::virtual_bus::ids::{EntityId, Incarnation, NodeIndex};
use crate::virtual_bus::link::{LinkModel, LinkQueue, NetworkCounters, TrafficByKind};
use crate::virtual_bus::responder::ReplySink;
use crate::virtual_bus::trace::Trace;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::KeyKind;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, HashMap};
use std::sync::Weak;
use std::time::Duration;
use tokio::time::Instant;
use zenoh_keyexpr::OwnedKeyExpr;

pub(super) struct Node {
    pub(super) id: NodeId,
    pub(super) incarnation: u32,
    pub(super) alive: bool,
    pub(super) paused: bool,
    /// Events that became due but could not be delivered while this node was paused.
    pub(super) held_back: Vec<ScheduledEvent>,
    /// Tokens announced by this node.
    pub(super) tokens: BTreeMap<EntityId, OwnedKeyExpr>,
    /// This node's view of each node, itself included, by index.
    pub(super) peers: Vec<PeerView>,
    /// Watchers of presence tokens at this node.
    pub(super) watches: BTreeMap<EntityId, PresenceWatch>,
    pub(super) traffic: TrafficByKind,
}

/// A node's view of another node.
#[derive(Default)]
pub(super) struct PeerView {
    /// Messages from the other node are lost.
    pub(super) blocked: bool,
    /// No messages arrive from the other node now, because of a fault or because either node is
    /// paused.
    pub(super) silent: bool,
    /// Incremented on every change of `silent`, so that the expiry of a renewed lease is void.
    pub(super) silence_changes: u32,
    /// The other node counts as connected: a message has arrived, and it has not been silent for a
    /// whole lease since.
    pub(super) connected: bool,
    /// Known tokens of the other node.
    pub(super) tokens: BTreeMap<EntityId, OwnedKeyExpr>,
}

pub(crate) struct Network {
    /// Owner of the network, for the repliers to queries.
    pub(super) sink: Weak<dyn ReplySink>,
    pub(super) rng: ChaCha8Rng,
    pub(super) model: LinkModel,
    /// Models of links that differ from `model`: from, to.
    pub(super) models: BTreeMap<(NodeId, NodeId), LinkModel>,
    /// The same by node index, for existing nodes.
    pub(super) models_by_index: BTreeMap<(NodeIndex, NodeIndex), LinkModel>,
    /// Messages that links with limited bandwidth have not sent: from, to.
    pub(super) link_queues: BTreeMap<(NodeIndex, NodeIndex), LinkQueue>,
    pub(super) lease: Duration,
    pub(super) faults: Faults,
    pub(super) indexes: BTreeMap<NodeId, NodeIndex>,
    pub(super) nodes: Vec<Node>,
    pub(super) subscriptions: RoutingTable<MailboxSender<Sample>>,
    pub(super) services: RoutingTable<QuerySender>,
    pub(super) queries: BTreeMap<EntityId, PendingQuery>,
    pub(super) event_queue: BinaryHeap<Reverse<ScheduledEvent>>,
    /// Arrival time of the latest publication, by publisher, receiver and key. Later publications
    /// on the key arrive no earlier.
    pub(super) earliest_arrivals: HashMap<(NodeIndex, NodeIndex, u64), Instant>,
    pub(super) earliest_arrivals_max: usize,
    /// Last assigned id of any kind.
    pub(super) last_id: u64,
    pub(super) now: Instant,
    pub(crate) counters: NetworkCounters,
    pub(crate) trace: Trace,
}

impl Network {
    pub(crate) fn new(sink: Weak<dyn ReplySink>, seed: u64, model: LinkModel, lease: Duration, now: Instant) -> Self {
        Network {
            sink,
            rng: ChaCha8Rng::seed_from_u64(seed),
            model: model.validated(),
            models: BTreeMap::new(),
            models_by_index: BTreeMap::new(),
            link_queues: BTreeMap::new(),
            lease,
            faults: Faults::default(),
            indexes: BTreeMap::new(),
            nodes: Vec::new(),
            subscriptions: RoutingTable::new(),
            services: RoutingTable::new(),
            queries: BTreeMap::new(),
            event_queue: BinaryHeap::new(),
            earliest_arrivals: HashMap::new(),
            earliest_arrivals_max: EARLIEST_ARRIVALS_MIN,
            last_id: 0,
            now,
            counters: NetworkCounters::default(),
            trace: Trace::new(now),
        }
    }

    /// Advances the time; it never runs backwards.
    pub(crate) fn advance_to(&mut self, now: Instant) {
        self.now = self.now.max(now);
    }

    /// Returns the due time of the next event.
    pub(crate) fn next_due(&self) -> Option<Instant> {
        self.event_queue.peek().map(|Reverse(entry)| entry.due)
    }

    pub(super) fn next_id(&mut self) -> EntityId {
        self.last_id += 1;
        self.last_id
    }

    pub(super) fn schedule(&mut self, due: Instant, event: Event) {
        let number = self.next_id();
        self.event_queue.push(Reverse(ScheduledEvent { due, id: number, event }));
    }

    pub(super) fn incarnation(&self, index: NodeIndex) -> Incarnation {
        Incarnation { index, number: self.nodes[index].incarnation }
    }

    /// Checks whether an incarnation is still running.
    pub(crate) fn is_running(&self, incarnation: Incarnation) -> bool {
        let node = &self.nodes[incarnation.index];
        node.alive && node.incarnation == incarnation.number
    }

    /// Counts the traffic received by a node.
    pub(super) fn count_received(&mut self, from: NodeIndex, to: NodeIndex, kind: KeyKind, bytes: usize) {
        if from != to {
            self.nodes[to].traffic.received(kind, bytes);
        }
    }

    pub(super) fn count_delivery(&mut self, delivered: bool) {
        if delivered {
            self.counters.delivered += 1;
        } else {
            self.counters.dropped += 1;
        }
    }
}
