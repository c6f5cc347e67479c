//! Members of the fleet: presence tokens, announcements to absent nodes, and failure detection.

use super::agenda::ScheduledTimer;
use super::context::Context;
use super::event::{Action, GossipError};
use crate::settings::Settings;
use crate::shared::MemberStatus;
use crate::swim::{Suspicion, Swim, SwimAction, Timer, begins_probe};
use consort_protocol::ids::NodeId;
use consort_protocol::knowledge::RecordStamp;
use consort_protocol::units::NodeTime;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Maximum number of announcements at once, and the pause before the next. When hundreds of nodes
/// start together, the replies to the first few announcements introduce most of the others.
const ANNOUNCEMENTS_MAX: usize = 5;
const ANNOUNCEMENT_PAUSE: Duration = Duration::from_millis(100);

/// Duration of the lease that a node of a large fleet holds with each node that receives heartbeats, in heartbeats. Raised:
/// fewer needless queries, and a node whose token does not vanish is declared down later. 3: two are 5.5 s apart at most, and
/// one is left out shortly after another update.
const LEASE_HEARTBEATS: u32 = 3;

/// Maximum number of nodes with an ended lease that are queried in a round. When all leases end at once, this node is at
/// fault.
const LEASE_QUERIES_MAX: usize = 5;

/// Members of the fleet, in this node's view.
pub(super) struct Membership {
    swim: Swim,
    /// Nodes with a presence token.
    tokens: BTreeSet<NodeId>,
    to_announce: BTreeSet<NodeId>,
    /// Nodes with a vanished token that were queried, with the number of the query.
    queried: BTreeMap<NodeId, u64>,
    /// Latest answers to queries after an ended lease.
    answered: BTreeMap<NodeId, NodeTime>,
    /// Time since which this node checks leases; `None` while it does not.
    leases_since: Option<NodeTime>,
    /// Timer of the next probe, while this node does not probe.
    parked_probe: Option<Timer>,
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
            answered: BTreeMap::new(),
            leases_since: None,
            parked_probe: None,
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
        if self.queried.remove(&from).is_some() && self.leases_since.is_some() {
            self.answered.insert(from, now);
        }
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
            // The helpers of an earlier query may lie. This query has none.
            self.swim.forget_helpers(&node);
            self.expect_answer(node.clone(), context.core.settings.token_probe_timeout(), context);
            self.announce_to(&node, context)?;
        }
        Ok(())
    }

    /// Expects the answer of a queried node within `limit`.
    fn expect_answer(&mut self, node: NodeId, limit: Duration, context: &mut Context<'_>) {
        let number = context.core.agenda.number();
        self.queried.insert(node.clone(), number);
        context.set_timer(limit, ScheduledTimer::QueryTimeout(node, number));
    }

    /// In a large fleet queries nodes whose lease has ended, if this node receives the heartbeats of all nodes: it has
    /// missed several of the node.
    pub(super) fn check_leases(&mut self, context: &mut Context<'_>) {
        if context.leaves_detection_to_others() || !context.core.settings.scoped {
            (self.leases_since, self.answered) = (None, BTreeMap::new());
            return;
        }
        if let Some(timer) = self.parked_probe.take() {
            context.set_timer(context.core.settings.probe_period, ScheduledTimer::Swim(timer));
        }
        let (now, lease) = (context.now, context.heartbeat_interval() * LEASE_HEARTBEATS);
        // Before, this node received no heartbeats.
        let since = *self.leases_since.get_or_insert(now);
        let (own, state) = (&context.core.settings.node, &*context.state);
        self.answered.retain(|node, _| state.is_alive(node));
        let mut silent: Vec<NodeId> = vec![];
        for (node, stored) in state.base.iter() {
            let contact = self.answered.get(node).map_or(since, |at| since.max(*at)).max(stored.last_contact);
            let is_queried = node == own || self.queried.contains_key(node);
            if now.since(contact) > lease && !is_queried && state.is_alive(node) {
                silent.push(node.clone());
            }
        }
        for _ in 0..LEASE_QUERIES_MAX.min(silent.len()) {
            let chosen = context.core.rng.random_range(0..silent.len());
            let node = silent.swap_remove(chosen);
            let Ok(actions) = self.swim.ask(&node) else { continue };
            // An answer through another node takes two round trips.
            self.expect_answer(node, context.core.settings.token_probe_timeout() * 2, context);
            self.perform(actions, context);
        }
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
        if begins_probe(&timer) && context.leaves_detection_to_others() {
            self.parked_probe = Some(timer);
            return Ok(());
        }
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
