//! Failure detection by the SWIM protocol (Das, Gupta, Motivala 2002) with suspicion, as
//! implemented by crate `foca`.
//!
//! This module wraps foca in values: it takes packets and timers and returns [`SwimAction`]s. It
//! uses neither the bus nor a clock.

mod packet;

use bytes::{Buf as _, BufMut as _, Bytes};
use consort_protocol::codec;
use consort_protocol::ids::NodeId;
use foca::{
    AccumulatingRuntime, Codec as _, Foca, Header, Identity as _, Member, Message, NoCustomBroadcast,
    OwnedNotification, State,
};
use packet::{PacketCodec, PacketError, SwimId};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// A timer requested by foca, to be returned to it.
pub(super) type Timer = foca::Timer<SwimId>;

/// The failure detector rejects a packet or an operation.
#[derive(Debug, PartialEq, thiserror::Error)]
pub(super) enum SwimError {
    /// Another program writes on the fleet's keys.
    #[error("empty packet")]
    EmptyPacket,
    /// The packet comes from a node of another version, or from another program.
    #[error("unsupported wire version {0}; expected {expected}", expected = codec::FIRST_VERSION)]
    UnsupportedVersion(u8),
    /// The packet has no valid header.
    #[error(transparent)]
    Packet(#[from] PacketError),
    /// foca rejects the packet or the operation.
    #[error(transparent)]
    Foca(#[from] foca::Error),
}

/// An effect for the caller to perform, in the order given.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum SwimAction {
    /// Send a packet to a node.
    Send(NodeId, Bytes),
    /// Return the timer after this time.
    SetTimer(Duration, Timer),
    /// A node is alive from now on.
    Up(NodeId),
    /// A node is down from now on.
    Down(NodeId),
    /// A node that is alive is suspected from now on.
    Suspected(NodeId),
    /// A node has refuted a suspicion.
    Cleared(NodeId),
    /// Another node has declared a member down from which this node has missed no answer, or has stated an
    /// incarnation of it that the member has not confirmed.
    Claimed(NodeId),
    /// This node was declared down wrongly, and has rejoined under a new identity.
    Rejoined,
}

/// A suspected member, to be declared down unless it refutes the suspicion in time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Suspicion {
    id: SwimId,
    incarnation: foca::Incarnation,
}

impl Suspicion {
    /// Returns the factor by which the suspicion timeout is extended for this member.
    pub(super) fn timeout_factor(&self) -> u32 {
        timeout_factor(self.id.rejoins)
    }
}

/// Maximum extension of the suspicion timeout, whatever the number of rejoins: 16 s with the
/// default of 2 s.
const TIMEOUT_FACTOR_MAX: u32 = 8;

/// Returns the factor for a member that has rejoined this often after wrong verdicts. Its answers
/// take a long path, for example if a single node receives from it, or it receives from a single
/// node. The factor doubles each time, so that the cycle of verdict and rejoin ends.
pub(super) fn timeout_factor(returns: u32) -> u32 {
    1u32.checked_shl(returns).map_or(TIMEOUT_FACTOR_MAX, |times| times.clamp(1, TIMEOUT_FACTOR_MAX))
}

/// Checks whether a timer begins the probe of a member.
pub(super) fn begins_probe(timer: &Timer) -> bool {
    matches!(timer, foca::Timer::ProbeRandomMember(_))
}

fn extended(after: Duration, timer: &Timer) -> Duration {
    match timer {
        foca::Timer::ChangeSuspectToDown { member_id, .. } => after * timeout_factor(member_id.rejoins),
        _ => after,
    }
}

