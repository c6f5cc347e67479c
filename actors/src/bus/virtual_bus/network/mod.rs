//! The state of a virtual network: who has declared what, and what is under way.
//!
//! ```text
//!   VirtualBus ── publish, query, reply ──▶ Network ──▶ agenda (due, number) ──▶ hand_over ──▶ streams
//! ```
//!
//! All that happens is an entry of one agenda, ordered by when it is due and then by a running number, so that one
//! seed gives one run. Nothing here waits: the driver in the parent module calls [`Network::run`] when entries are due.

mod agenda;
mod directory;
mod links;
mod presence;
mod publications;
mod queries;

pub(super) use queries::Question;

use super::Shared;
use super::faults::Faults;
use super::link::{Counters, LinkModel, TrafficByKind};
use super::trace::Trace;
use crate::bus::{Query, Sample};
use agenda::{Entry, Event};
use consort_protocol::ids::NodeId;
use consort_protocol::keys::KeyKind;
use directory::Directory;
use presence::Watch;
use publications::FLOORS_MIN;
use queries::Pending;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, HashMap};
use std::sync::Weak;
use std::time::Duration;
use tokio::time::Instant;
use zenoh_keyexpr::OwnedKeyExpr;

/// Where a node stands in [`Network::nodes`].
pub(super) type Place = usize;

/// A node from its start to its crash. What an earlier life declared or is owed is void.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Life {
    pub(super) place: Place,
    number: u32,
}

/// Names a declaration or a query.
pub(super) type Number = u64;

struct Node {
    id: NodeId,
    life: u32,
    alive: bool,
    paused: bool,
    /// What came due while it could not be handed over because this node was paused.
    held: Vec<Entry>,
    /// Tokens this node has announced.
    tokens: BTreeMap<Number, OwnedKeyExpr>,
    /// How this node sees each node, itself included, by place.
    peers: Vec<Peer>,
    traffic: TrafficByKind,
}

/// How one node sees another.
#[derive(Default)]
struct Peer {
    /// Whether what the other says is lost.
    cut: bool,
    /// Whether nothing is heard from the other now, because it is cut off or one of the two is paused.
    silent: bool,
    /// Grows with every change of `silent`, so that the end of a lease which was renewed is void.
    change: u32,
    /// Whether the other counts as connected: it was heard, and not silent for a whole lease since.
    connected: bool,
    /// The other's tokens, as far as known here.
    tokens: BTreeMap<Number, OwnedKeyExpr>,
}

pub(super) struct Network {
    /// Where the network lives, for those who answer queries.
    home: Weak<Shared>,
    rng: ChaCha8Rng,
    model: LinkModel,
    /// Links that differ from `model`, from and to.
    models: BTreeMap<(NodeId, NodeId), LinkModel>,
    /// The same by place, for those that exist.
    models_here: BTreeMap<(Place, Place), LinkModel>,
    lease: Duration,
    faults: Faults,
    places: BTreeMap<NodeId, Place>,
    nodes: Vec<Node>,
    subscriptions: Directory<Sample>,
    services: Directory<Query>,
    watches: BTreeMap<Number, Watch>,
    queries: BTreeMap<Number, Pending>,
    agenda: BinaryHeap<Reverse<Entry>>,
    /// When the latest publication arrives, by publisher, receiver and key: none on this key arrives before it.
    floors: HashMap<(Place, Place, u64), Instant>,
    floors_max: usize,
    /// Last number given, to anything.
    numbers: u64,
    now: Instant,
    pub(super) counters: Counters,
    pub(super) trace: Trace,
}

impl Network {
    pub(super) fn new(home: Weak<Shared>, seed: u64, model: LinkModel, lease: Duration, now: Instant) -> Self {
        Network {
            home,
            rng: ChaCha8Rng::seed_from_u64(seed),
            model: model.checked(),
            models: BTreeMap::new(),
            models_here: BTreeMap::new(),
            lease,
            faults: Faults::default(),
            places: BTreeMap::new(),
            nodes: Vec::new(),
            subscriptions: Directory::new(),
            services: Directory::new(),
            watches: BTreeMap::new(),
            queries: BTreeMap::new(),
            agenda: BinaryHeap::new(),
            floors: HashMap::new(),
            floors_max: FLOORS_MIN,
            numbers: 0,
            now,
            counters: Counters::default(),
            trace: Trace::new(now),
        }
    }

    /// Tells the time; it never runs backwards.
    pub(super) fn tell(&mut self, now: Instant) {
        self.now = self.now.max(now);
    }

    /// When the next entry is due.
    pub(super) fn next_due(&self) -> Option<Instant> {
        self.agenda.peek().map(|Reverse(entry)| entry.due)
    }

    /// Carries out all that is due, in order.
    pub(super) fn run(&mut self) {
        while let Some(due) = self.next_due() {
            if due > self.now {
                break;
            }
            let Some(Reverse(entry)) = self.agenda.pop() else { break };
            self.hand_over(entry);
        }
    }

    fn number(&mut self) -> Number {
        self.numbers += 1;
        self.numbers
    }

