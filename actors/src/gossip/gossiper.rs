//! What a node does about what it hears, as values: [`Event`]s go in, [`Action`]s come out. It waits for nobody.

use super::exchange::ExchangeCursors;
use super::record_signer::SharedRecordSigner;
use super::record_store::{MergeOutcome, RecordStore};
use super::settings::Settings;
use super::shared::{GossipState, MemberStatus};
use super::swim::{Suspicion, Swim, SwimAction, Timer};
use bytes::Bytes;
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

/// Something that happened.
#[expect(clippy::large_enum_variant, reason = "one is handled at a time")]
pub(super) enum Event {
    /// The node's own knowledge changes.
    KnowledgeChanged(Change),
    /// A node said something of itself.
    Published(NodeId, RecordUpdate),
    /// A packet of failure detection came in.
    Packet(Bytes),
    /// A node's presence token appeared or vanished.
    Token(NodeId, bool),
    /// A peer compares digests with us.
    RequestReceived(Exchange),
    /// A peer answered in this round, or nobody did.
    ReplyReceived(u64, Option<Exchange>),
    /// The time last given by [`Gossiper::next_due`] has come.
    TimerFired,
    /// The fleet writes another version of the wire, and with it proofs or not: what the own record says is said anew, in full.
    VersionRaised {
        /// Whether records that are handed on have proofs in it.
        with_proofs: bool,
    },
}

/// Something to carry out, in the order given.
#[expect(clippy::large_enum_variant, reason = "there are few at a time")]
#[derive(Debug, PartialEq)]
pub(super) enum Action {
    /// Say something of the own node.
    Publish(RecordUpdate),
    /// Hand a packet to a node.
    Send(NodeId, Bytes),
    /// Compare digests with a peer, and bring the answer back as [`Event::Answered`] with the same number.
    SendRequest(u64, NodeId, Exchange),
    /// The answer to [`Event::Asked`].
    SendReply(Exchange),
}

/// Something that comes in time.
#[derive(Debug)]
enum Due {
    Beat,
    Round,
    Greet,
    Swim(Timer),
    /// A node whose token vanished should have answered by now; the number tells this question from earlier ones.
    Answer(NodeId, u64),
    /// It was suspected then, and should have answered that by now.
    Condemn(Suspicion, NodeId, u64),
}

/// A round of anti-entropy under way.
struct Round {
    number: u64,
    peer: NodeId,
    /// Messages to the peer that told what this node has; the sums before them do not count.
    legs: u32,
    /// What the peer was handed in this round: it is not handed over twice, even if the peer will not have it.
    handed: BTreeSet<(NodeId, RecordStamp)>,
}

/// Messages to one peer in one round at most: the rest waits for the next.
const LEGS: u32 = 4;

/// How long a node repeats the whole record after a change, or after somebody came. Then it says no more than that it still
/// says so; whoever missed the record asks for it. Raised: more traffic, and fewer that have to ask. 10 s: as many
/// repetitions as a link that loses half of everything needs.
const LOUD: Duration = Duration::from_secs(10);

/// Each further node lengthens the pause between beats by so much, once there are too many for the shortest pause. 50 ms: a
/// node hears 20 beats a second at most, until the pause cannot grow any more.
const PAUSE_FOR_EACH: Duration = Duration::from_millis(50);

/// Greetings at once, and the pause before the next: when hundreds of nodes start together, the answers to the first
/// few make most of the others known.
const GREETINGS: usize = 5;
const GREETING_PAUSE: Duration = Duration::from_millis(100);

/// By how much an earlier life of the node may have been ahead of this one, in milliseconds: a century, for clocks that were set
/// wrong. Beyond it somebody makes stamps up, and would have the node run out of them.
const AHEAD_MAX: u64 = 100 * 366 * 24 * 3600 * 1000;

