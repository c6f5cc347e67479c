//! Who is alive, by the SWIM protocol (Das, Gupta, Motivala 2002) with suspicion, as crate `foca` carries it out.
//!
//! This wraps foca in values: packets and timers go in, [`SwimAction`]s come out. It knows neither the bus nor a clock.

mod packet;

use bytes::{BufMut as _, Bytes};
use consort_protocol::codec;
use consort_protocol::ids::NodeId;
use foca::{
    AccumulatingRuntime, Codec as _, Foca, Header, Identity as _, Member, Message, NoCustomBroadcast,
    OwnedNotification, State,
};
use packet::PacketCodec;
pub(super) use packet::SwimId;
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// A timer that foca asked for, to be given back to it.
pub(super) type Timer = foca::Timer<SwimId>;

/// What is to be done, in the order given.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum SwimAction {
    /// Hand a packet to a node.
    Send(NodeId, Bytes),
    /// Give the timer back after this time.
    SetTimer(Duration, Timer),
    /// A node is alive as of now.
    Up(NodeId),
    /// A node is down as of now.
    Down(NodeId),
    /// A node that is alive is suspected as of now.
    Suspected(NodeId),
    /// A node has answered a suspicion.
    Cleared(NodeId),
    /// This node was judged down wrongly, and has come back under a new identity.
    Rejoined,
}

/// Whom to judge down, unless it has answered the suspicion by then.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Suspicion {
    id: SwimId,
    incarnation: foca::Incarnation,
}

impl Suspicion {
    /// How much longer than others it may take to answer.
    pub(super) fn timeout_factor(&self) -> u32 {
        patience(self.id.rejoins)
    }
}

/// How much longer a suspect may take to answer at most, however often it was wronged: 16 s with the default of 2 s.
const PATIENCE_MAX: u32 = 8;

/// How much longer a suspect may take that has come back so often after having been judged down wrongly: its answers take
/// a long way, as they do where only one node hears it, or it hears only one. Twice as long each time, so that it is not
/// judged down and comes back for ever.
pub(super) fn patience(returns: u32) -> u32 {
    1u32.checked_shl(returns).map_or(PATIENCE_MAX, |times| times.clamp(1, PATIENCE_MAX))
}

fn patient(after: Duration, timer: &Timer) -> Duration {
    match timer {
        foca::Timer::ChangeSuspectToDown { member_id, .. } => after * patience(member_id.rejoins),
        _ => after,
    }
}

pub(super) struct Swim {
    foca: Foca<SwimId, PacketCodec, ChaCha8Rng, NoCustomBroadcast>,
    /// Who is suspected now.
    suspects: BTreeSet<NodeId>,
    /// Which of its own last probes were answered: a bit each, the latest lowest.
    answered: u8,
    /// Whether the probe under way was.
    answer: bool,
    /// How long verdicts have been put off because of doubts, by suspect.
    put_off: BTreeMap<NodeId, Duration>,
    /// Suspects about whom everybody was asked before the verdict.
    called: BTreeSet<NodeId>,
    probe_period: Duration,
    put_off_max: Duration,
}

/// The number of a question that is no probe of foca's: those count up and come by this one once in 256.
const TOLD: u8 = 0;

/// Probes that are remembered.
const PROBES: u32 = 6;

/// How often in a row of suspicions a node that doubts itself puts a verdict off.
const PUT_OFF_MAX: u32 = 7;

impl Swim {
    pub(super) fn new(node: NodeId, incarnation: u64, config: foca::Config, rng: ChaCha8Rng) -> Swim {
        let (probe_period, put_off_max) = (config.probe_period, config.suspect_to_down_after * PUT_OFF_MAX);
        Swim {
            foca: Foca::new(SwimId { node, incarnation, rejoins: 0 }, config, rng, PacketCodec),
            suspects: BTreeSet::new(),
            answered: u8::MAX,
            answer: true,
            put_off: BTreeMap::new(),
            called: BTreeSet::new(),
            probe_period,
            put_off_max,
        }
    }

    /// A packet came in. Gives who sent it.
    pub(super) fn receive(&mut self, bytes: &[u8]) -> Result<(NodeId, Vec<SwimAction>), String> {
        let (version, packet) = bytes.split_first().ok_or("empty packet")?;
        if *version != codec::FIRST_VERSION {
            return Err(format!("wire version {version}, where {} is read", codec::FIRST_VERSION));
        }
        let header = PacketCodec.decode_header(packet).map_err(|e| e.to_string())?;
        self.answer |= match header.message {
            Message::Ack(probe) => probe != TOLD,
            Message::ForwardedAck { .. } => true,
            _ => false,
        };
        let from = header.src.node;
        let actions = self.act(|foca, runtime| foca.handle_data(packet, runtime))?;
        Ok((from, actions))
    }

