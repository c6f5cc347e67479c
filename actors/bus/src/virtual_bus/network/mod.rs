//! State of a virtual network: all declarations, and the messages in transit.
//!
//! ```text
//!   VirtualBus ── publish, query, reply ──▶ Network ──▶ event queue (due, id) ──▶ dispatch ──▶ streams
//! ```
//!
//! Everything that happens is an event in a single queue, ordered by due time and then by id, so
//! that a seed determines the run. Nothing here waits: the driver task in the parent module calls
//! [`Network::run`] when events are due.

mod event_queue;
mod links;
mod presence;
mod publications;
mod queries;
mod routing_table;

pub(super) use queries::QueryRequest;

use super::Shared;
use super::faults::Faults;
use super::link::{LinkModel, NetworkCounters, TrafficByKind};
use super::trace::Trace;
use crate::bus::{Query, Sample};
use consort_protocol::ids::NodeId;
use consort_protocol::keys::KeyKind;
use event_queue::{Event, ScheduledEvent};
use presence::PresenceWatch;
use publications::EARLIEST_ARRIVALS_MIN;
use queries::PendingQuery;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use routing_table::RoutingTable;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, HashMap};
use std::sync::Weak;
use std::time::Duration;
use tokio::time::Instant;
use zenoh_keyexpr::OwnedKeyExpr;

/// Index of a node in [`Network::nodes`].
pub(super) type NodeIndex = usize;

/// A node between its start and its crash. Declarations and pending replies of an earlier
/// incarnation are void.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Incarnation {
    pub(super) index: NodeIndex,
    number: u32,
}

/// Id of a declaration or a query.
pub(super) type EntityId = u64;

struct Node {
    id: NodeId,
    incarnation: u32,
    alive: bool,
    paused: bool,
    /// Events that became due but could not be delivered while this node was paused.
    held_back: Vec<ScheduledEvent>,
    /// Tokens announced by this node.
    tokens: BTreeMap<EntityId, OwnedKeyExpr>,
    /// This node's view of each node, itself included, by index.
    peers: Vec<PeerView>,
    traffic: TrafficByKind,
}

/// A node's view of another node.
#[derive(Default)]
struct PeerView {
    /// Messages from the other node are lost.
    blocked: bool,
    /// No messages arrive from the other node now, because of a fault or because either node is
    /// paused.
    silent: bool,
    /// Incremented on every change of `silent`, so that the expiry of a renewed lease is void.
    silence_changes: u32,
    /// The other node counts as connected: a message has arrived, and it has not been silent for a
    /// whole lease since.
    connected: bool,
    /// Known tokens of the other node.
    tokens: BTreeMap<EntityId, OwnedKeyExpr>,
}

pub(super) struct Network {
    /// Owner of the network, for the repliers to queries.
    shared: Weak<Shared>,
    rng: ChaCha8Rng,
    model: LinkModel,
    /// Models of links that differ from `model`: from, to.
    models: BTreeMap<(NodeId, NodeId), LinkModel>,
    /// The same by node index, for existing nodes.
    models_by_index: BTreeMap<(NodeIndex, NodeIndex), LinkModel>,
    lease: Duration,
    faults: Faults,
    indexes: BTreeMap<NodeId, NodeIndex>,
    nodes: Vec<Node>,
    subscriptions: RoutingTable<Sample>,
    services: RoutingTable<Query>,
    watches: BTreeMap<EntityId, PresenceWatch>,
    queries: BTreeMap<EntityId, PendingQuery>,
    event_queue: BinaryHeap<Reverse<ScheduledEvent>>,
    /// Arrival time of the latest publication, by publisher, receiver and key. Later publications
    /// on the key arrive no earlier.
    earliest_arrivals: HashMap<(NodeIndex, NodeIndex, u64), Instant>,
    earliest_arrivals_max: usize,
    /// Last assigned id of any kind.
    last_id: u64,
    now: Instant,
    pub(super) counters: NetworkCounters,
    pub(super) trace: Trace,
}