pub(super) struct Gossiper {
    settings: Settings,
    records: RecordStore,
    swim: Swim,
    rng: ChaCha8Rng,
    agenda: BTreeMap<(NodeTime, u64), Due>,
    /// Tells apart what is due at one instant, rounds, and questions.
    last_number: u64,
    tokens: BTreeSet<NodeId>,
    to_greet: BTreeSet<NodeId>,
    questioned: BTreeMap<NodeId, u64>,
    round: Option<Round>,
    turns: ExchangeCursors,
    /// Whether the last round came to an end: then the next may well find nothing to tell, and begins with sums.
    agreed: bool,
    /// Who has said something that this node missed.
    missing_from: BTreeSet<NodeId>,
    /// Until when the whole record is repeated.
    loud_until: NodeTime,
    changed: bool,
    /// When the own record was last published.
    spoke: NodeTime,
}

impl Gossiper {
    /// Starts, with what to do first.
    pub(super) fn new(
        settings: Settings,
        knowledge: Knowledge,
        notary: Option<SharedRecordSigner>,
        mut rng: ChaCha8Rng,
        known: &mut GossipState,
        now: NodeTime,
    ) -> (Gossiper, Vec<Action>) {
        // Whoever was alive to an actor before this one has to be met again.
        known.status = BTreeMap::from([(settings.node.clone(), MemberStatus::Alive { since: now })]);
        let memory = RecordStore::new(settings.node.clone(), settings.incarnation, knowledge, notary, known, now);
        let swim =
            Swim::new(settings.node.clone(), settings.incarnation, settings.swim(), ChaCha8Rng::from_rng(&mut rng));
        let mut gossiper = Gossiper {
            records: memory,
            swim,
            agenda: BTreeMap::new(),
            last_number: 0,
            tokens: BTreeSet::new(),
            to_greet: BTreeSet::new(),
            questioned: BTreeMap::new(),
            round: None,
            turns: ExchangeCursors::default(),
            agreed: false,
            missing_from: BTreeSet::new(),
            loud_until: now,
            changed: true,
            spoke: now,
            settings,
            rng,
        };
        // Nodes that start together should not speak together ever after.
        let (beat, round) = (gossiper.settings.heartbeat, gossiper.settings.round);
        let (beat, round) = (gossiper.up_to(beat), gossiper.up_to(round));
        gossiper.at(now + beat, Due::Beat);
        gossiper.at(now + round, Due::Round);
        let first = gossiper.publish(known, now);
        (gossiper, vec![first])
    }

    /// When to be woken.
    pub(super) fn next_due(&self) -> Option<NodeTime> {
        self.agenda.first_key_value().map(|((at, _), _)| *at)
    }

    /// Whether what there is to read has changed since this was last asked.
    pub(super) fn take_changed(&mut self) -> bool {
        std::mem::take(&mut self.changed)
    }

    /// Something happened. An error says what was wrong with a message; nothing was changed by it.
    pub(super) fn handle(
        &mut self,
        event: Event,
        known: &mut GossipState,
        now: NodeTime,
    ) -> Result<Vec<Action>, String> {
        let mut actions = vec![];
        match event {
            Event::KnowledgeChanged(change) => self.change(change, known, now, &mut actions)?,
            Event::Published(owner, said) => self.published(owner, said, known, now, &mut actions)?,
            Event::Packet(bytes) => {
                let (from, what) = self.swim.receive(&bytes)?;
                self.questioned.remove(&from);
                self.obey(what, known, now, &mut actions);
            }
            Event::Token(node, there) => self.token(node, there, known, now, &mut actions)?,
            Event::RequestReceived(exchange) => self.asked(exchange, known, now, &mut actions)?,
            Event::ReplyReceived(number, Some(exchange)) => {
                self.answered(number, exchange, known, now, &mut actions)?
            }
            Event::ReplyReceived(number, None) => {
                if self.round.take_if(|round| round.number == number).is_some() {
                    self.agreed = false;
                }
            }
            Event::TimerFired => self.woke(known, now, &mut actions)?,
            Event::VersionRaised { with_proofs } => {
                if with_proofs {
                    self.changed |= self.records.forget_unproven(known);
                }
                self.records.restate(known, now);
                actions.push(self.publish(known, now));
            }
        }
        Ok(actions)
    }