    /// A timer is due. An error is ordinary after the process was frozen for a while; foca goes on.
    ///
    /// `speaks` tells whether somebody was heard lately, in whatever way.
    pub(super) fn fire_timer(
        &mut self,
        timer: Timer,
        speaks: impl Fn(&NodeId) -> bool,
    ) -> Result<Vec<SwimAction>, String> {
        let mut actions = vec![];
        match &timer {
            foca::Timer::ChangeSuspectToDown { member_id, incarnation, .. } => {
                if !self.unanswered(member_id, *incarnation) {
                    // foca 2.0.0 leaves such a member alone, but tells it that it is down all the same, upon which it
                    // would come back under a new identity for nothing.
                    self.put_off.remove(&member_id.node);
                    self.called.remove(&member_id.node);
                    return Ok(actions);
                }
                if self.puts_off(&member_id.node, speaks(&member_id.node)) {
                    return Ok(vec![SwimAction::SetTimer(self.probe_period, timer)]);
                }
                if self.unanswered_probes() > 1 && self.called.insert(member_id.node.clone()) {
                    let mut what = self.ask_all()?;
                    what.push(SwimAction::SetTimer(self.probe_period, timer));
                    return Ok(what);
                }
                self.put_off.remove(&member_id.node);
                self.called.remove(&member_id.node);
            }
            foca::Timer::ProbeRandomMember(_) => {
                self.answered = self.answered << 1 | u8::from(self.answer);
                self.answer = false;
            }
            _ => {}
        }
        let result = self.collect(&mut actions, |foca, runtime| foca.handle_timer(timer, runtime));
        if let Err(problem) = result {
            tracing::debug!(%problem, "a probe ran late");
        }
        Ok(actions)
    }

    /// Whether fewer than half of its own last probes were answered: it is rather this node that is not heard or does not
    /// hear than that most others died (local health awareness, as in Lifeguard: Dadgar, Phillips, Currey 2018).
    pub(super) fn is_unhealthy(&self) -> bool {
        self.unanswered_probes() * 2 > PROBES
    }

    fn unanswered_probes(&self) -> u32 {
        PROBES - (self.answered & ((1 << PROBES) - 1)).count_ones()
    }

    /// Asks all whom they believe alive: the answer of a suspect may have reached them, and not this node.
    fn ask_all(&mut self) -> Result<Vec<SwimAction>, String> {
        let all: Vec<SwimId> = self.foca.iter_members().map(|member| member.id().clone()).collect();
        self.act(|foca, runtime| all.into_iter().try_for_each(|member| foca.announce(member, &mut *runtime)))
    }

    /// Whether to wait for another probe before a verdict: while this node doubts itself, for as long as the suspect
    /// speaks; if it does not, for some time.
    fn puts_off(&mut self, suspect: &NodeId, speaks: bool) -> bool {
        if !self.is_unhealthy() {
            return false;
        }
        if speaks {
            return true;
        }
        let so_far = self.put_off.entry(suspect.clone()).or_default();
        *so_far += self.probe_period;
        *so_far <= self.put_off_max
    }

    /// Makes itself known to a node, which answers with whom it knows.
    pub(super) fn announce_to(&mut self, node: &NodeId) -> Result<Vec<SwimAction>, String> {
        self.act(|foca, runtime| foca.announce(SwimId::lowest(node.clone()), runtime))
    }

    /// Suspects a member for a reason of our own, and spreads the suspicion so that the member can answer it.
    pub(super) fn suspect(&mut self, node: &NodeId) -> Result<Option<(Suspicion, Vec<SwimAction>)>, String> {
        let Some(member) = self.foca.iter_members().find(|member| member.id().node == *node) else { return Ok(None) };
        let suspicion = Suspicion { id: member.id().clone(), incarnation: member.incarnation() };
        let update = Member::new(suspicion.id.clone(), suspicion.incarnation, State::Suspect);
        Ok(Some((suspicion, self.spread(update)?)))
    }

    /// Judges a suspect down, unless it has answered.
    pub(super) fn declare_down(&mut self, suspicion: &Suspicion) -> Result<Vec<SwimAction>, String> {
        if !self.unanswered(&suspicion.id, suspicion.incarnation) {
            return Ok(vec![]);
        }
        self.spread(Member::new(suspicion.id.clone(), suspicion.incarnation, State::Down))
    }

    /// Somebody remembers a later life of this node than its own count says: it takes the count over.
    pub(super) fn adopt_incarnation(&mut self, incarnation: u64) -> Result<Vec<SwimAction>, String> {
        let mine = self.foca.identity();
        let next = SwimId { incarnation, ..mine.clone() };
        match next.renew() {
            Some(next) if next.win_addr_conflict(mine) => self.act(|foca, runtime| foca.change_identity(next, runtime)),
            _ => Ok(vec![]),
        }
    }

    /// Tells a few members that this node goes.
    pub(super) fn leave(&mut self) -> Result<Vec<SwimAction>, String> {
        self.act(|foca, runtime| foca.leave_cluster(runtime))
    }

    /// Whether a member is still suspected, and has not raised its count of answers since.
    fn unanswered(&self, id: &SwimId, incarnation: foca::Incarnation) -> bool {
        let mut members = self.foca.iter_members();
        members.any(|m| m.id() == id && m.incarnation() == incarnation && m.state() == State::Suspect)
    }