/// Reads a packet: its header, and what its sender says about members.
fn decode(bytes: &[u8]) -> Result<(Header<SwimId>, Vec<Member<SwimId>>), SwimError> {
    let (version, mut packet) = bytes.split_first().ok_or(SwimError::EmptyPacket)?;
    if *version != codec::FIRST_VERSION {
        return Err(SwimError::UnsupportedVersion(*version));
    }
    let header = PacketCodec.decode_header(&mut packet)?;
    let mut updates = vec![];
    // A packet without updates may lack their number.
    if packet.has_remaining() {
        let number = packet.try_get_u16().map_err(|_| PacketError::Truncated)?;
        for _ in 0..number {
            updates.push(PacketCodec.decode_member(&mut packet)?);
        }
    }
    Ok((header, updates))
}

/// Writes a packet without its version.
fn encode(header: &Header<SwimId>, updates: &[Member<SwimId>]) -> Result<Vec<u8>, SwimError> {
    let mut packet = vec![];
    PacketCodec.encode_header(header, &mut packet)?;
    if let Ok(number @ 1..) = u16::try_from(updates.len()) {
        packet.put_u16(number);
        updates.iter().try_for_each(|update| PacketCodec.encode_member(update, &mut packet))?;
    }
    Ok(packet)
}

/// Returns a packet with the version before it.
fn with_version(packet: impl AsRef<[u8]>) -> Bytes {
    [&[codec::FIRST_VERSION], packet.as_ref()].concat().into()
}

/// Returns the sender that a packet states.
pub(super) fn packet_sender(bytes: &[u8]) -> Result<NodeId, SwimError> {
    decode(bytes).map(|(header, _)| header.src.node)
}

/// Encodes a packet of `from` that says whether `about` is alive. Each node is given with its incarnation.
#[cfg(feature = "test-util")]
pub fn packet_about(from: (NodeId, u64), about: (NodeId, u64), is_alive: bool, to: (NodeId, u64)) -> Bytes {
    let id = |(node, incarnation): (NodeId, u64)| SwimId { node, incarnation, rejoins: 0 };
    let header = Header { src: id(from), src_incarnation: 0, dst: id(to), message: Message::Gossip };
    let state = if is_alive { State::Alive } else { State::Down };
    with_version(encode(&header, &[Member::new(id(about), 0, state)]).expect("a small packet"))
}

pub(super) struct Swim {
    foca: Foca<SwimId, PacketCodec, ChaCha8Rng, NoCustomBroadcast>,
    /// Latest incarnation under which each node has sent.
    confirmed: BTreeMap<NodeId, u64>,
    /// Nodes that are alive according to others, and not members here, until the record of the node arrives.
    unconfirmed: BTreeMap<NodeId, Member<SwimId>>,
    /// Members suspected now.
    suspects: BTreeSet<NodeId>,
    /// Answers to this node's recent probes: a bit each, the latest lowest.
    probe_answers: u8,
    /// True if the probe in progress was answered.
    probe_answered: bool,
    /// Time by which verdicts have been deferred while this node was unhealthy, by suspect.
    deferred: BTreeMap<NodeId, Duration>,
    /// Suspects for which all members were queried before the verdict.
    members_queried: BTreeSet<NodeId>,
    probe_period: Duration,
    deferral_max: Duration,
    /// Members that were asked to query a node, by this node.
    helpers: BTreeMap<NodeId, BTreeSet<NodeId>>,
    /// Maximum number of members that are notified or asked about a suspect.
    confidants_max: usize,
    /// Chooses them.
    rng: ChaCha8Rng,
}

/// Probe number of a query that is not foca's: foca counts up and reaches this number once in 256
/// probes.
const QUERY_PROBE: u8 = 0;

/// Number of members through which a node is queried, as with the probes of foca.
const HELPERS: usize = 3;

/// Number of recent probes that are evaluated.
const PROBES_MAX: u32 = 6;

/// Maximum deferral of a verdict by an unhealthy node, in suspicion timeouts.
const DEFERRALS_MAX: u32 = 7;

/// Maximum number of nodes that others have announced before the record of the node arrives.
const UNCONFIRMED_MAX: usize = 1024;

