//! The state of a virtual network: who has declared what, and what is under way.
//!
//! ```text
//!   VirtualBus ── publish, query, reply ──▶ Network ──▶ agenda (due, number) ──▶ hand_over ──▶ streams
//! ```
//!
//! All that happens is an entry of one agenda, ordered by when it is due and then by a running number, so that one
//! seed gives one run. Nothing here waits: the driver in the parent module calls [`Network::run`] when entries are due.

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

/// Where a node stands in [`Network::nodes`].
pub(super) type NodeIndex = usize;

/// A node from its start to its crash. What an earlier life declared or is owed is void.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Incarnation {
    pub(super) index: NodeIndex,
    number: u32,
}

/// Names a declaration or a query.
pub(super) type EntityId = u64;

struct Node {
    id: NodeId,
    life: u32,
    alive: bool,
    paused: bool,
    /// What came due while it could not be handed over because this node was paused.
    held: Vec<ScheduledEvent>,
    /// Tokens this node has announced.
    tokens: BTreeMap<EntityId, OwnedKeyExpr>,
    /// How this node sees each node, itself included, by place.
    peers: Vec<PeerView>,
    traffic: TrafficByKind,
}

/// How one node sees another.
#[derive(Default)]
struct PeerView {
    /// Whether what the other says is lost.
    blocked: bool,
    /// Whether nothing is heard from the other now, because it is cut off or one of the two is paused.
    silent: bool,
    /// Grows with every change of `silent`, so that the end of a lease which was renewed is void.
    silence_changes: u32,
    /// Whether the other counts as connected: it was heard, and not silent for a whole lease since.
    connected: bool,
    /// The other's tokens, as far as known here.
    tokens: BTreeMap<EntityId, OwnedKeyExpr>,
}

pub(super) struct Network {
    /// Where the network lives, for those who answer queries.
    shared: Weak<Shared>,
    rng: ChaCha8Rng,
    model: LinkModel,
    /// Links that differ from `model`, from and to.
    models: BTreeMap<(NodeId, NodeId), LinkModel>,
    /// The same by place, for those that exist.
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
    /// When the latest publication arrives, by publisher, receiver and key: none on this key arrives before it.
    earliest_arrivals: HashMap<(NodeIndex, NodeIndex, u64), Instant>,
    earliest_arrivals_max: usize,
    /// Last number given, to anything.
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

    /// Tells the time; it never runs backwards.
    pub(super) fn advance_to(&mut self, now: Instant) {
        self.now = self.now.max(now);
    }

    /// When the next entry is due.
    pub(super) fn next_due(&self) -> Option<Instant> {
        self.event_queue.peek().map(|Reverse(entry)| entry.due)
    }