    fn at(&mut self, due: Instant, event: Event) {
        let number = self.number();
        self.agenda.push(Reverse(Entry { due, number, event }));
    }

    /// The present life of a node, which begins now if it has none.
    pub(super) fn start(&mut self, id: NodeId) -> Life {
        let place = match self.places.get(&id) {
            Some(&place) if self.nodes[place].alive => return self.life(place),
            Some(&place) => place,
            None => self.add(id),
        };
        self.nodes[place].alive = true;
        self.nodes[place].paused = false;
        self.refresh_silence();
        for other in 0..self.nodes.len() {
            self.tell_news(other, place);
            if other != place {
                self.tell_news(place, other);
            }
        }
        self.life(place)
    }

    fn add(&mut self, id: NodeId) -> Place {
        let place = self.nodes.len();
        self.places.insert(id.clone(), place);
        for node in &mut self.nodes {
            node.peers.push(Peer::default());
        }
        self.nodes.push(Node {
            id,
            life: 0,
            alive: false,
            paused: false,
            held: Vec::new(),
            tokens: BTreeMap::new(),
            peers: (0..=place).map(|_| Peer::default()).collect(),
            traffic: TrafficByKind::default(),
        });
        self.refresh_models();
        place
    }

    fn life(&self, place: Place) -> Life {
        Life { place, number: self.nodes[place].life }
    }

    /// Whether a life goes on.
    pub(super) fn lives(&self, life: Life) -> bool {
        let node = &self.nodes[life.place];
        node.alive && node.life == life.number
    }

    /// Nodes that `place` is connected to.
    pub(super) fn neighbours(&self, place: Place) -> impl Iterator<Item = &NodeId> {
        self.places
            .iter()
            .filter(move |(_, p)| **p != place && self.nodes[place].peers[**p].connected)
            .map(|(id, _)| id)
    }

    /// Ends a node's life. What it has sent stays under way.
    pub(super) fn crash(&mut self, id: &NodeId) {
        let Some(&place) = self.places.get(id) else { return };
        if !self.nodes[place].alive {
            return;
        }
        self.resume(id);
        let node = &mut self.nodes[place];
        node.alive = false;
        node.life += 1;
        node.tokens.clear();
        for peer in &mut node.peers {
            *peer = Peer { cut: peer.cut, silent: peer.silent, change: peer.change + 1, ..Peer::default() };
        }
        self.subscriptions.withdraw_all(place);
        self.services.withdraw_all(place);
        self.watches.retain(|_, watch| watch.place != place);
        self.queries.retain(|_, query| query.asker != place);
        for other in (0..self.nodes.len()).filter(|other| *other != place) {
            self.tell_news(other, place);
        }
    }

    pub(super) fn pause(&mut self, id: &NodeId) {
        if let Some(&place) = self.places.get(id) {
            self.nodes[place].paused = self.nodes[place].alive;
            self.refresh_silence();
        }
    }

    pub(super) fn resume(&mut self, id: &NodeId) {
        if let Some(&place) = self.places.get(id) {
            self.nodes[place].paused = false;
            // With their old times and numbers, so that they keep their order among themselves and before later ones.
            let held = std::mem::take(&mut self.nodes[place].held);
            self.agenda.extend(held.into_iter().map(Reverse));
            self.refresh_silence();
        }
    }

    fn hand_over(&mut self, entry: Entry) {
        if let Some((from, to)) = entry.event.ends() {
            if self.nodes[to].paused {
                return self.nodes[to].held.push(entry);
            }
            if self.nodes[from].paused {
                return self.nodes[from].held.push(entry);
            }
            if self.nodes[to].peers[from].cut {
                if !matches!(entry.event, Event::Finished { .. }) {
                    self.counters.dropped += 1;
                }
                if let Event::Answer { leg, .. } | Event::Finished { leg, .. } = entry.event {
                    self.break_leg(leg);
                }
                return;
            }
        }
        match entry.event {
            Event::Publication { from, to, publication } => self.deliver(from, to, &publication),
            Event::Question { from, to, leg } => self.deliver_question(from, to, leg),
            Event::Answer { from, to, leg, reply } => self.deliver_answer(from, to, leg, reply),
            Event::Finished { leg, .. } => self.end_leg(leg),
            Event::Limit { query } => drop(self.queries.remove(&query)),
            Event::News { at, of } => self.deliver_news(at, of),
            Event::LeaseOver { at, of, change } => self.end_lease(at, of, change),
        }
    }

    /// What a node has sent and received in all its lives.
    pub(super) fn traffic(&self, id: &NodeId) -> TrafficByKind {
        self.places.get(id).map(|place| self.nodes[*place].traffic.clone()).unwrap_or_default()
    }

    /// Counts what a node takes from the wire.
    fn note_received(&mut self, from: Place, to: Place, kind: KeyKind, bytes: usize) {
        if from != to {
            self.nodes[to].traffic.received(kind, bytes);
        }
    }

    fn count(&mut self, handed_over: bool) {
        if handed_over {
            self.counters.delivered += 1;
        } else {
            self.counters.dropped += 1;
        }
    }
}