impl Swim {
    pub(super) fn new(
        node: NodeId,
        incarnation: u64,
        config: foca::Config,
        confidants_max: usize,
        rng: ChaCha8Rng,
    ) -> Swim {
        let (probe_period, deferral_max) = (config.probe_period, config.suspect_to_down_after * DEFERRALS_MAX);
        Swim {
            foca: Foca::new(SwimId { node, incarnation, rejoins: 0 }, config, rng.clone(), PacketCodec),
            confirmed: BTreeMap::new(),
            unconfirmed: BTreeMap::new(),
            suspects: BTreeSet::new(),
            probe_answers: u8::MAX,
            probe_answered: true,
            deferred: BTreeMap::new(),
            members_queried: BTreeSet::new(),
            probe_period,
            deferral_max,
            helpers: BTreeMap::new(),
            confidants_max,
            rng,
        }
    }

    /// Handles a packet. Returns its sender, or the node that has answered a [query](Self::ask) through the sender.
    ///
    /// What the sender says about another node counts only in part, since a stolen key may sign the packet:
    ///
    /// - that the node is down, only if `agrees` for it: if this node has missed its answers, too;
    /// - an incarnation, only if it is at most that `incarnation` of the node's record or of its own packets.
    ///
    /// Otherwise it leads to [`SwimAction::Claimed`].
    pub(super) fn receive(
        &mut self,
        bytes: &[u8],
        agrees: impl Fn(&NodeId) -> bool,
        incarnation: impl Fn(&NodeId) -> Option<u64>,
    ) -> Result<(NodeId, Vec<SwimAction>), SwimError> {
        let (header, updates) = decode(bytes)?;
        let from = header.src.node.clone();
        let last = self.confirmed.entry(from.clone()).or_default();
        *last = header.src.incarnation.max(*last);
        let mut believed = vec![];
        let mut actions = vec![];
        for update in updates {
            let about = update.id();
            if about.node == from || about.node == self.foca.identity().node {
                believed.push(update);
                continue;
            }
            let latest = self.confirmed.get(&about.node).copied().max(incarnation(&about.node));
            let is_confirmed = latest.is_some_and(|latest| about.incarnation <= latest);
            if is_confirmed && (update.state() != State::Down || agrees(&about.node)) {
                believed.push(update);
                continue;
            }
            let is_present =
                |member: &Member<SwimId>| member.id().node == about.node && !member.id().win_addr_conflict(about);
            if self.foca.iter_members().any(is_present) {
                actions.push(SwimAction::Claimed(about.node.clone()));
            } else if update.state() != State::Down
                && (self.unconfirmed.len() < UNCONFIRMED_MAX || self.unconfirmed.contains_key(&about.node))
            {
                self.unconfirmed.insert(about.node.clone(), update);
            }
        }
        let packet = encode(&header, &believed)?;
        self.probe_answered |= match header.message {
            Message::Ack(probe) => probe != QUERY_PROBE,
            Message::ForwardedAck { .. } => true,
            _ => false,
        };
        let answered = match &header.message {
            Message::ForwardedAck { origin, probe_number: QUERY_PROBE } => {
                // Any other sender may lie about the node.
                let was_asked = self.helpers.get(&origin.node).is_some_and(|helpers| helpers.contains(&from));
                was_asked.then(|| origin.node.clone())
            }
            _ => None,
        };
        self.collect(&mut actions, |foca, runtime| foca.handle_data(&packet, runtime))?;
        Ok((answered.unwrap_or(from), actions))
    }

    /// Queries a member, directly and through some others.
    pub(super) fn ask(&mut self, node: &NodeId) -> Result<Vec<SwimAction>, SwimError> {
        let Some(target) = self.foca.iter_members().map(Member::id).find(|id| id.node == *node).cloned() else {
            return Ok(vec![]);
        };
        let helpers = self.other_members(Some(&target), HELPERS);
        self.helpers.insert(node.clone(), helpers.iter().map(|helper| helper.node.clone()).collect());
        let through = |helper: &SwimId| {
            self.message_to(helper, Message::PingReq { target: target.clone(), probe_number: QUERY_PROBE }, &[])
        };
        let direct = self.message_to(&target, Message::Ping(QUERY_PROBE), &[]);
        std::iter::once(direct).chain(helpers.iter().map(through)).collect()
    }