impl Network {
    pub(super) fn new(home: Weak<Shared>, seed: u64, model: LinkModel, lease: Duration, now: Instant) -> Self {
        Network {
            shared: home,
            rng: ChaCha8Rng::seed_from_u64(seed),
            model: model.validated(),
            models: BTreeMap::new(),
            models_by_index: BTreeMap::new(),
            lease,
            faults: Faults::default(),
            indexes: BTreeMap::new(),
            nodes: Vec::new(),
            subscriptions: RoutingTable::new(),
            services: RoutingTable::new(),
            watches: BTreeMap::new(),
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
    pub(super) fn advance_to(&mut self, now: Instant) {
        self.now = self.now.max(now);
    }

    /// Returns the due time of the next event.
    pub(super) fn next_due(&self) -> Option<Instant> {
        self.event_queue.peek().map(|Reverse(entry)| entry.due)
    }

    /// Processes all due events, in order.
    pub(super) fn run(&mut self) {
        while let Some(due) = self.next_due() {
            if due > self.now {
                break;
            }
            let Some(Reverse(entry)) = self.event_queue.pop() else { break };
            self.dispatch(entry);
        }
    }

    fn next_id(&mut self) -> EntityId {
        self.last_id += 1;
        self.last_id
    }

    fn schedule(&mut self, due: Instant, event: Event) {
        let number = self.next_id();
        self.event_queue.push(Reverse(ScheduledEvent { due, id: number, event }));
    }

    /// Returns the present incarnation of a node, and starts the node if it is not running.
    pub(super) fn start(&mut self, id: NodeId) -> Incarnation {
        let index = match self.indexes.get(&id) {
            Some(&index) if self.nodes[index].alive => return self.incarnation(index),
            Some(&index) => index,
            None => self.add_node(id),
        };
        self.nodes[index].alive = true;
        self.nodes[index].paused = false;
        self.refresh_reachability();
        for other in 0..self.nodes.len() {
            self.send_presence_update(other, index);
            if other != index {
                self.send_presence_update(index, other);
            }
        }
        self.incarnation(index)
    }

    fn add_node(&mut self, id: NodeId) -> NodeIndex {
        let index = self.nodes.len();
        self.indexes.insert(id.clone(), index);
        for node in &mut self.nodes {
            node.peers.push(PeerView::default());
        }
        self.nodes.push(Node {
            id,
            incarnation: 0,
            alive: false,
            paused: false,
            held_back: Vec::new(),
            tokens: BTreeMap::new(),
            peers: (0..=index).map(|_| PeerView::default()).collect(),
            traffic: TrafficByKind::default(),
        });
        self.refresh_models();
        index
    }

    fn incarnation(&self, index: NodeIndex) -> Incarnation {
        Incarnation { index, number: self.nodes[index].incarnation }
    }

    /// Checks whether an incarnation is still running.
    pub(super) fn is_running(&self, incarnation: Incarnation) -> bool {
        let node = &self.nodes[incarnation.index];
        node.alive && node.incarnation == incarnation.number
    }

    /// Returns the nodes that node `index` is connected to.
    pub(super) fn neighbours(&self, index: NodeIndex) -> impl Iterator<Item = &NodeId> {
        self.indexes
            .iter()
            .filter(move |(_, p)| **p != index && self.nodes[index].peers[**p].connected)
            .map(|(id, _)| id)
    }

    /// Crashes a node. Messages that it has sent remain in transit.
    pub(super) fn crash(&mut self, id: &NodeId) {
        let Some(&index) = self.indexes.get(id) else { return };
        if !self.nodes[index].alive {
            return;
        }
        self.resume(id);
        let node = &mut self.nodes[index];
        node.alive = false;
        node.incarnation += 1;
        node.tokens.clear();
        for peer in &mut node.peers {
            *peer = PeerView {
                blocked: peer.blocked,
                silent: peer.silent,
                silence_changes: peer.silence_changes + 1,
                ..PeerView::default()
            };
        }
        self.subscriptions.remove_node(index);
        self.services.remove_node(index);
        self.watches.retain(|_, watch| watch.node != index);
        self.queries.retain(|_, query| query.requester != index);
        for other in (0..self.nodes.len()).filter(|other| *other != index) {
            self.send_presence_update(other, index);
        }
    }

    pub(super) fn pause(&mut self, id: &NodeId) {
        if let Some(&index) = self.indexes.get(id) {
            self.nodes[index].paused = self.nodes[index].alive;
            self.refresh_reachability();
        }
    }

    pub(super) fn resume(&mut self, id: &NodeId) {
        if let Some(&index) = self.indexes.get(id) {
            self.nodes[index].paused = false;
            // The old times and ids keep their order among themselves and before later events.
            let held_back = std::mem::take(&mut self.nodes[index].held_back);
            self.event_queue.extend(held_back.into_iter().map(Reverse));
            self.refresh_reachability();
        }
    }

    fn dispatch(&mut self, entry: ScheduledEvent) {
        if let Some((from, to)) = entry.event.endpoints() {
            if self.nodes[to].paused {
                return self.nodes[to].held_back.push(entry);
            }
            if self.nodes[from].paused {
                return self.nodes[from].held_back.push(entry);
            }
            if self.nodes[to].peers[from].blocked {
                if !matches!(entry.event, Event::Finished { .. }) {
                    self.counters.dropped += 1;
                }
                if let Event::Reply { part, .. } | Event::Finished { part, .. } = entry.event {
                    self.break_part(part);
                }
                return;
            }
        }
        match entry.event {
            Event::Publication { from, to, publication } => self.deliver_publication(from, to, &publication),
            Event::Query { from, to, part } => self.deliver_query(from, to, part),
            Event::Reply { from, to, part, reply } => self.deliver_reply(from, to, part, reply),
            Event::Finished { part, .. } => self.end_part(part),
            Event::QueryTimeout { query } => drop(self.queries.remove(&query)),
            Event::PresenceUpdate { at, of } => self.deliver_presence_update(at, of),
            Event::LeaseExpired { at, of, change } => self.expire_lease(at, of, change),
        }
    }

    /// Returns the traffic of a node over all its incarnations.
    pub(super) fn traffic(&self, id: &NodeId) -> TrafficByKind {
        self.indexes.get(id).map(|index| self.nodes[*index].traffic.clone()).unwrap_or_default()
    }

    /// Counts the traffic received by a node.
    fn count_received(&mut self, from: NodeIndex, to: NodeIndex, kind: KeyKind, bytes: usize) {
        if from != to {
            self.nodes[to].traffic.received(kind, bytes);
        }
    }

    fn count_delivery(&mut self, delivered: bool) {
        if delivered {
            self.counters.delivered += 1;
        } else {
            self.counters.dropped += 1;
        }
    }
}
