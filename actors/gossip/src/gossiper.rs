//! Decisions of gossip as a state machine: it takes [`Event`]s and returns [`Action`]s, and never
//! blocks.

use super::exchange::ExchangeCursors;
use super::record_store::{MergeOutcome, RecordStore};
use super::settings::Settings;
use super::shared::{GossipState, MemberStatus};
use super::swim::{Suspicion, Swim, SwimAction, Timer};
use bytes::Bytes;
use consort_bus::record_signer::SharedRecordSigner;
use consort_protocol::ids::NodeId;
use consort_protocol::knowledge::{Digest, DigestScope, Knowledge, Record, RecordStamp};
use consort_protocol::message::{Exchange, RecordUpdate};
use consort_protocol::units::NodeTime;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// A change of the own knowledge.
pub(super) type Change = Box<dyn FnOnce(&mut Knowledge) + Send>;

/// An input of the state machine.
#[expect(clippy::large_enum_variant, reason = "a single event exists at a time")]
pub(super) enum Event {
    /// The node's own knowledge changes.
    KnowledgeChanged(Change),
    /// A node published an update of its record.
    Published(NodeId, RecordUpdate),
    /// A packet of failure detection arrived.
    Packet(Bytes),
    /// A node's presence token appeared or vanished.
    Token(NodeId, bool),
    /// A peer compares digests with this node.
    RequestReceived(Exchange),
    /// A peer replied in this round, or no reply arrived.
    ReplyReceived(u64, Option<Exchange>),
    /// The time last returned by [`Gossiper::next_due`] has come.
    TimerFired,
    /// The fleet writes another wire version, with or without proofs. The own record is published
    /// again, in full.
    VersionRaised {
        /// True if forwarded records carry proofs in this version.
        with_proofs: bool,
    },
}

/// An effect for the caller to perform, in the order given.
#[expect(clippy::large_enum_variant, reason = "few actions exist at a time")]
#[derive(Debug, PartialEq)]
pub(super) enum Action {
    /// Publish an update of the own record.
    Publish(RecordUpdate),
    /// Send a packet to a node.
    Send(NodeId, Bytes),
    /// Compare digests with a peer, and return its reply as [`Event::ReplyReceived`] with the same
    /// number.
    SendRequest(u64, NodeId, Exchange),
    /// Reply to [`Event::RequestReceived`].
    SendReply(Exchange),
}

/// A timer.
#[derive(Debug)]
enum ScheduledTimer {
    Heartbeat,
    Round,
    Announce,
    Swim(Timer),
    /// A node with a vanished token should have answered by now. The number distinguishes this
    /// query from earlier ones.
    QueryTimeout(NodeId, u64),
    /// The node was then suspected, and should have refuted the suspicion by now.
    SuspicionTimeout(Suspicion, NodeId, u64),
}

/// A round of anti-entropy in progress.
struct Round {
    number: u64,
    peer: NodeId,
    /// Messages to the peer that contained a digest; the initial sums do not count.
    messages: u32,
    /// Records sent to the peer in this round. They are not sent twice, even if the peer rejects
    /// them.
    sent: BTreeSet<(NodeId, RecordStamp)>,
}

/// Maximum number of messages to a peer per round; the rest waits for the next round.
const MESSAGES_PER_ROUND: u32 = 4;

/// Time for which the whole record is repeated after a change, or after a node joined. Then only
/// refreshes are published; a node that missed the record queries it. Raised: more traffic, and
/// fewer queries. 10 s: as many repetitions as needed on a link that loses half of all messages.
const FULL_RECORD_PERIOD: Duration = Duration::from_secs(10);

/// Extension of the heartbeat interval per node, once there are too many nodes for the shortest
/// interval. 50 ms: a node receives at most 20 heartbeats a second, until the interval reaches its
/// maximum.
const INTERVAL_PER_NODE: Duration = Duration::from_millis(50);

/// Maximum number of announcements at once, and the pause before the next. When hundreds of nodes
/// start together, the replies to the first few announcements introduce most of the others.
const ANNOUNCEMENTS_MAX: usize = 5;
const ANNOUNCEMENT_PAUSE: Duration = Duration::from_millis(100);

/// Maximum lead of an earlier incarnation over this one, in milliseconds: a century, for clocks
/// that were set wrongly. A larger stamp is forged, and would exhaust the node's own stamps.
const INCARNATION_LEAD_MAX: u64 = 100 * 366 * 24 * 3600 * 1000;

