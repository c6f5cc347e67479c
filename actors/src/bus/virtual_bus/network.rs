//! The state of a virtual network: who has declared what, and what is under way.
//!
//! ```text
//!   VirtualBus ── publish, query, reply ──▶ Network ──▶ agenda (due, number) ──▶ hand_over ──▶ streams
//! ```
//!
//! All that happens is an entry of one agenda, ordered by when it is due and then by a running number, so that one
//! seed gives one run. Nothing here waits: the driver in the parent module calls [`Network::run`] when entries are due.

use super::Shared;
use super::faults::Faults;
use super::link::{Counters, LinkModel};
use super::responder::{Leg, Responder};
use super::trace::Trace;
use crate::bus::{Presence, Query, Reply, Sample};
use bytes::Bytes;
use consort_protocol::ids::NodeId;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, HashMap};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::{Arc, Weak};
use std::time::Duration;
use tokio::sync::mpsc::UnboundedSender;
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

/// Keys whose receivers are remembered; beyond this all are forgotten and found anew.
const ROUTES_MAX: usize = 65_536;

/// Ends of order (see [`Network::floors`]) kept before those in the past are swept out.
const FLOORS_MIN: usize = 4_096;

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

/// A subscription or a service: where it is and what it wants.
struct Declaration<T> {
    place: Place,
    wanted: OwnedKeyExpr,
    mailbox: UnboundedSender<T>,
}

struct Watch {
    place: Place,
    wanted: OwnedKeyExpr,
    mailbox: UnboundedSender<Presence>,
    /// How many tokens are known under each key.
    present: BTreeMap<String, u32>,
}

/// Declarations of one kind, and which of them match keys used lately.
struct Directory<T> {
    declared: BTreeMap<Number, Declaration<T>>,
    routes: HashMap<String, Arc<Route>>,
    /// Grows whenever a declaration comes or goes: a route found under the same number is still right.
    edition: u64,
}

/// The declarations that match a key.
struct Route {
    key: OwnedKeyExpr,
    /// Stands for the key where a number is handier. Two keys with one hash would merely be ordered together.
    hash: u64,
    /// By place, in order.
    targets: Vec<(Place, Vec<Number>)>,
}

impl<T> Directory<T> {
    fn new() -> Self {
        Directory { declared: BTreeMap::new(), routes: HashMap::new(), edition: 0 }
    }

    fn declare(&mut self, number: Number, declaration: Declaration<T>) {
        self.changed(&declaration.wanted);
        self.declared.insert(number, declaration);
    }

    fn withdraw(&mut self, number: Number) {
        if let Some(gone) = self.declared.remove(&number) {
            self.changed(&gone.wanted);
        }
    }

    fn withdraw_all(&mut self, place: Place) {
        self.declared.retain(|_, declaration| declaration.place != place);
        self.edition += 1;
        self.routes.clear();
    }

    fn changed(&mut self, wanted: &OwnedKeyExpr) {
        self.edition += 1;
        self.routes.retain(|_, route| !route.key.intersects(wanted));
    }

    fn known_route(&self, key: &str) -> Option<Arc<Route>> {
        self.routes.get(key).cloned()
    }

    fn route(&mut self, key: &OwnedKeyExpr) -> Arc<Route> {
        if let Some(route) = self.routes.get(key.as_str()) {
            return Arc::clone(route);
        }
        let mut targets: BTreeMap<Place, Vec<Number>> = BTreeMap::new();
        for (number, declaration) in &self.declared {
            if declaration.wanted.intersects(key) {
                targets.entry(declaration.place).or_default().push(*number);
            }
        }
        let mut hasher = DefaultHasher::new();
        key.as_str().hash(&mut hasher);
        let route = Arc::new(Route { key: key.clone(), hash: hasher.finish(), targets: targets.into_iter().collect() });
        if self.routes.len() >= ROUTES_MAX {
            self.routes.clear();
        }
        self.routes.insert(key.to_string(), Arc::clone(&route));
        route
    }
}

/// A publication under way, shared by all who will receive it.
struct Publication {
    sample: Sample,
    route: Arc<Route>,
    edition: u64,
}