    /// Accepts no more answers of a node through the members that were asked to [query](Self::ask) it.
    pub(super) fn forget_helpers(&mut self, node: &NodeId) {
        self.helpers.remove(node);
    }

    /// Handles the arrival of a node's record with this incarnation: what others have said about the node may
    /// be confirmed now.
    pub(super) fn confirm(&mut self, node: &NodeId, incarnation: u64) -> Result<Vec<SwimAction>, SwimError> {
        if self.unconfirmed.get(node).is_none_or(|update| update.id().incarnation > incarnation) {
            return Ok(vec![]);
        }
        let update = self.unconfirmed.remove(node);
        self.act(|foca, runtime| foca.apply_many(update.into_iter(), true, runtime))
    }

    /// Returns the incarnation of this node, which grows when it rejoins.
    pub(super) fn incarnation(&self) -> u64 {
        self.foca.identity().incarnation
    }

    /// Handles a due timer. An error is expected after the process was frozen for a while; foca
    /// continues.
    ///
    /// `sends` checks whether a message of a node arrived recently, in any way.
    pub(super) fn fire_timer(
        &mut self,
        timer: Timer,
        sends: impl Fn(&NodeId) -> bool,
    ) -> Result<Vec<SwimAction>, SwimError> {
        let mut actions = vec![];
        match &timer {
            foca::Timer::ChangeSuspectToDown { member_id, incarnation, .. } => {
                if !self.unanswered(member_id, *incarnation) {
                    // foca 2.0.0 keeps such a member, but notifies it that it is down all the same.
                    // The member would rejoin under a new identity for no reason.
                    self.deferred.remove(&member_id.node);
                    self.members_queried.remove(&member_id.node);
                    return Ok(actions);
                }
                if self.defers_verdict(&member_id.node, sends(&member_id.node)) {
                    return Ok(vec![SwimAction::SetTimer(self.probe_period, timer)]);
                }
                if self.unanswered_probes() > 1 && self.members_queried.insert(member_id.node.clone()) {
                    let mut actions_now = self.query_members()?;
                    actions_now.push(SwimAction::SetTimer(self.probe_period, timer));
                    return Ok(actions_now);
                }
                self.deferred.remove(&member_id.node);
                self.members_queried.remove(&member_id.node);
            }
            foca::Timer::ProbeRandomMember(_) => {
                self.probe_answers = self.probe_answers << 1 | u8::from(self.probe_answered);
                self.probe_answered = false;
            }
            _ => {}
        }
        let result = self.collect(&mut actions, |foca, runtime| foca.handle_timer(timer, runtime));
        if let Err(problem) = result {
            tracing::debug!(%problem, "a probe timer fired late");
        }
        Ok(actions)
    }

    /// Checks whether fewer than half of this node's recent probes were answered. Then this node
    /// more likely fails to send or receive than most members failed (local health awareness, as in
    /// Lifeguard: Dadgar, Phillips, Currey 2018).
    pub(super) fn is_unhealthy(&self) -> bool {
        self.unanswered_probes() * 2 > PROBES_MAX
    }

    fn unanswered_probes(&self) -> u32 {
        PROBES_MAX - (self.probe_answers & ((1 << PROBES_MAX) - 1)).count_ones()
    }

    /// Queries the view of all members, or of some in a large fleet: the answer of a suspect may have reached
    /// them, and not this node.
    fn query_members(&mut self) -> Result<Vec<SwimAction>, SwimError> {
        let asked = self.confidants(None);
        self.act(|foca, runtime| asked.into_iter().try_for_each(|member| foca.announce(member, &mut *runtime)))
    }