    /// Carries out all that is due, in order.
    pub(super) fn run(&mut self) {
        while let Some(due) = self.next_due() {
            if due > self.now {
                break;
            }
            let Some(Reverse(entry)) = self.event_queue.pop() else { break };
            self.hand_over(entry);
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

    /// The present life of a node, which begins now if it has none.
    pub(super) fn start(&mut self, id: NodeId) -> Incarnation {
        let place = match self.indexes.get(&id) {
            Some(&place) if self.nodes[place].alive => return self.incarnation(place),
            Some(&place) => place,
            None => self.add(id),
        };
        self.nodes[place].alive = true;
        self.nodes[place].paused = false;
        self.refresh_reachability();
        for other in 0..self.nodes.len() {
            self.send_presence_update(other, place);
            if other != place {
                self.send_presence_update(place, other);
            }
        }
        self.incarnation(place)
    }

    fn add(&mut self, id: NodeId) -> NodeIndex {
        let place = self.nodes.len();
        self.indexes.insert(id.clone(), place);
        for node in &mut self.nodes {
            node.peers.push(PeerView::default());
        }
        self.nodes.push(Node {
            id,
            life: 0,
            alive: false,
            paused: false,
            held: Vec::new(),
            tokens: BTreeMap::new(),
            peers: (0..=place).map(|_| PeerView::default()).collect(),
            traffic: TrafficByKind::default(),
        });
        self.refresh_models();
        place
    }

    fn incarnation(&self, place: NodeIndex) -> Incarnation {
        Incarnation { index: place, number: self.nodes[place].life }
    }

    /// Whether a life goes on.
    pub(super) fn is_running(&self, life: Incarnation) -> bool {
        let node = &self.nodes[life.index];
        node.alive && node.life == life.number
    }

    /// Nodes that `place` is connected to.
    pub(super) fn neighbours(&self, place: NodeIndex) -> impl Iterator<Item = &NodeId> {
        self.indexes
            .iter()
            .filter(move |(_, p)| **p != place && self.nodes[place].peers[**p].connected)
            .map(|(id, _)| id)
    }

    /// Ends a node's life. What it has sent stays under way.
    pub(super) fn crash(&mut self, id: &NodeId) {
        let Some(&place) = self.indexes.get(id) else { return };
        if !self.nodes[place].alive {
            return;
        }
        self.resume(id);
        let node = &mut self.nodes[place];
        node.alive = false;
        node.life += 1;
        node.tokens.clear();
        for peer in &mut node.peers {
            *peer = PeerView {
                blocked: peer.blocked,
                silent: peer.silent,
                silence_changes: peer.silence_changes + 1,
                ..PeerView::default()
            };
        }
        self.subscriptions.remove_node(place);
        self.services.remove_node(place);
        self.watches.retain(|_, watch| watch.node != place);
        self.queries.retain(|_, query| query.requester != place);
        for other in (0..self.nodes.len()).filter(|other| *other != place) {
            self.send_presence_update(other, place);
        }
    }

    pub(super) fn pause(&mut self, id: &NodeId) {
        if let Some(&place) = self.indexes.get(id) {
            self.nodes[place].paused = self.nodes[place].alive;
            self.refresh_reachability();
        }
    }

    pub(super) fn resume(&mut self, id: &NodeId) {
        if let Some(&place) = self.indexes.get(id) {
            self.nodes[place].paused = false;
            // With their old times and numbers, so that they keep their order among themselves and before later ones.
            let held = std::mem::take(&mut self.nodes[place].held);
            self.event_queue.extend(held.into_iter().map(Reverse));
            self.refresh_reachability();
        }
    }

    fn hand_over(&mut self, entry: ScheduledEvent) {
        if let Some((from, to)) = entry.event.endpoints() {
            if self.nodes[to].paused {
                return self.nodes[to].held.push(entry);
            }
            if self.nodes[from].paused {
                return self.nodes[from].held.push(entry);
            }
            if self.nodes[to].peers[from].blocked {
                if !matches!(entry.event, Event::Finished { .. }) {
                    self.counters.dropped += 1;
                }
                if let Event::Reply { leg, .. } | Event::Finished { leg, .. } = entry.event {
                    self.break_part(leg);
                }
                return;
            }
        }
        match entry.event {
            Event::Publication { from, to, publication } => self.deliver_publication(from, to, &publication),
            Event::Query { from, to, leg } => self.deliver_query(from, to, leg),
            Event::Reply { from, to, leg, reply } => self.deliver_reply(from, to, leg, reply),
            Event::Finished { leg, .. } => self.end_part(leg),
            Event::QueryTimeout { query } => drop(self.queries.remove(&query)),
            Event::PresenceUpdate { at, of } => self.deliver_presence_update(at, of),
            Event::LeaseExpired { at, of, change } => self.expire_lease(at, of, change),
        }
    }

    /// What a node has sent and received in all its lives.
    pub(super) fn traffic(&self, id: &NodeId) -> TrafficByKind {
        self.indexes.get(id).map(|place| self.nodes[*place].traffic.clone()).unwrap_or_default()
    }

    /// Counts what a node takes from the wire.
    fn count_received(&mut self, from: NodeIndex, to: NodeIndex, kind: KeyKind, bytes: usize) {
        if from != to {
            self.nodes[to].traffic.received(kind, bytes);
        }
    }

    fn count_delivery(&mut self, handed_over: bool) {
        if handed_over {
            self.counters.delivered += 1;
        } else {
            self.counters.dropped += 1;
        }
    }
}