/// A query that has not ended.
struct Pending {
    asker: Place,
    replies: UnboundedSender<Reply>,
    question: Arc<Question>,
    /// By number of the service asked.
    legs: BTreeMap<Number, LegState>,
}

pub(super) struct Question {
    pub(super) wanted: OwnedKeyExpr,
    pub(super) parameters: String,
    pub(super) payload: Bytes,
}

/// What is left of one service's part in a query.
struct LegState {
    service: Life,
    /// Something of it got lost, and so will all that follows.
    broken: bool,
    /// When the latest answer arrives; none arrives before it.
    floor: Instant,
}

/// Something that happens at its time.
struct Entry {
    due: Instant,
    number: u64,
    event: Event,
}

enum Event {
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

impl PartialEq for Entry {
    fn eq(&self, other: &Self) -> bool {
        (self.due, self.number) == (other.due, other.number)
    }
}

impl Eq for Entry {}

impl PartialOrd for Entry {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Entry {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (self.due, self.number).cmp(&(other.due, other.number))
    }
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

    // Nodes.

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

    // Links.

    pub(super) fn set_model(&mut self, model: LinkModel) {
        self.model = model.checked();
        self.models.clear();
        self.refresh_models();
    }

    pub(super) fn set_model_between(&mut self, from: NodeId, to: NodeId, model: LinkModel) {
        self.models.insert((from, to), model.checked());
        self.refresh_models();
    }

    fn refresh_models(&mut self) {
        let place = |id: &NodeId| self.places.get(id).copied();
        self.models_here = self
            .models
            .iter()
            .filter_map(|((from, to), model)| Some(((place(from)?, place(to)?), model.clone())))
            .collect();
    }

    pub(super) fn set_lease(&mut self, lease: Duration) {
        self.lease = lease;
    }

    pub(super) fn change_faults(&mut self, change: impl FnOnce(&mut Faults)) {
        change(&mut self.faults);
        self.refresh_silence();
    }

    /// Compares who can hear whom with the faults in force; a lease begins where silence falls, and news travel where
    /// it ends.
    fn refresh_silence(&mut self) {
        for at in 0..self.nodes.len() {
            for of in (0..self.nodes.len()).filter(|of| *of != at) {
                let cut = self.faults.sever(&self.nodes[of].id, &self.nodes[at].id);
                let silent = cut || self.nodes[at].paused || self.nodes[of].paused;
                let peer = &mut self.nodes[at].peers[of];
                peer.cut = cut;
                if peer.silent == silent {
                    continue;
                }
                peer.silent = silent;
                peer.change += 1;
                let change = peer.change;
                if silent {
                    self.at(self.now + self.lease, Event::LeaseOver { at, of, change });
                } else {
                    self.tell_news(at, of);
                }
            }
        }
    }

    /// When a message that leaves now arrives, unless it is lost.
    fn cross(&mut self, from: Place, to: Place) -> Option<Instant> {
        self.counters.sent += 1;
        if from == to {
            return Some(self.now);
        }
        if self.nodes[to].peers[from].cut {
            self.counters.dropped += 1;
            return None;
        }
        let loss = self.model_between(from, to).loss;
        if loss > 0.0 && self.rng.random_bool(loss) {
            self.counters.dropped += 1;
            return None;
        }
        Some(self.now + self.latency(from, to))
    }

    fn latency(&mut self, from: Place, to: Place) -> Duration {
        if from == to {
            return Duration::ZERO;
        }
        let model = self.model_between(from, to);
        let (min, max) = (model.latency_min, model.latency_max);
        self.between(min, max)
    }

    fn between(&mut self, min: Duration, max: Duration) -> Duration {
        if min >= max {
            return min;
        }
        let spread = u64::try_from((max - min).as_nanos()).unwrap_or(u64::MAX);
        min + Duration::from_nanos(self.rng.random_range(0..=spread))
    }

    fn model_between(&self, from: Place, to: Place) -> &LinkModel {
        if self.models_here.is_empty() {
            return &self.model;
        }
        self.models_here.get(&(from, to)).unwrap_or(&self.model)
    }

    // Publications.

    /// The key, if it was used lately and hence is known to be one.
    pub(super) fn known_key(&self, key: &str) -> Option<OwnedKeyExpr> {
        self.subscriptions.known_route(key).map(|route| route.key.clone())
    }