    fn spread(&mut self, update: Member<SwimId>) -> Result<Vec<SwimAction>, String> {
        self.act(|foca, runtime| {
            foca.apply_many(std::iter::once(update), true, &mut *runtime)?;
            foca.gossip(runtime)
        })
    }

    fn act(
        &mut self,
        verb: impl FnOnce(
            &mut Foca<SwimId, PacketCodec, ChaCha8Rng, NoCustomBroadcast>,
            &mut AccumulatingRuntime<SwimId>,
        ) -> Result<(), foca::Error>,
    ) -> Result<Vec<SwimAction>, String> {
        let mut actions = vec![];
        self.collect(&mut actions, verb)?;
        Ok(actions)
    }

    fn collect(
        &mut self,
        actions: &mut Vec<SwimAction>,
        verb: impl FnOnce(
            &mut Foca<SwimId, PacketCodec, ChaCha8Rng, NoCustomBroadcast>,
            &mut AccumulatingRuntime<SwimId>,
        ) -> Result<(), foca::Error>,
    ) -> Result<(), String> {
        let mut runtime = AccumulatingRuntime::new();
        let result = verb(&mut self.foca, &mut runtime).map_err(|e| e.to_string());
        while let Some(notification) = runtime.to_notify() {
            match notification {
                OwnedNotification::MemberUp(id) => actions.push(SwimAction::Up(id.node)),
                OwnedNotification::MemberDown(id) => actions.push(SwimAction::Down(id.node)),
                OwnedNotification::Rejoin(_) => actions.push(SwimAction::Rejoined),
                // A restart that was quicker than the verdict; whether anybody is there; that we are leaving.
                OwnedNotification::Rename(..)
                | OwnedNotification::Active
                | OwnedNotification::Idle
                | OwnedNotification::Defunct => {}
            }
        }
        self.compare_suspects(actions);
        while let Some((to, packet)) = runtime.to_send() {
            let mut bytes = Vec::with_capacity(packet.len() + 1);
            bytes.push(codec::FIRST_VERSION);
            bytes.extend(packet);
            actions.push(SwimAction::Send(to.node, bytes.into()));
        }
        while let Some((after, timer)) = runtime.to_schedule() {
            if let foca::Timer::ChangeSuspectToDown { member_id, .. } = &timer {
                // Its own probe failed. Whoever hears this node should hear of it at once: to spread it by chance takes a
                // healthy link to most.
                let all = self.foca.iter_members().filter(|member| member.id() != member_id);
                let all: Vec<SwimId> = all.map(|member| member.id().clone()).collect();
                actions.extend(all.iter().filter_map(|to| self.tell(to, member_id)));
            }
            actions.push(SwimAction::SetTimer(patient(after, &timer), timer));
        }
        result
    }

    /// Asks a suspect, and tells it of the suspicion, which it answers with the same packet. Gossip of it goes to a few at
    /// random, and so does the answer; where only one node hears the suspect, or is heard by it, that might be too late.
    fn tell_suspect(&self, node: &NodeId) -> Option<SwimAction> {
        let suspect = self.foca.iter_members().find(|member| member.id().node == *node)?.id().clone();
        self.tell(&suspect, &suspect)
    }

    /// Asks a member to answer, and tells it of a suspicion.
    fn tell(&self, to: &SwimId, suspect: &SwimId) -> Option<SwimAction> {
        let suspect = self.foca.iter_members().find(|member| member.id() == suspect)?;
        let header = Header {
            src: self.foca.identity().clone(),
            // Nobody believes less of this node for it.
            src_incarnation: 0,
            dst: to.clone(),
            // No probe of foca's own, which does not miss the answer: all that counts is who sends it.
            message: Message::Ping(TOLD),
        };
        let mut bytes = vec![codec::FIRST_VERSION];
        PacketCodec.encode_header(&header, &mut bytes).ok()?;
        bytes.put_u16(1);
        PacketCodec.encode_member(suspect, &mut bytes).ok()?;
        Some(SwimAction::Send(to.node.clone(), bytes.into()))
    }

    /// foca does not notify of suspicions: who is suspected is compared with who was. One who went down is neither.
    fn compare_suspects(&mut self, actions: &mut Vec<SwimAction>) {
        let suspects = self.foca.iter_members().filter(|member| member.state() == State::Suspect);
        let suspects: BTreeSet<NodeId> = suspects.map(|member| member.id().node.clone()).collect();
        let before = std::mem::replace(&mut self.suspects, suspects);
        for node in self.suspects.difference(&before).cloned().collect::<Vec<_>>() {
            actions.extend(self.tell_suspect(&node));
            actions.push(SwimAction::Suspected(node));
        }
        let cleared = before.difference(&self.suspects);
        let alive = |node: &&NodeId| self.foca.iter_members().any(|member| member.id().node == **node);
        actions.extend(cleared.filter(alive).cloned().map(SwimAction::Cleared));
    }
}