    /// Says farewell.
    pub(super) fn leave(&mut self) -> Vec<Action> {
        let what = self.swim.leave().unwrap_or_default();
        let send = |action| match action {
            SwimAction::Send(to, bytes) => Some(Action::Send(to, bytes)),
            SwimAction::SetTimer(..)
            | SwimAction::Up(_)
            | SwimAction::Down(_)
            | SwimAction::Suspected(_)
            | SwimAction::Cleared(_)
            | SwimAction::Rejoined => None,
        };
        what.into_iter().filter_map(send).collect()
    }

    fn change(
        &mut self,
        change: Change,
        known: &mut GossipState,
        now: NodeTime,
        actions: &mut Vec<Action>,
    ) -> Result<(), String> {
        match self.records.update(change, known, now) {
            Ok(false) => {}
            Ok(true) => {
                self.changed = true;
                actions.push(self.publish(known, now));
            }
            Err(bytes) => return Err(format!("own record of {bytes} bytes is too large, and was not changed")),
        }
        Ok(())
    }

    fn published(
        &mut self,
        owner: NodeId,
        said: RecordUpdate,
        known: &mut GossipState,
        now: NodeTime,
        actions: &mut Vec<Action>,
    ) -> Result<(), String> {
        match said {
            RecordUpdate::Record(record) => {
                let stamp = record.stamp;
                self.hear(record, known, now, actions)?;
                known.base.confirm(&owner, stamp, now);
            }
            RecordUpdate::Refresh { stamp, since, proof } => {
                match self.records.receive_refresh(&owner, stamp, since, proof, known, now) {
                    MergeOutcome::Missing => drop(self.missing_from.insert(owner.clone())),
                    MergeOutcome::Own(stamp) => self.overtake(stamp, known, now, actions)?,
                    MergeOutcome::Stale | MergeOutcome::Renewed | MergeOutcome::Changed => {}
                }
            }
        }
        // It speaks, so it is worth a greeting, but that we hear it is no proof that it hears us.
        self.meet(owner, known, now);
        Ok(())
    }

    fn hear(
        &mut self,
        record: Record,
        known: &mut GossipState,
        now: NodeTime,
        actions: &mut Vec<Action>,
    ) -> Result<bool, String> {
        let owner = record.owner.clone();
        match self.records.receive(record, known, now) {
            MergeOutcome::Stale => return Ok(false),
            MergeOutcome::Renewed | MergeOutcome::Missing => {}
            MergeOutcome::Changed => self.changed = true,
            MergeOutcome::Own(stamp) => {
                self.overtake(stamp, known, now, actions)?;
                return Ok(false);
            }
        }
        self.missing_from.remove(&owner);
        self.meet(owner, known, now);
        Ok(true)
    }

    /// Others know something later of this node than it says itself.
    fn overtake(
        &mut self,
        stamp: RecordStamp,
        known: &mut GossipState,
        now: NodeTime,
        actions: &mut Vec<Action>,
    ) -> Result<(), String> {
        if stamp.incarnation > self.settings.incarnation.saturating_add(AHEAD_MAX) {
            return Err(format!(
                "somebody says that this node's incarnation was {}, which none can have been",
                stamp.incarnation
            ));
        }
        tracing::warn!(node = %self.settings.node, ?stamp, "others know a later record of this node than it wrote: an \
            earlier incarnation was higher, or another node has the same name");
        self.records.overtake(stamp, known, now);
        actions.push(self.publish(known, now));
        let what = self.swim.adopt_incarnation(stamp.incarnation)?;
        self.obey(what, known, now, actions);
        Ok(())
    }

    /// Takes in what a peer handed over. True if any of it was news.
    fn take_in(
        &mut self,
        records: Vec<Record>,
        digest: &Digest,
        known: &mut GossipState,
        now: NodeTime,
        actions: &mut Vec<Action>,
    ) -> Result<bool, String> {
        let mut news = false;
        for record in records {
            news |= self.hear(record, known, now, actions)?;
        }
        // Nobody hands over records of the dead, which this node is to those who remember a later life of it.
        if let Some(stamp) = digest.get(&self.settings.node).filter(|stamp| **stamp > self.records.own().stamp) {
            self.overtake(*stamp, known, now, actions)?;
        }
        Ok(news)
    }