    pub(super) fn subscribe(&mut self, life: Life, wanted: OwnedKeyExpr, mailbox: UnboundedSender<Sample>) -> Number {
        let number = self.number();
        self.subscriptions.declare(number, Declaration { place: life.place, wanted, mailbox });
        number
    }

    pub(super) fn unsubscribe(&mut self, number: Number) {
        self.subscriptions.withdraw(number);
    }

    pub(super) fn publish(&mut self, life: Life, key: &OwnedKeyExpr, sample: Sample) {
        let from = life.place;
        let route = self.subscriptions.route(key);
        if route.targets.is_empty() {
            return;
        }
        let edition = self.subscriptions.edition;
        let publication = Arc::new(Publication { sample, route: Arc::clone(&route), edition });
        for (to, _) in &route.targets {
            self.send_publication(from, *to, &publication);
        }
    }

    fn send_publication(&mut self, from: Place, to: Place, publication: &Arc<Publication>) {
        let Some(arrival) = self.cross(from, to) else { return };
        let to_life = self.life(to);
        let event = |publication: &Arc<Publication>| Event::Publication {
            from,
            to: to_life,
            publication: Arc::clone(publication),
        };
        if from == to {
            self.at(arrival, event(publication));
            return;
        }
        let model = self.model_between(from, to);
        let (duplication, reordering, delay) = (model.duplication, model.reordering, model.reordering_delay);
        if reordering > 0.0 && self.rng.random_bool(reordering) {
            let late = arrival + self.between(Duration::ZERO, delay);
            self.at(late, event(publication));
        } else {
            let due = self.in_order(from, to, publication.route.hash, arrival);
            self.at(due, event(publication));
        }
        if duplication > 0.0 && self.rng.random_bool(duplication) {
            self.counters.duplicated += 1;
            let again = self.now + self.latency(from, to);
            let due = self.in_order(from, to, publication.route.hash, again);
            self.at(due, event(publication));
        }
    }

    /// The arrival, put off until no earlier publication on the key is overtaken.
    fn in_order(&mut self, from: Place, to: Place, key: u64, arrival: Instant) -> Instant {
        if self.floors.len() >= self.floors_max {
            let now = self.now;
            self.floors.retain(|_, floor| *floor > now);
            self.floors_max = FLOORS_MIN.max(2 * self.floors.len());
        }
        let floor = self.floors.entry((from, to, key)).or_insert(arrival);
        *floor = arrival.max(*floor);
        *floor
    }

    // Queries.

    pub(super) fn serve(&mut self, life: Life, wanted: OwnedKeyExpr, mailbox: UnboundedSender<Query>) -> Number {
        let number = self.number();
        self.services.declare(number, Declaration { place: life.place, wanted, mailbox });
        number
    }

    pub(super) fn stop_serving(&mut self, number: Number) {
        self.services.withdraw(number);
    }

    pub(super) fn ask(
        &mut self,
        life: Life,
        question: Question,
        limit: Duration,
        replies: UnboundedSender<Reply>,
    ) -> Number {
        let asker = life.place;
        let query = self.number();
        let route = self.services.route(&question.wanted);
        let mut legs = BTreeMap::new();
        for (place, services) in &route.targets {
            let there = &self.nodes[*place].peers[asker];
            if there.cut && !self.nodes[asker].peers[*place].connected {
                continue; // given up: its services are known no more
            }
            for service in services {
                let arrival = self.cross(asker, *place);
                let state = LegState { service: self.life(*place), broken: false, floor: self.now };
                if let Some(arrival) = arrival {
                    let leg = Leg { query, service: *service };
                    self.at(arrival, Event::Question { from: asker, to: state.service, leg });
                }
                legs.insert(*service, state);
            }
        }
        if !legs.is_empty() {
            self.queries.insert(query, Pending { asker, replies, question: Arc::new(question), legs });
            self.at(self.now + limit, Event::Limit { query });
        }
        query
    }

    pub(super) fn stop_asking(&mut self, query: Number) {
        self.queries.remove(&query);
    }

    pub(super) fn answer(&mut self, leg: Leg, reply: Reply) {
        if let Some((from, to, due)) = self.send_answer(leg, true) {
            self.at(due, Event::Answer { from, to, leg, reply });
        }
    }

