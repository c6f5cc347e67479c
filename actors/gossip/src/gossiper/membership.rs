//! Members of the fleet: presence tokens, announcements to absent nodes, and failure detection.

use super::agenda::ScheduledTimer;
use super::context::Context;
use super::event::{Action, GossipError};
use crate::settings::Settings;
use crate::shared::MemberStatus;
use crate::swim::{Suspicion, Swim, SwimAction, Timer};
use consort_protocol::ids::NodeId;
use consort_protocol::knowledge::RecordStamp;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Maximum number of announcements at once, and the pause before the next. When hundreds of nodes
/// start together, the replies to the first few announcements introduce most of the others.
const ANNOUNCEMENTS_MAX: usize = 5;
const ANNOUNCEMENT_PAUSE: Duration = Duration::from_millis(100);

/// Members of the fleet, in this node's view.
pub(super) struct Membership {
    swim: Swim,
    /// Nodes with a presence token.
    tokens: BTreeSet<NodeId>,
    to_announce: BTreeSet<NodeId>,
    /// Nodes with a vanished token that were queried, with the number of the query.
    queried: BTreeMap<NodeId, u64>,
}

impl Membership {
    pub(super) fn new(settings: &Settings, rng: ChaCha8Rng) -> Membership {
        Membership {
            swim: Swim::new(
                settings.node.clone(),
                settings.incarnation,
                settings.swim(),
                settings.confidants_max(),
                rng,
            ),
            tokens: BTreeSet::new(),
            to_announce: BTreeSet::new(),
            queried: BTreeMap::new(),
        }
    }

    /// Returns the nodes with a presence token.
    pub(super) fn tokens(&self) -> &BTreeSet<NodeId> {
        &self.tokens
    }

    /// Handles a packet of failure detection.
    pub(super) fn receive_packet(&mut self, bytes: &[u8], context: &mut Context<'_>) -> Result<(), GossipError> {
        let (status, now) = (&context.state.status, context.now);
        let patience = context.core.settings.token_probe_timeout();
        // This node queries each suspect at once.
        let agrees = |node: &NodeId| match status.get(node) {
            Some(MemberStatus::Suspect { since }) => now.since(*since) >= patience,
            _ => false,
        };
        let base = &context.state.base;
        let incarnation = |node: &NodeId| base.get(node).map(|stored| stored.record.stamp.incarnation);
        let (from, actions) = self.swim.receive(bytes, agrees, incarnation)?;
        self.queried.remove(&from);
        self.perform(actions, context);
        Ok(())
    }

    /// Handles a new or renewed record of another node.
    pub(super) fn confirm(&mut self, owner: &NodeId, context: &mut Context<'_>) -> Result<(), GossipError> {
        let Some(stored) = context.state.base.get(owner) else { return Ok(()) };
        let actions = self.swim.confirm(owner, stored.record.stamp.incarnation)?;
        self.perform(actions, context);
        Ok(())
    }

    /// Handles the appearance of a presence token.
    pub(super) fn token_appeared(&mut self, node: NodeId, context: &mut Context<'_>) {
        self.tokens.insert(node.clone());
        self.queried.remove(&node);
        self.schedule_announcement(node, context);
    }

    /// Handles the disappearance of a presence token: queries the node.
    pub(super) fn token_vanished(&mut self, node: NodeId, context: &mut Context<'_>) -> Result<(), GossipError> {
        self.tokens.remove(&node);
        self.query(node, context)
    }

    /// Queries a node that is alive for all this node knows, and suspects it if it does not answer.
    fn query(&mut self, node: NodeId, context: &mut Context<'_>) -> Result<(), GossipError> {
        if context.state.is_alive(&node) && !self.queried.contains_key(&node) {
            let number = context.core.agenda.number();
            self.queried.insert(node.clone(), number);
            let timer = ScheduledTimer::QueryTimeout(node.clone(), number);
            context.set_timer(context.core.settings.token_probe_timeout(), timer);
            self.announce_to(&node, context)?;
        }
        Ok(())
    }

    /// Handles the missing answer of a node with a vanished token.
    pub(super) fn handle_query_timeout(
        &mut self,
        node: NodeId,
        number: u64,
        context: &mut Context<'_>,
    ) -> Result<(), GossipError> {
        if self.queried.get(&node) != Some(&number) {
            return Ok(());
        }
        // If half of all nodes vanish at once, this node is more likely at fault.
        let other_members = context.state.status.values().filter(|status| status.is_alive()).count().saturating_sub(1);
        let suspicious = self.queried.len() > 1 && self.queried.len() * 2 >= other_members;
        let suspected = if suspicious || self.swim.is_unhealthy() { None } else { self.swim.suspect(&node)? };
        let Some((suspicion, actions)) = suspected else {
            self.queried.remove(&node);
            return Ok(());
        };
        self.perform(actions, context);
        // The query or its answer may have been lost. Any message from the node clears the
        // suspicion here.
        self.announce_to(&node, context)?;
        let timeout = context.core.settings.suspicion_when_vanished * suspicion.timeout_factor();
        context.set_timer(timeout, ScheduledTimer::SuspicionTimeout(suspicion, node, number));
        Ok(())
    }

    /// Declares a node with a vanished token down, unless it has refuted the suspicion.
    pub(super) fn handle_suspicion_timeout(
        &mut self,
        suspicion: &Suspicion,
        node: &NodeId,
        number: u64,
        context: &mut Context<'_>,
    ) -> Result<(), GossipError> {
        if self.queried.get(node) == Some(&number) {
            self.queried.remove(node);
            let actions = self.swim.declare_down(suspicion)?;
            self.perform(actions, context);
        }
        Ok(())
    }