    fn token(
        &mut self,
        node: NodeId,
        there: bool,
        known: &mut GossipState,
        now: NodeTime,
        actions: &mut Vec<Action>,
    ) -> Result<(), String> {
        if node == self.settings.node {
            return Ok(());
        }
        if there {
            self.tokens.insert(node.clone());
            self.questioned.remove(&node);
            self.meet(node, known, now);
        } else {
            self.tokens.remove(&node);
            if known.is_alive(&node) {
                let number = self.number();
                self.questioned.insert(node.clone(), number);
                self.at(now + self.settings.token_probe_timeout(), Due::Answer(node.clone(), number));
                let what = self.swim.announce_to(&node)?;
                self.obey(what, known, now, actions);
            }
        }
        Ok(())
    }

    fn asked(
        &mut self,
        exchange: Exchange,
        known: &mut GossipState,
        now: NodeTime,
        actions: &mut Vec<Action>,
    ) -> Result<(), String> {
        self.take_in(exchange.records, &exchange.digest, known, now, actions)?;
        known.counters.requests_answered += 1;
        let answer = if exchange.sums.is_empty() {
            let digest = self.records.digest_for(known, exchange.scope, &exchange.digest);
            self.turns.compose(
                exchange.scope,
                digest,
                &self.records.missing_records(known, exchange.scope, &exchange.digest),
            )
        } else {
            // Where the two differ. What the other lacks it will say then.
            let scope = DigestScope::of_difference(&known.base.class_sums_like(&exchange.sums), &exchange.sums);
            self.turns.compose(scope, known.base.digest(scope), &[])
        };
        actions.push(Action::SendReply(answer));
        Ok(())
    }

    fn answered(
        &mut self,
        number: u64,
        exchange: Exchange,
        known: &mut GossipState,
        now: NodeTime,
        actions: &mut Vec<Action>,
    ) -> Result<(), String> {
        let news = self.take_in(exchange.records, &exchange.digest, known, now, actions)?;
        let Some(mut round) = self.round.take_if(|round| round.number == number) else { return Ok(()) };
        self.agreed = true;
        let mut lacking = self.records.missing_records(known, exchange.scope, &exchange.digest);
        lacking.retain(|record| !round.handed.contains(&(record.owner.clone(), record.stamp)));
        // Sums were answered without records. Later, a peer that says nothing new has said all that it will.
        let more_to_hear = (news || round.legs == 0) && !known.base.outdated_owners(&exchange.digest).is_empty();
        if round.legs < LEGS && (!lacking.is_empty() || more_to_hear) {
            round.legs += 1;
            let message = self.turns.compose(exchange.scope, known.base.digest(exchange.scope), &lacking);
            round.handed.extend(message.records.iter().map(|record| (record.owner.clone(), record.stamp)));
            known.counters.requests_sent += 1;
            actions.push(Action::SendRequest(number, round.peer.clone(), message));
            self.round = Some(round);
        }
        Ok(())
    }

    fn woke(&mut self, known: &mut GossipState, now: NodeTime, actions: &mut Vec<Action>) -> Result<(), String> {
        while let Some(entry) = self.agenda.first_entry().filter(|entry| entry.key().0 <= now) {
            match entry.remove() {
                Due::Beat => {
                    let beat = self.beat(known);
                    self.records.repeat(self.settings.renew, beat, known, now);
                    // A change that was told a moment ago said as much.
                    if now.since(self.spoke) * 2 > beat {
                        actions.push(self.repeat(known, now));
                    }
                    let pause = self.about(beat);
                    self.at(now + pause, Due::Beat);
                }
                Due::Round => {
                    self.changed |= self.records.forget(self.settings.forget_after, known, now);
                    self.miss(known, now);
                    self.begin_round(known, actions);
                    let pause = self.about(self.settings.round);
                    self.at(now + pause, Due::Round);
                }
                Due::Greet => self.greet(known, now, actions)?,
                Due::Swim(timer) => {
                    let spoke = self.beat(known) * 3;
                    let speaks = |node: &NodeId| known.base.get(node).is_some_and(|heard| heard.age(now) < spoke);
                    let what = self.swim.fire_timer(timer, speaks)?;
                    self.obey(what, known, now, actions);
                }
                Due::Answer(node, number) => self.unanswered(node, number, known, now, actions)?,
                Due::Condemn(suspicion, node, number) => {
                    if self.questioned.get(&node) == Some(&number) {
                        self.questioned.remove(&node);
                        let what = self.swim.declare_down(&suspicion)?;
                        self.obey(what, known, now, actions);
                    }
                }
            }
        }
        Ok(())
    }