pub(super) struct Gossiper {
    settings: Settings,
    records: RecordStore,
    swim: Swim,
    rng: ChaCha8Rng,
    agenda: BTreeMap<(NodeTime, u64), ScheduledTimer>,
    /// Last assigned number, for timers due at the same instant, rounds and queries.
    last_number: u64,
    tokens: BTreeSet<NodeId>,
    to_announce: BTreeSet<NodeId>,
    queried: BTreeMap<NodeId, u64>,
    round: Option<Round>,
    cursors: ExchangeCursors,
    /// True if the last round completed. The next round may then find no difference, and begins
    /// with sums.
    last_round_completed: bool,
    /// Owners with an update that this node missed.
    missing_from: BTreeSet<NodeId>,
    /// End of the period in which the whole record is repeated.
    full_record_until: NodeTime,
    changed: bool,
    /// Time of the last publication of the own record.
    last_published: NodeTime,
}

impl Gossiper {
    /// Creates the state machine and returns the first actions.
    pub(super) fn new(
        settings: Settings,
        knowledge: Knowledge,
        signer: Option<SharedRecordSigner>,
        mut rng: ChaCha8Rng,
        state: &mut GossipState,
        now: NodeTime,
    ) -> (Gossiper, Vec<Action>) {
        // Nodes that were alive for an earlier actor must be contacted again.
        state.status = BTreeMap::from([(settings.node.clone(), MemberStatus::Alive { since: now })]);
        let records = RecordStore::new(settings.node.clone(), settings.incarnation, knowledge, signer, state, now);
        let swim =
            Swim::new(settings.node.clone(), settings.incarnation, settings.swim(), ChaCha8Rng::from_rng(&mut rng));
        let mut gossiper = Gossiper {
            records,
            swim,
            agenda: BTreeMap::new(),
            last_number: 0,
            tokens: BTreeSet::new(),
            to_announce: BTreeSet::new(),
            queried: BTreeMap::new(),
            round: None,
            cursors: ExchangeCursors::default(),
            last_round_completed: false,
            missing_from: BTreeSet::new(),
            full_record_until: now,
            changed: true,
            last_published: now,
            settings,
            rng,
        };
        // Nodes that start together must not stay synchronized.
        let (heartbeat_interval, round) = (gossiper.settings.heartbeat, gossiper.settings.round);
        let (heartbeat_interval, round) = (gossiper.random_up_to(heartbeat_interval), gossiper.random_up_to(round));
        gossiper.at(now + heartbeat_interval, ScheduledTimer::Heartbeat);
        gossiper.at(now + round, ScheduledTimer::Round);
        let first = gossiper.publish(state, now);
        (gossiper, vec![first])
    }

    /// Returns the time of the next timer.
    pub(super) fn next_due(&self) -> Option<NodeTime> {
        self.agenda.first_key_value().map(|((at, _), _)| *at)
    }

    /// Returns and clears the flag that readable state has changed.
    pub(super) fn take_changed(&mut self) -> bool {
        std::mem::take(&mut self.changed)
    }

    /// Handles an event. An error is the reason why a message is invalid; the message has changed
    /// nothing.
    pub(super) fn handle(
        &mut self,
        event: Event,
        state: &mut GossipState,
        now: NodeTime,
    ) -> Result<Vec<Action>, String> {
        let mut actions = vec![];
        match event {
            Event::KnowledgeChanged(change) => self.change(change, state, now, &mut actions)?,
            Event::Published(owner, update) => self.handle_update(owner, update, state, now, &mut actions)?,
            Event::Packet(bytes) => {
                let (from, swim_actions) = self.swim.receive(&bytes)?;
                self.queried.remove(&from);
                self.perform_swim(swim_actions, state, now, &mut actions);
            }
            Event::Token(node, present) => self.token(node, present, state, now, &mut actions)?,
            Event::RequestReceived(exchange) => self.handle_request(exchange, state, now, &mut actions)?,
            Event::ReplyReceived(number, Some(exchange)) => {
                self.handle_reply(number, exchange, state, now, &mut actions)?;
            }
            Event::ReplyReceived(number, None) => {
                if self.round.take_if(|round| round.number == number).is_some() {
                    self.last_round_completed = false;
                }
            }
            Event::TimerFired => self.fire_timers(state, now, &mut actions)?,
            Event::VersionRaised { with_proofs } => {
                if with_proofs {
                    self.changed |= self.records.remove_unproven(state);
                }
                self.records.republish(state, now);
                actions.push(self.publish(state, now));
            }
        }
        Ok(actions)
    }