    /// Checks whether to wait for another probe before a verdict. An unhealthy node waits as long
    /// as the suspect sends messages, else for a limited time.
    fn defers_verdict(&mut self, suspect: &NodeId, sends: bool) -> bool {
        if !self.is_unhealthy() {
            return false;
        }
        if sends {
            return true;
        }
        let total = self.deferred.entry(suspect.clone()).or_default();
        *total += self.probe_period;
        *total <= self.deferral_max
    }

    /// Announces this node to another node, which replies with its members.
    pub(super) fn announce_to(&mut self, node: &NodeId) -> Result<Vec<SwimAction>, SwimError> {
        self.act(|foca, runtime| foca.announce(SwimId::lowest(node.clone()), runtime))
    }

    /// Suspects a member for a reason outside of foca, and gossips the suspicion so that the member
    /// can refute it.
    pub(super) fn suspect(&mut self, node: &NodeId) -> Result<Option<(Suspicion, Vec<SwimAction>)>, SwimError> {
        let Some(member) = self.foca.iter_members().find(|member| member.id().node == *node) else { return Ok(None) };
        let suspicion = Suspicion { id: member.id().clone(), incarnation: member.incarnation() };
        let update = Member::new(suspicion.id.clone(), suspicion.incarnation, State::Suspect);
        Ok(Some((suspicion, self.gossip_update(update)?)))
    }

    /// Declares a suspect down, unless it has refuted the suspicion.
    pub(super) fn declare_down(&mut self, suspicion: &Suspicion) -> Result<Vec<SwimAction>, SwimError> {
        if !self.unanswered(&suspicion.id, suspicion.incarnation) {
            return Ok(vec![]);
        }
        self.gossip_update(Member::new(suspicion.id.clone(), suspicion.incarnation, State::Down))
    }

    /// Adopts a later incarnation of this node that another node has stored.
    pub(super) fn adopt_incarnation(&mut self, incarnation: u64) -> Result<Vec<SwimAction>, SwimError> {
        let own = self.foca.identity();
        let stored = SwimId { incarnation, ..own.clone() };
        match stored.renew() {
            Some(next) if next.win_addr_conflict(own) => self.act(|foca, runtime| foca.change_identity(next, runtime)),
            _ => Ok(vec![]),
        }
    }

    /// Announces to all members that this node leaves. Only what it says itself counts at once, so each member hears
    /// it from this node.
    pub(super) fn leave(&mut self) -> Result<Vec<SwimAction>, SwimError> {
        let mut actions = self.tell_members(&[Member::new(self.foca.identity().clone(), 0, State::Down)])?;
        self.collect(&mut actions, |foca, runtime| foca.leave_cluster(runtime))?;
        Ok(actions)
    }

    /// Sends these updates to all members, under the identity of this node.
    fn tell_members(&self, updates: &[Member<SwimId>]) -> Result<Vec<SwimAction>, SwimError> {
        let tell = |member: &Member<SwimId>| self.message_to(member.id(), Message::Gossip, updates);
        self.foca.iter_members().map(tell).collect()
    }

    /// Encodes a message to a member with these updates.
    fn message_to(
        &self,
        to: &SwimId,
        message: Message<SwimId>,
        updates: &[Member<SwimId>],
    ) -> Result<SwimAction, SwimError> {
        // The incarnation has no effect on the members' view of this node.
        let header = Header { src: self.foca.identity().clone(), src_incarnation: 0, dst: to.clone(), message };
        Ok(SwimAction::Send(to.node.clone(), with_version(encode(&header, updates)?)))
    }

    /// Returns the members to notify or to ask about a suspect: random members in a large fleet, else all.
    fn confidants(&mut self, suspect: Option<&SwimId>) -> Vec<SwimId> {
        self.other_members(suspect, self.confidants_max)
    }