    /// Handles a due timer of the failure detector.
    pub(super) fn fire_timer(&mut self, timer: Timer, context: &mut Context<'_>) -> Result<(), GossipError> {
        let recent = context.heartbeat_interval() * 3;
        let (base, now) = (&context.state.base, context.now);
        let sends = |node: &NodeId| base.get(node).is_some_and(|stored| stored.age(now) < recent);
        let actions = self.swim.fire_timer(timer, sends)?;
        self.perform(actions, context);
        Ok(())
    }

    /// Adopts a later incarnation of this node that another node has stored.
    pub(super) fn adopt_incarnation(&mut self, incarnation: u64, context: &mut Context<'_>) -> Result<(), GossipError> {
        let actions = self.swim.adopt_incarnation(incarnation)?;
        self.perform(actions, context);
        Ok(())
    }

    /// Schedules an announcement to a node, unless it is known to be alive.
    pub(super) fn schedule_announcement(&mut self, node: NodeId, context: &mut Context<'_>) {
        if node == context.core.settings.node || context.state.is_alive(&node) {
            return;
        }
        if self.to_announce.is_empty() {
            let delay = context.greeting_delay();
            context.set_timer(delay, ScheduledTimer::Announce);
        }
        self.to_announce.insert(node);
    }

    /// Schedules an announcement to a random absent node with a token or an old record: an earlier
    /// announcement may have been lost, or a cut may have healed.
    pub(super) fn announce_to_absent(&mut self, context: &mut Context<'_>) {
        let known = self.tokens.iter().chain(context.core.records.absent_nodes());
        let absent: BTreeSet<&NodeId> = known.filter(|node| !context.state.is_alive(node)).collect();
        if !absent.is_empty() {
            let chosen = context.core.rng.random_range(0..absent.len());
            let chosen = absent.into_iter().nth(chosen).cloned();
            if let Some(node) = chosen {
                self.schedule_announcement(node, context);
            }
        }
    }

    /// Sends some of the scheduled announcements.
    pub(super) fn send_announcements(&mut self, context: &mut Context<'_>) -> Result<(), GossipError> {
        self.to_announce.retain(|node| !context.state.is_alive(node));
        for _ in 0..ANNOUNCEMENTS_MAX.min(self.to_announce.len()) {
            let chosen = context.core.rng.random_range(0..self.to_announce.len());
            if let Some(node) = self.to_announce.iter().nth(chosen).cloned() {
                self.to_announce.remove(&node);
                self.announce_to(&node, context)?;
            }
        }
        if !self.to_announce.is_empty() {
            context.set_timer(ANNOUNCEMENT_PAUSE, ScheduledTimer::Announce);
        }
        Ok(())
    }

    /// Announces to all members that this node leaves.
    pub(super) fn leave(&mut self) -> Vec<Action> {
        let send = |action| match action {
            SwimAction::Send(to, bytes) => Some(Action::Send(to, bytes)),
            SwimAction::SetTimer(..)
            | SwimAction::Up(_)
            | SwimAction::Down(_)
            | SwimAction::Suspected(_)
            | SwimAction::Cleared(_)
            | SwimAction::Claimed(_)
            | SwimAction::Rejoined => None,
        };
        self.swim.leave().unwrap_or_default().into_iter().filter_map(send).collect()
    }

    fn announce_to(&mut self, node: &NodeId, context: &mut Context<'_>) -> Result<(), GossipError> {
        let actions = self.swim.announce_to(node)?;
        self.perform(actions, context);
        Ok(())
    }

    fn perform(&mut self, actions: Vec<SwimAction>, context: &mut Context<'_>) {
        let (now, mut claimed) = (context.now, vec![]);
        for action in actions {
            let own = &context.core.settings.node;
            match action {
                SwimAction::Send(to, bytes) => {
                    context.state.counters.packets += 1;
                    context.actions.push(Action::Send(to, bytes));
                }
                SwimAction::SetTimer(delay, timer) => context.set_timer(delay, ScheduledTimer::Swim(timer)),
                SwimAction::Up(node) => {
                    tracing::info!(node = %own, other = %node, "node is alive");
                    context.core.records.mark_alive(&node);
                    context.set_status(node, MemberStatus::Alive { since: now });
                    context.repeat_full_record();
                }
                SwimAction::Down(node) => {
                    tracing::info!(node = %own, other = %node, "node is down");
                    context.core.records.mark_down(&node, now);
                    context.state.counters.down_verdicts += 1;
                    context.set_status(node, MemberStatus::Down { since: now });
                }
                SwimAction::Suspected(node) => {
                    tracing::debug!(node = %own, other = %node, "node is suspected");
                    context.set_status(node, MemberStatus::Suspect { since: now });
                }
                SwimAction::Cleared(node) => context.set_status(node, MemberStatus::Alive { since: now }),
                SwimAction::Claimed(node) => claimed.push(node),
                SwimAction::Rejoined => {
                    tracing::warn!(node = %own, "was declared down by other nodes, and rejoined");
                    context.state.counters.refutations += 1;
                }
            }
        }
        let own = context.core.records.own().stamp;
        if self.swim.incarnation() > own.incarnation {
            // The record confirms the new incarnation to other nodes.
            let stamp = RecordStamp { incarnation: self.swim.incarnation(), version: 0 };
            context.core.records.overtake(stamp, context.state, context.now);
            context.publish();
        }
        for node in claimed {
            // A member that cannot be queried is probed later.
            let _ = self.query(node, context);
        }
    }
}
