//! Who is alive, by the SWIM protocol (Das, Gupta, Motivala 2002) with suspicion, as crate `foca` carries it out.
//!
//! This wraps foca in values: packets and timers go in, [`SwimAction`]s come out. It knows neither the bus nor a clock.

mod packet;

use bytes::Bytes;
use consort_protocol::codec;
use consort_protocol::ids::NodeId;
use foca::{AccumulatingRuntime, Codec as _, Foca, Identity as _, Member, NoCustomBroadcast, OwnedNotification, State};
use packet::Packets;
pub(super) use packet::SwimId;
use rand_chacha::ChaCha8Rng;
use std::time::Duration;

/// A timer that foca asked for, to be given back to it.
pub(super) type Timer = foca::Timer<SwimId>;

/// What is to be done, in the order given.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum SwimAction {
    /// Hand a packet to a node.
    Send(NodeId, Bytes),
    /// Give the timer back after this time.
    After(Duration, Timer),
    /// A node is alive as of now.
    Up(NodeId),
    /// A node is down as of now.
    Down(NodeId),
    /// This node was judged down wrongly, and has come back under a new identity.
    Returned,
}

/// Whom to judge down, unless it has answered the suspicion by then.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Suspicion {
    id: SwimId,
    incarnation: foca::Incarnation,
}

pub(super) struct Swim {
    foca: Foca<SwimId, Packets, ChaCha8Rng, NoCustomBroadcast>,
}

impl Swim {
    pub(super) fn new(node: NodeId, incarnation: u64, config: foca::Config, rng: ChaCha8Rng) -> Swim {
        Swim { foca: Foca::new(SwimId { node, incarnation, returns: 0 }, config, rng, Packets) }
    }

    /// A packet came in. Gives who sent it.
    pub(super) fn hear(&mut self, bytes: &[u8]) -> Result<(NodeId, Vec<SwimAction>), String> {
        let (version, packet) = bytes.split_first().ok_or("empty packet")?;
        if *version != codec::VERSION {
            return Err(format!("wire version {version}, where this node speaks {}", codec::VERSION));
        }
        let from = Packets.decode_header(packet).map_err(|e| e.to_string())?.src.node;
        let actions = self.act(|foca, runtime| foca.handle_data(packet, runtime))?;
        Ok((from, actions))
    }

    /// A timer is due. An error is ordinary after the process was frozen for a while; foca goes on.
    pub(super) fn wake(&mut self, timer: Timer) -> Result<Vec<SwimAction>, String> {
        let mut actions = vec![];
        if let foca::Timer::ChangeSuspectToDown { member_id, incarnation, .. } = &timer
            && !self.unanswered(member_id, *incarnation)
        {
            // foca 2.0.0 leaves such a member alone, but tells it that it is down all the same, upon which it would
            // come back under a new identity for nothing.
            return Ok(actions);
        }
        let result = self.collect(&mut actions, |foca, runtime| foca.handle_timer(timer, runtime));
        if let Err(problem) = result {
            tracing::debug!(%problem, "a probe ran late");
        }
        Ok(actions)
    }

    /// Makes itself known to a node, which answers with whom it knows.
    pub(super) fn greet(&mut self, node: &NodeId) -> Result<Vec<SwimAction>, String> {
        self.act(|foca, runtime| foca.announce(SwimId::least(node.clone()), runtime))
    }

    /// Suspects a member for a reason of our own, and spreads the suspicion so that the member can answer it.
    pub(super) fn suspect(&mut self, node: &NodeId) -> Result<Option<(Suspicion, Vec<SwimAction>)>, String> {
        let Some(member) = self.foca.iter_members().find(|member| member.id().node == *node) else { return Ok(None) };
        let suspicion = Suspicion { id: member.id().clone(), incarnation: member.incarnation() };
        let update = Member::new(suspicion.id.clone(), suspicion.incarnation, State::Suspect);
        Ok(Some((suspicion, self.spread(update)?)))
    }

    /// Judges a suspect down, unless it has answered.
    pub(super) fn condemn(&mut self, suspicion: &Suspicion) -> Result<Vec<SwimAction>, String> {
        if !self.unanswered(&suspicion.id, suspicion.incarnation) {
            return Ok(vec![]);
        }
        self.spread(Member::new(suspicion.id.clone(), suspicion.incarnation, State::Down))
    }

    /// Somebody remembers a later life of this node than its own count says: it takes the count over.
    pub(super) fn overtake(&mut self, incarnation: u64) -> Result<Vec<SwimAction>, String> {
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
            &mut Foca<SwimId, Packets, ChaCha8Rng, NoCustomBroadcast>,
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
            &mut Foca<SwimId, Packets, ChaCha8Rng, NoCustomBroadcast>,
            &mut AccumulatingRuntime<SwimId>,
        ) -> Result<(), foca::Error>,
    ) -> Result<(), String> {
        let mut runtime = AccumulatingRuntime::new();
        let result = verb(&mut self.foca, &mut runtime).map_err(|e| e.to_string());
        while let Some(notification) = runtime.to_notify() {
            match notification {
                OwnedNotification::MemberUp(id) => actions.push(SwimAction::Up(id.node)),
                OwnedNotification::MemberDown(id) => actions.push(SwimAction::Down(id.node)),
                OwnedNotification::Rejoin(_) => actions.push(SwimAction::Returned),
                // A restart that was quicker than the verdict; whether anybody is there; that we are leaving.
                OwnedNotification::Rename(..)
                | OwnedNotification::Active
                | OwnedNotification::Idle
                | OwnedNotification::Defunct => {}
            }
        }
        while let Some((to, packet)) = runtime.to_send() {
            let mut bytes = Vec::with_capacity(packet.len() + 1);
            bytes.push(codec::VERSION);
            bytes.extend(packet);
            actions.push(SwimAction::Send(to.node, bytes.into()));
        }
        while let Some((after, timer)) = runtime.to_schedule() {
            actions.push(SwimAction::After(after, timer));
        }
        result
    }
}