    pub(super) fn finish(&mut self, leg: Leg) {
        if let Some((from, to, due)) = self.send_answer(leg, false) {
            self.at(due, Event::Finished { from, to, leg });
        }
    }

    /// From, to and arrival of the next message of a leg, if the query goes on and the message is not lost. Only
    /// answers are counted; the end of a leg is a message like any other in every other respect.
    fn send_answer(&mut self, leg: Leg, counted: bool) -> Option<(Place, Place, Instant)> {
        let pending = self.queries.get(&leg.query)?;
        let state = pending.legs.get(&leg.service)?;
        let (from, to) = (state.service.place, pending.asker);
        if state.broken || !self.lives(state.service) {
            return None;
        }
        let before = self.counters;
        let arrival = self.cross(from, to);
        if !counted {
            self.counters = before;
        }
        let state = self.queries.get_mut(&leg.query)?.legs.get_mut(&leg.service)?;
        match arrival {
            Some(arrival) => {
                state.floor = state.floor.max(arrival);
                Some((from, to, state.floor))
            }
            None => {
                state.broken = true;
                None
            }
        }
    }

    // Presence.

    pub(super) fn announce(&mut self, life: Life, key: OwnedKeyExpr) -> Number {
        let number = self.number();
        self.nodes[life.place].tokens.insert(number, key);
        self.spread(life.place);
        number
    }

    pub(super) fn renounce(&mut self, number: Number) {
        let owner = self.nodes.iter_mut().position(|node| node.tokens.remove(&number).is_some());
        if let Some(place) = owner {
            self.spread(place);
        }
    }

    fn spread(&mut self, of: Place) {
        for at in 0..self.nodes.len() {
            self.tell_news(at, of);
        }
    }

    fn tell_news(&mut self, at: Place, of: Place) {
        if !self.nodes[at].peers[of].silent {
            let latency = self.latency(of, at);
            self.at(self.now + latency, Event::News { at, of });
        }
    }

    pub(super) fn watch(&mut self, life: Life, wanted: OwnedKeyExpr, mailbox: UnboundedSender<Presence>) -> Number {
        let number = self.number();
        let mut watch = Watch { place: life.place, wanted, mailbox, present: BTreeMap::new() };
        for peer in &self.nodes[life.place].peers {
            for key in peer.tokens.values() {
                watch.see(key, true);
            }
        }
        self.watches.insert(number, watch);
        number
    }

    pub(super) fn stop_watching(&mut self, number: Number) {
        self.watches.remove(&number);
    }

    /// Brings what `at` knows of `of` to `connected` and `tokens`, and tells those who watch at `at`.
    fn learn(&mut self, at: Place, of: Place, connected: bool, tokens: BTreeMap<Number, OwnedKeyExpr>) {
        let peer = &mut self.nodes[at].peers[of];
        peer.connected = connected;
        let before = std::mem::replace(&mut peer.tokens, tokens);
        let after = &self.nodes[at].peers[of].tokens;
        let gone = before.iter().filter(|(number, _)| !after.contains_key(number)).map(|(_, key)| (key, false));
        let new = after.iter().filter(|(number, _)| !before.contains_key(number)).map(|(_, key)| (key, true));
        for (key, alive) in gone.chain(new) {
            for watch in self.watches.values_mut().filter(|watch| watch.place == at) {
                watch.see(key, alive);
            }
        }
    }

    /// Ends the legs of `at`'s queries at services of `of` that fit.
    fn give_up(&mut self, at: Place, of: Place, fits: impl Fn(&LegState) -> bool) {
        self.queries.retain(|_, query| {
            if query.asker == at {
                query.legs.retain(|_, leg| leg.service.place != of || !fits(leg));
            }
            !query.legs.is_empty()
        });
    }

    // What comes due.

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

    fn count(&mut self, handed_over: bool) {
        if handed_over {
            self.counters.delivered += 1;
        } else {
            self.counters.dropped += 1;
        }
    }