    /// A node whose token vanished was asked whether it is there.
    fn unanswered(
        &mut self,
        node: NodeId,
        number: u64,
        known: &mut GossipState,
        now: NodeTime,
        actions: &mut Vec<Action>,
    ) -> Result<(), String> {
        if self.questioned.get(&node) != Some(&number) {
            return Ok(());
        }
        // That half of all vanished at once says more about this node than about them.
        let others = known.status.values().filter(|status| status.is_alive()).count().saturating_sub(1);
        let many = self.questioned.len() > 1 && self.questioned.len() * 2 >= others;
        let suspected = if many || self.swim.is_unhealthy() { None } else { self.swim.suspect(&node)? };
        let Some((suspicion, what)) = suspected else {
            self.questioned.remove(&node);
            return Ok(());
        };
        self.obey(what, known, now, actions);
        // The question or its answer may have been lost. Whatever it says from now on clears it here.
        let what = self.swim.announce_to(&node)?;
        self.obey(what, known, now, actions);
        let pause = self.settings.suspicion_when_vanished * suspicion.timeout_factor();
        self.at(now + pause, Due::Condemn(suspicion, node, number));
        Ok(())
    }

    /// The pause between beats: in a large fleet each speaks less often, so that nobody has to hear too much.
    fn beat(&self, known: &GossipState) -> Duration {
        let alive = known.status.values().filter(|status| status.is_alive()).count();
        let long = PAUSE_FOR_EACH.saturating_mul(u32::try_from(alive).unwrap_or(u32::MAX));
        // Whatever the size, the age of what one hears stays within the pause in which versions are renewed.
        long.min(self.settings.renew).max(self.settings.heartbeat)
    }

    /// Compares what is known with one peer that is alive, or whose token at least is there; with one who has said what this
    /// node missed, if there is one.
    fn begin_round(&mut self, known: &mut GossipState, actions: &mut Vec<Action>) {
        self.missing_from.retain(|node| known.is_alive(node));
        if let Some(peer) = self.missing_from.pop_first() {
            return self.compare(peer, false, known, actions);
        }
        let mut peers: Vec<&NodeId> = known.status.keys().filter(|node| known.is_alive(node)).collect();
        peers.retain(|node| **node != self.settings.node);
        if peers.is_empty() {
            peers = self.tokens.iter().collect();
        }
        if peers.is_empty() {
            return;
        }
        let peer = peers[self.rng.random_range(0..peers.len())].clone();
        self.compare(peer, self.agreed, known, actions);
    }

    /// Begins a round, by sums or at once by the digest.
    fn compare(&mut self, peer: NodeId, by_sums: bool, known: &mut GossipState, actions: &mut Vec<Action>) {
        let number = self.number();
        let message = if by_sums {
            let sums = known.base.class_sums();
            Exchange { sums, scope: DigestScope::NONE, digest: Digest::new(), records: vec![] }
        } else {
            self.turns.compose(DigestScope::ALL, known.base.digest(DigestScope::ALL), &[])
        };
        known.counters.requests_sent += 1;
        actions.push(Action::SendRequest(number, peer.clone(), message));
        self.round = Some(Round { number, peer, legs: u32::from(!by_sums), handed: BTreeSet::new() });
    }

    /// Remembers to greet a node, unless it is known to be alive.
    fn meet(&mut self, node: NodeId, known: &GossipState, now: NodeTime) {
        if node == self.settings.node || known.is_alive(&node) {
            return;
        }
        if self.to_greet.is_empty() {
            self.at(now, Due::Greet);
        }
        self.to_greet.insert(node);
    }