    /// Returns random members other than `member`, at most `count`.
    fn other_members(&mut self, member: Option<&SwimId>, count: usize) -> Vec<SwimId> {
        let others = self.foca.iter_members().map(Member::id).filter(|id| Some(*id) != member);
        let mut others: Vec<SwimId> = others.cloned().collect();
        if others.len() > count {
            for place in 0..count {
                let chosen = self.rng.random_range(place..others.len());
                others.swap(place, chosen);
            }
            others.truncate(count);
        }
        others
    }

    /// Checks whether a member is still suspected and has not increased its incarnation since.
    fn unanswered(&self, id: &SwimId, incarnation: foca::Incarnation) -> bool {
        let mut members = self.foca.iter_members();
        members.any(|m| m.id() == id && m.incarnation() == incarnation && m.state() == State::Suspect)
    }

    fn gossip_update(&mut self, update: Member<SwimId>) -> Result<Vec<SwimAction>, SwimError> {
        self.act(|foca, runtime| {
            foca.apply_many(std::iter::once(update), true, &mut *runtime)?;
            foca.gossip(runtime)
        })
    }

    fn act(
        &mut self,
        operation: impl FnOnce(
            &mut Foca<SwimId, PacketCodec, ChaCha8Rng, NoCustomBroadcast>,
            &mut AccumulatingRuntime<SwimId>,
        ) -> Result<(), foca::Error>,
    ) -> Result<Vec<SwimAction>, SwimError> {
        let mut actions = vec![];
        self.collect(&mut actions, operation)?;
        Ok(actions)
    }

    fn collect(
        &mut self,
        actions: &mut Vec<SwimAction>,
        operation: impl FnOnce(
            &mut Foca<SwimId, PacketCodec, ChaCha8Rng, NoCustomBroadcast>,
            &mut AccumulatingRuntime<SwimId>,
        ) -> Result<(), foca::Error>,
    ) -> Result<(), SwimError> {
        let mut runtime = AccumulatingRuntime::new();
        let result = operation(&mut self.foca, &mut runtime);
        while let Some(notification) = runtime.to_notify() {
            match notification {
                OwnedNotification::MemberUp(id) => actions.push(SwimAction::Up(id.node)),
                OwnedNotification::MemberDown(id) => {
                    self.helpers.remove(&id.node);
                    actions.push(SwimAction::Down(id.node));
                }
                OwnedNotification::Rejoin(_) => actions.push(SwimAction::Rejoined),
                // A restart faster than the verdict; changes in the presence of any member; the own
                // leave.
                OwnedNotification::Rename(..)
                | OwnedNotification::Active
                | OwnedNotification::Idle
                | OwnedNotification::Defunct => {}
            }
        }
        self.compare_suspects(actions);
        if actions.contains(&SwimAction::Rejoined) {
            // Others believe a new identity only from this node, or after its record.
            actions.extend(self.tell_members(&[])?);
        }
        while let Some((to, packet)) = runtime.to_send() {
            actions.push(SwimAction::Send(to.node, with_version(packet)));
        }
        while let Some((after, timer)) = runtime.to_schedule() {
            if let foca::Timer::ChangeSuspectToDown { member_id, .. } = &timer {
                // The own probe failed. Every node that receives from this node should receive the
                // suspicion at once: random gossip needs a healthy link to most members. In a large
                // fleet, where relays connect all nodes, it spreads from some of them.
                let confidants = self.confidants(Some(member_id));
                actions.extend(confidants.iter().filter_map(|to| self.send_suspicion(to, member_id)));
            }
            actions.push(SwimAction::SetTimer(extended(after, &timer), timer));
        }
        Ok(result?)
    }