    fn deliver(&mut self, from: Place, to: Life, publication: &Publication) {
        let mut heard = false;
        if self.lives(to) {
            let subscriptions = &mut self.subscriptions;
            let newer =
                (subscriptions.edition != publication.edition).then(|| subscriptions.route(&publication.route.key));
            let route = newer.as_ref().unwrap_or(&publication.route);
            if let Ok(found) = route.targets.binary_search_by_key(&to.place, |(place, _)| *place) {
                for number in &route.targets[found].1 {
                    if let Some(subscription) = subscriptions.declared.get(number) {
                        heard |= subscription.mailbox.send(publication.sample.clone()).is_ok();
                    }
                }
            }
        }
        if heard {
            self.trace.note(self.now, from, to.place, publication.route.hash, &publication.sample.payload);
        }
        self.count(heard);
    }

    fn deliver_question(&mut self, from: Place, to: Life, leg: Leg) {
        let question = self.queries.get(&leg.query).map(|query| Arc::clone(&query.question));
        let service = self.services.declared.get(&leg.service).filter(|_| self.lives(to));
        let (Some(question), Some(service)) = (question, service) else {
            self.count(false);
            return self.finish(leg); // nobody listens there any more
        };
        let query = Query {
            key: question.wanted.to_string(),
            parameters: question.parameters.clone(),
            payload: question.payload.clone(),
            replier: Box::new(Responder::new(self.home.clone(), leg, to, Arc::clone(&question))),
        };
        let heard = service.mailbox.send(query).is_ok();
        self.trace.note(self.now, from, to.place, leg.service, &question.payload);
        self.count(heard);
    }

    fn deliver_answer(&mut self, from: Place, to: Place, leg: Leg, reply: Reply) {
        let Some(query) = self.queries.get(&leg.query) else { return self.count(false) };
        let content = match &reply.payload {
            Ok(payload) => payload.clone(),
            Err(reason) => Bytes::copy_from_slice(reason.as_bytes()),
        };
        let heard = query.replies.send(reply).is_ok();
        self.trace.note(self.now, from, to, leg.service, &content);
        self.count(heard);
    }

    fn break_leg(&mut self, leg: Leg) {
        if let Some(state) = self.queries.get_mut(&leg.query).and_then(|query| query.legs.get_mut(&leg.service)) {
            state.broken = true;
        }
    }

    fn end_leg(&mut self, leg: Leg) {
        if let Some(query) = self.queries.get_mut(&leg.query) {
            query.legs.remove(&leg.service);
            if query.legs.is_empty() {
                self.queries.remove(&leg.query);
            }
        }
    }

    fn deliver_news(&mut self, at: Place, of: Place) {
        if self.nodes[at].peers[of].silent || !self.nodes[at].alive {
            return; // news travel again when the silence ends
        }
        let of_now = self.life(of);
        let alive = self.lives(of_now);
        self.learn(at, of, alive, self.nodes[of].tokens.clone());
        self.give_up(at, of, |leg| !alive || leg.service != of_now);
    }

    fn end_lease(&mut self, at: Place, of: Place, change: u32) {
        let peer = &self.nodes[at].peers[of];
        if peer.silent && peer.change == change {
            self.learn(at, of, false, BTreeMap::new());
            self.give_up(at, of, |_| true);
        }
    }
}

impl Event {
    /// Between whom a message travels; `None` for what is no message.
    fn ends(&self) -> Option<(Place, Place)> {
        match self {
            Event::Publication { from, to, .. } | Event::Question { from, to, .. } => Some((*from, to.place)),
            Event::Answer { from, to, .. } | Event::Finished { from, to, .. } => Some((*from, *to)),
            Event::Limit { .. } | Event::News { .. } | Event::LeaseOver { .. } => None,
        }
    }
}

impl Watch {
    fn see(&mut self, key: &OwnedKeyExpr, alive: bool) {
        if !self.wanted.intersects(key) {
            return;
        }
        let count = self.present.entry(key.to_string()).or_insert(0);
        let before = *count;
        *count = if alive { before + 1 } else { before.saturating_sub(1) };
        let after = *count;
        if after == 0 {
            self.present.remove(key.as_str());
        }
        if (before == 0) != (after == 0) {
            // A watcher that is gone has no ear for this.
            let _ = self.mailbox.send(Presence { key: key.to_string(), alive });
        }
    }
}