    /// Announces that the node leaves.
    pub(super) fn leave(&mut self) -> Vec<Action> {
        let swim_actions = self.swim.leave().unwrap_or_default();
        let send = |action| match action {
            SwimAction::Send(to, bytes) => Some(Action::Send(to, bytes)),
            SwimAction::SetTimer(..)
            | SwimAction::Up(_)
            | SwimAction::Down(_)
            | SwimAction::Suspected(_)
            | SwimAction::Cleared(_)
            | SwimAction::Rejoined => None,
        };
        swim_actions.into_iter().filter_map(send).collect()
    }

    fn change(
        &mut self,
        change: Change,
        state: &mut GossipState,
        now: NodeTime,
        actions: &mut Vec<Action>,
    ) -> Result<(), String> {
        match self.records.update(change, state, now) {
            Ok(false) => {}
            Ok(true) => {
                self.changed = true;
                actions.push(self.publish(state, now));
            }
            Err(bytes) => return Err(format!("own record not changed: {bytes} bytes exceed the limit")),
        }
        Ok(())
    }

    fn handle_update(
        &mut self,
        owner: NodeId,
        update: RecordUpdate,
        state: &mut GossipState,
        now: NodeTime,
        actions: &mut Vec<Action>,
    ) -> Result<(), String> {
        match update {
            RecordUpdate::Record(record) => {
                let stamp = record.stamp;
                self.receive(record, state, now, actions)?;
                state.base.confirm(&owner, stamp, now);
            }
            RecordUpdate::Refresh { stamp, since, proof } => {
                match self.records.receive_refresh(&owner, stamp, since, proof, state, now) {
                    MergeOutcome::Missing => drop(self.missing_from.insert(owner.clone())),
                    MergeOutcome::Own(stamp) => self.overtake(stamp, state, now, actions)?,
                    MergeOutcome::Stale | MergeOutcome::Renewed | MergeOutcome::Changed => {}
                }
            }
        }
        // A publisher deserves an announcement. Receiving from it is no proof that it receives from
        // this node.
        self.schedule_announcement(owner, state, now);
        Ok(())
    }

    fn receive(
        &mut self,
        record: Record,
        state: &mut GossipState,
        now: NodeTime,
        actions: &mut Vec<Action>,
    ) -> Result<bool, String> {
        let owner = record.owner.clone();
        match self.records.receive(record, state, now) {
            MergeOutcome::Stale => return Ok(false),
            MergeOutcome::Renewed | MergeOutcome::Missing => {}
            MergeOutcome::Changed => self.changed = true,
            MergeOutcome::Own(stamp) => {
                self.overtake(stamp, state, now, actions)?;
                return Ok(false);
            }
        }
        self.missing_from.remove(&owner);
        self.schedule_announcement(owner, state, now);
        Ok(true)
    }

    /// Handles a stamp of this node that is later than its own.
    fn overtake(
        &mut self,
        stamp: RecordStamp,
        state: &mut GossipState,
        now: NodeTime,
        actions: &mut Vec<Action>,
    ) -> Result<(), String> {
        if stamp.incarnation > self.settings.incarnation.saturating_add(INCARNATION_LEAD_MAX) {
            return Err(format!("rejected a stamp of this node with the impossible incarnation {}", stamp.incarnation));
        }
        tracing::warn!(node = %self.settings.node, ?stamp, "other nodes have a later record of this node than it wrote: an \
            earlier incarnation was higher, or another node has the same name");
        self.records.overtake(stamp, state, now);
        actions.push(self.publish(state, now));
        let swim_actions = self.swim.adopt_incarnation(stamp.incarnation)?;
        self.perform_swim(swim_actions, state, now, actions);
        Ok(())
    }

    /// Merges the records from a peer. Returns true if any of them was new.
    fn merge_records(
        &mut self,
        records: Vec<Record>,
        digest: &Digest,
        state: &mut GossipState,
        now: NodeTime,
        actions: &mut Vec<Action>,
    ) -> Result<bool, String> {
        let mut any_new = false;
        for record in records {
            any_new |= self.receive(record, state, now, actions)?;
        }
        // Records of dead nodes are not forwarded, and this node is dead for peers that store its
        // later incarnation. Their digest contains the stamp.
        if let Some(stamp) = digest.get(&self.settings.node).filter(|stamp| **stamp > self.records.own().stamp) {
            self.overtake(*stamp, state, now, actions)?;
        }
        Ok(any_new)
    }