    /// Queries a suspect and sends it the suspicion, which it refutes with the same packet. Gossip
    /// about it goes to a few random members, and so does the refutation. If a single node receives
    /// from the suspect, or the suspect from a single node, that might be too late.
    fn query_suspect(&self, node: &NodeId) -> Option<SwimAction> {
        let suspect = self.foca.iter_members().find(|member| member.id().node == *node)?.id().clone();
        self.send_suspicion(&suspect, &suspect)
    }

    /// Queries a member and sends it a suspicion.
    fn send_suspicion(&self, to: &SwimId, suspect: &SwimId) -> Option<SwimAction> {
        let suspect = self.foca.iter_members().find(|member| member.id() == suspect)?;
        // Not a probe of foca, so a missing answer has no effect. Only the sender matters.
        self.message_to(to, Message::Ping(QUERY_PROBE), std::slice::from_ref(suspect)).ok()
    }

    /// foca does not report suspicions, so the current suspects are compared with the previous
    /// suspects. A member that went down is in neither report.
    fn compare_suspects(&mut self, actions: &mut Vec<SwimAction>) {
        let suspects = self.foca.iter_members().filter(|member| member.state() == State::Suspect);
        let suspects: BTreeSet<NodeId> = suspects.map(|member| member.id().node.clone()).collect();
        let before = std::mem::replace(&mut self.suspects, suspects);
        for node in self.suspects.difference(&before).cloned().collect::<Vec<_>>() {
            actions.extend(self.query_suspect(&node));
            actions.push(SwimAction::Suspected(node));
        }
        let cleared = before.difference(&self.suspects);
        let alive = |node: &&NodeId| self.foca.iter_members().any(|member| member.id().node == **node);
        actions.extend(cleared.filter(alive).cloned().map(SwimAction::Cleared));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Settings;
    use consort_protocol::ids::FleetId;
    use rand::SeedableRng;

    fn id(number: usize) -> SwimId {
        SwimId { node: NodeId::new(format!("node{number}")).unwrap(), incarnation: 1, rejoins: 0 }
    }

    #[test]
    fn a_node_of_a_large_fleet_notifies_some_members_about_a_suspect() {
        let own = id(0).node;
        let small = Settings::new(FleetId::new("ward").unwrap(), own.clone(), 1);
        for (settings, expected) in [(small.clone(), 39), (Settings { scoped: true, ..small }, 10)] {
            let rng = ChaCha8Rng::seed_from_u64(1);
            let mut swim = Swim::new(own.clone(), 1, settings.swim(), settings.confidants_max(), rng);
            let members = (1..=40).map(|number| Member::new(id(number), 0, State::Alive));
            swim.act(|foca, runtime| foca.apply_many(members, true, runtime)).unwrap();
            let confidants: BTreeSet<NodeId> =
                swim.confidants(Some(&id(7))).into_iter().map(|member| member.node).collect();
            assert_eq!(confidants.len(), expected);
            assert!(!confidants.contains(&id(7).node));
        }
    }

    #[test]
    fn a_helper_answers_for_a_node_only_during_the_query() {
        let own = id(0).node;
        let settings = Settings::new(FleetId::new("ward").unwrap(), own.clone(), 1);
        let mut swim = Swim::new(own, 1, settings.swim(), usize::MAX, ChaCha8Rng::seed_from_u64(1));
        let members = (1..=4).map(|number| Member::new(id(number), 0, State::Alive));
        swim.act(|foca, runtime| foca.apply_many(members, true, runtime)).unwrap();
        swim.ask(&id(4).node).unwrap();
        let message = Message::ForwardedAck { origin: id(4), probe_number: QUERY_PROBE };
        let header = Header { src: id(1), src_incarnation: 0, dst: swim.foca.identity().clone(), message };
        let answer = with_version(encode(&header, &[]).unwrap());
        assert_eq!(swim.receive(&answer, |_| false, |_| None).unwrap().0, id(4).node);
        swim.forget_helpers(&id(4).node);
        assert_eq!(swim.receive(&answer, |_| false, |_| None).unwrap().0, id(1).node);
    }
}