    /// Greets one node that should be there or was once: a greeting may have been lost, or a cut may have healed.
    fn miss(&mut self, known: &GossipState, now: NodeTime) {
        let missed: BTreeSet<&NodeId> =
            self.tokens.iter().chain(self.records.absent_nodes()).filter(|n| !known.is_alive(n)).collect();
        if !missed.is_empty() {
            let chosen = self.rng.random_range(0..missed.len());
            let chosen = missed.into_iter().nth(chosen).cloned();
            if let Some(node) = chosen {
                self.meet(node, known, now);
            }
        }
    }

    fn greet(&mut self, known: &mut GossipState, now: NodeTime, actions: &mut Vec<Action>) -> Result<(), String> {
        self.to_greet.retain(|node| !known.is_alive(node));
        for _ in 0..GREETINGS.min(self.to_greet.len()) {
            let chosen = self.rng.random_range(0..self.to_greet.len());
            if let Some(node) = self.to_greet.iter().nth(chosen).cloned() {
                self.to_greet.remove(&node);
                let what = self.swim.announce_to(&node)?;
                self.obey(what, known, now, actions);
            }
        }
        if !self.to_greet.is_empty() {
            self.at(now + GREETING_PAUSE, Due::Greet);
        }
        Ok(())
    }

    fn obey(&mut self, what: Vec<SwimAction>, known: &mut GossipState, now: NodeTime, actions: &mut Vec<Action>) {
        for action in what {
            match action {
                SwimAction::Send(to, bytes) => {
                    known.counters.packets += 1;
                    actions.push(Action::Send(to, bytes));
                }
                SwimAction::SetTimer(pause, timer) => self.at(now + pause, Due::Swim(timer)),
                SwimAction::Up(node) => {
                    tracing::info!(node = %self.settings.node, other = %node, "is alive");
                    self.records.mark_alive(&node);
                    known.status.insert(node, MemberStatus::Alive { since: now });
                    self.changed = true;
                    self.loud_until = now + LOUD;
                }
                SwimAction::Down(node) => {
                    tracing::info!(node = %self.settings.node, other = %node, "is down");
                    self.records.mark_down(&node, now);
                    known.counters.down_verdicts += 1;
                    known.status.insert(node, MemberStatus::Down { since: now });
                    self.changed = true;
                }
                SwimAction::Suspected(node) => {
                    tracing::debug!(node = %self.settings.node, other = %node, "is suspected");
                    known.status.insert(node, MemberStatus::Suspect { since: now });
                    self.changed = true;
                }
                SwimAction::Cleared(node) => {
                    known.status.insert(node, MemberStatus::Alive { since: now });
                    self.changed = true;
                }
                SwimAction::Rejoined => {
                    tracing::warn!(node = %self.settings.node, "was judged down by others, and came back");
                    known.counters.refutations += 1;
                }
            }
        }
    }

    /// Tells all of the own record, and begins to repeat it.
    fn publish(&mut self, known: &mut GossipState, now: NodeTime) -> Action {
        self.loud_until = now + LOUD;
        self.repeat(known, now)
    }

    fn repeat(&mut self, known: &mut GossipState, now: NodeTime) -> Action {
        self.spoke = now;
        known.counters.published += 1;
        let loud = now < self.loud_until;
        Action::Publish(if loud { RecordUpdate::Record(self.records.own().clone()) } else { self.records.refresh() })
    }

    fn at(&mut self, due: NodeTime, what: Due) {
        let number = self.number();
        self.agenda.insert((due, number), what);
    }

    fn number(&mut self) -> u64 {
        self.last_number += 1;
        self.last_number
    }

    /// A time from nothing up to this.
    fn up_to(&mut self, time: Duration) -> Duration {
        time.mul_f64(self.rng.random_range(0.0..1.0))
    }

    /// This time, give or take a tenth. Never nothing, or the agenda would not end.
    fn about(&mut self, time: Duration) -> Duration {
        time.mul_f64(self.rng.random_range(0.9..1.1)).max(Duration::from_millis(1))
    }
}

#[cfg(test)]
mod tests;