    fn token(
        &mut self,
        node: NodeId,
        present: bool,
        state: &mut GossipState,
        now: NodeTime,
        actions: &mut Vec<Action>,
    ) -> Result<(), String> {
        if node == self.settings.node {
            return Ok(());
        }
        if present {
            self.tokens.insert(node.clone());
            self.queried.remove(&node);
            self.schedule_announcement(node, state, now);
        } else {
            self.tokens.remove(&node);
            if state.is_alive(&node) {
                let number = self.number();
                self.queried.insert(node.clone(), number);
                self.at(now + self.settings.token_probe_timeout(), ScheduledTimer::QueryTimeout(node.clone(), number));
                let swim_actions = self.swim.announce_to(&node)?;
                self.perform_swim(swim_actions, state, now, actions);
            }
        }
        Ok(())
    }

    fn handle_request(
        &mut self,
        exchange: Exchange,
        state: &mut GossipState,
        now: NodeTime,
        actions: &mut Vec<Action>,
    ) -> Result<(), String> {
        self.merge_records(exchange.records, &exchange.digest, state, now, actions)?;
        state.counters.requests_answered += 1;
        let reply = if exchange.sums.is_empty() {
            let digest = self.records.digest_for(state, exchange.scope, &exchange.digest);
            self.cursors.compose(
                exchange.scope,
                digest,
                &self.records.missing_records(state, exchange.scope, &exchange.digest),
            )
        } else {
            // The scope of the difference. The peer requests what it lacks in its next message.
            let scope = DigestScope::of_difference(&state.base.class_sums_like(&exchange.sums), &exchange.sums);
            self.cursors.compose(scope, state.base.digest(scope), &[])
        };
        actions.push(Action::SendReply(reply));
        Ok(())
    }

    fn handle_reply(
        &mut self,
        number: u64,
        exchange: Exchange,
        state: &mut GossipState,
        now: NodeTime,
        actions: &mut Vec<Action>,
    ) -> Result<(), String> {
        let any_new = self.merge_records(exchange.records, &exchange.digest, state, now, actions)?;
        let Some(mut round) = self.round.take_if(|round| round.number == number) else { return Ok(()) };
        self.last_round_completed = true;
        let mut missing = self.records.missing_records(state, exchange.scope, &exchange.digest);
        missing.retain(|record| !round.sent.contains(&(record.owner.clone(), record.stamp)));
        // The reply to sums contains no records. Later, a reply without new records is the peer's
        // last.
        let expects_more = (any_new || round.messages == 0) && !state.base.outdated_owners(&exchange.digest).is_empty();
        if round.messages < MESSAGES_PER_ROUND && (!missing.is_empty() || expects_more) {
            round.messages += 1;
            let message = self.cursors.compose(exchange.scope, state.base.digest(exchange.scope), &missing);
            round.sent.extend(message.records.iter().map(|record| (record.owner.clone(), record.stamp)));
            state.counters.requests_sent += 1;
            actions.push(Action::SendRequest(number, round.peer.clone(), message));
            self.round = Some(round);
        }
        Ok(())
    }

    fn fire_timers(&mut self, state: &mut GossipState, now: NodeTime, actions: &mut Vec<Action>) -> Result<(), String> {
        while let Some(entry) = self.agenda.first_entry().filter(|entry| entry.key().0 <= now) {
            match entry.remove() {
                ScheduledTimer::Heartbeat => {
                    let heartbeat_interval = self.heartbeat_interval(state);
                    self.records.repeat(self.settings.renew, heartbeat_interval, state, now);
                    // A change published a moment ago counts as a heartbeat.
                    if now.since(self.last_published) * 2 > heartbeat_interval {
                        actions.push(self.repeat(state, now));
                    }
                    let pause = self.jittered(heartbeat_interval);
                    self.at(now + pause, ScheduledTimer::Heartbeat);
                }
                ScheduledTimer::Round => {
                    self.changed |= self.records.remove_absent(self.settings.forget_after, state, now);
                    self.announce_to_absent(state, now);
                    self.begin_round(state, actions);
                    let pause = self.jittered(self.settings.round);
                    self.at(now + pause, ScheduledTimer::Round);
                }
                ScheduledTimer::Announce => self.send_announcements(state, now, actions)?,
                ScheduledTimer::Swim(timer) => {
                    let last_published = self.heartbeat_interval(state) * 3;
                    let sends =
                        |node: &NodeId| state.base.get(node).is_some_and(|stored| stored.age(now) < last_published);
                    let swim_actions = self.swim.fire_timer(timer, sends)?;
                    self.perform_swim(swim_actions, state, now, actions);
                }
                ScheduledTimer::QueryTimeout(node, number) => {
                    self.handle_query_timeout(node, number, state, now, actions)?;
                }
                ScheduledTimer::SuspicionTimeout(suspicion, node, number) => {
                    if self.queried.get(&node) == Some(&number) {
                        self.queried.remove(&node);
                        let swim_actions = self.swim.declare_down(&suspicion)?;
                        self.perform_swim(swim_actions, state, now, actions);
                    }
                }
            }
        }
        Ok(())
    }

    /// Handles the missing answer of a node with a vanished token.
    fn handle_query_timeout(
        &mut self,
        node: NodeId,
        number: u64,
        state: &mut GossipState,
        now: NodeTime,
        actions: &mut Vec<Action>,
    ) -> Result<(), String> {
        if self.queried.get(&node) != Some(&number) {
            return Ok(());
        }
        // If half of all nodes vanish at once, this node is more likely at fault.
        let other_members = state.status.values().filter(|status| status.is_alive()).count().saturating_sub(1);
        let suspicious = self.queried.len() > 1 && self.queried.len() * 2 >= other_members;
        let suspected = if suspicious || self.swim.is_unhealthy() { None } else { self.swim.suspect(&node)? };
        let Some((suspicion, swim_actions)) = suspected else {
            self.queried.remove(&node);
            return Ok(());
        };
        self.perform_swim(swim_actions, state, now, actions);
        // The query or its answer may have been lost. Any message from the node clears the
        // suspicion here.
        let swim_actions = self.swim.announce_to(&node)?;
        self.perform_swim(swim_actions, state, now, actions);
        let pause = self.settings.suspicion_when_vanished * suspicion.timeout_factor();
        self.at(now + pause, ScheduledTimer::SuspicionTimeout(suspicion, node, number));
        Ok(())
    }

    /// Returns the heartbeat interval. It is longer in a large fleet, to limit the messages that
    /// each node receives.
    fn heartbeat_interval(&self, state: &GossipState) -> Duration {
        let alive = state.status.values().filter(|status| status.is_alive()).count();
        let extended = INTERVAL_PER_NODE.saturating_mul(u32::try_from(alive).unwrap_or(u32::MAX));
        // For any fleet size the age of received records stays within the interval of version
        // renewal.
        extended.min(self.settings.renew).max(self.settings.heartbeat)
    }

    /// Starts a round with a peer: an owner of a missed update if any, else a random node that is
    /// alive, else a node with a token.
    fn begin_round(&mut self, state: &mut GossipState, actions: &mut Vec<Action>) {
        self.missing_from.retain(|node| state.is_alive(node));
        if let Some(peer) = self.missing_from.pop_first() {
            return self.compare(peer, false, state, actions);
        }
        let mut peers: Vec<&NodeId> = state.status.keys().filter(|node| state.is_alive(node)).collect();
        peers.retain(|node| **node != self.settings.node);
        if peers.is_empty() {
            peers = self.tokens.iter().collect();
        }
        if peers.is_empty() {
            return;
        }
        let peer = peers[self.rng.random_range(0..peers.len())].clone();
        self.compare(peer, self.last_round_completed, state, actions);
    }

    /// Starts a round, with sums or directly with the digest.
    fn compare(&mut self, peer: NodeId, by_sums: bool, state: &mut GossipState, actions: &mut Vec<Action>) {
        let number = self.number();
        let message = if by_sums {
            let sums = state.base.class_sums();
            Exchange { sums, scope: DigestScope::NONE, digest: Digest::new(), records: vec![] }
        } else {
            self.cursors.compose(DigestScope::ALL, state.base.digest(DigestScope::ALL), &[])
        };
        state.counters.requests_sent += 1;
        actions.push(Action::SendRequest(number, peer.clone(), message));
        self.round = Some(Round { number, peer, messages: u32::from(!by_sums), sent: BTreeSet::new() });
    }

    /// Schedules an announcement to a node, unless it is known to be alive.
    fn schedule_announcement(&mut self, node: NodeId, state: &GossipState, now: NodeTime) {
        if node == self.settings.node || state.is_alive(&node) {
            return;
        }
        if self.to_announce.is_empty() {
            self.at(now, ScheduledTimer::Announce);
        }
        self.to_announce.insert(node);
    }

    /// Schedules an announcement to a random absent node with a token or an old record: an earlier
    /// announcement may have been lost, or a cut may have healed.
    fn announce_to_absent(&mut self, state: &GossipState, now: NodeTime) {
        let absent: BTreeSet<&NodeId> =
            self.tokens.iter().chain(self.records.absent_nodes()).filter(|n| !state.is_alive(n)).collect();
        if !absent.is_empty() {
            let chosen = self.rng.random_range(0..absent.len());
            let chosen = absent.into_iter().nth(chosen).cloned();
            if let Some(node) = chosen {
                self.schedule_announcement(node, state, now);
            }
        }
    }

    fn send_announcements(
        &mut self,
        state: &mut GossipState,
        now: NodeTime,
        actions: &mut Vec<Action>,
    ) -> Result<(), String> {
        self.to_announce.retain(|node| !state.is_alive(node));
        for _ in 0..ANNOUNCEMENTS_MAX.min(self.to_announce.len()) {
            let chosen = self.rng.random_range(0..self.to_announce.len());
            if let Some(node) = self.to_announce.iter().nth(chosen).cloned() {
                self.to_announce.remove(&node);
                let swim_actions = self.swim.announce_to(&node)?;
                self.perform_swim(swim_actions, state, now, actions);
            }
        }
        if !self.to_announce.is_empty() {
            self.at(now + ANNOUNCEMENT_PAUSE, ScheduledTimer::Announce);
        }
        Ok(())
    }

    fn perform_swim(
        &mut self,
        swim_actions: Vec<SwimAction>,
        state: &mut GossipState,
        now: NodeTime,
        actions: &mut Vec<Action>,
    ) {
        for action in swim_actions {
            match action {
                SwimAction::Send(to, bytes) => {
                    state.counters.packets += 1;
                    actions.push(Action::Send(to, bytes));
                }
                SwimAction::SetTimer(pause, timer) => self.at(now + pause, ScheduledTimer::Swim(timer)),
                SwimAction::Up(node) => {
                    tracing::info!(node = %self.settings.node, other = %node, "node is alive");
                    self.records.mark_alive(&node);
                    state.status.insert(node, MemberStatus::Alive { since: now });
                    self.changed = true;
                    self.full_record_until = now + FULL_RECORD_PERIOD;
                }
                SwimAction::Down(node) => {
                    tracing::info!(node = %self.settings.node, other = %node, "node is down");
                    self.records.mark_down(&node, now);
                    state.counters.down_verdicts += 1;
                    state.status.insert(node, MemberStatus::Down { since: now });
                    self.changed = true;
                }
                SwimAction::Suspected(node) => {
                    tracing::debug!(node = %self.settings.node, other = %node, "node is suspected");
                    state.status.insert(node, MemberStatus::Suspect { since: now });
                    self.changed = true;
                }
                SwimAction::Cleared(node) => {
                    state.status.insert(node, MemberStatus::Alive { since: now });
                    self.changed = true;
                }
                SwimAction::Rejoined => {
                    tracing::warn!(node = %self.settings.node, "was declared down by other nodes, and rejoined");
                    state.counters.refutations += 1;
                }
            }
        }
    }

    /// Publishes the whole own record, and starts to repeat it.
    fn publish(&mut self, state: &mut GossipState, now: NodeTime) -> Action {
        self.full_record_until = now + FULL_RECORD_PERIOD;
        self.repeat(state, now)
    }

    fn repeat(&mut self, state: &mut GossipState, now: NodeTime) -> Action {
        self.last_published = now;
        state.counters.published += 1;
        let full_record = now < self.full_record_until;
        Action::Publish(if full_record {
            RecordUpdate::Record(self.records.own().clone())
        } else {
            self.records.refresh()
        })
    }

    fn at(&mut self, due: NodeTime, timer: ScheduledTimer) {
        let number = self.number();
        self.agenda.insert((due, number), timer);
    }

    fn number(&mut self) -> u64 {
        self.last_number += 1;
        self.last_number
    }

    /// Returns a random time between zero and `time`.
    fn random_up_to(&mut self, time: Duration) -> Duration {
        time.mul_f64(self.rng.random_range(0.0..1.0))
    }

    /// Returns `time` with a random deviation of up to a tenth. Never zero, or the agenda would not
    /// end.
    fn jittered(&mut self, time: Duration) -> Duration {
        time.mul_f64(self.rng.random_range(0.9..1.1)).max(Duration::from_millis(1))
    }
}

#[cfg(test)]
mod tests;
