//! Decisions of gossip as a state machine: it takes [`Event`]s and returns [`Action`]s, and never
//! blocks.
//!
//! An event is handled in a [`Context`]: the shared state, the time, and the collected actions.
//! [`Membership`] detects failures, [`reception`] merges records, and [`AntiEntropy`] compares them
//! with peers.

mod agenda;
mod anti_entropy;
mod context;
mod event;
mod membership;
mod reception;
#[cfg(test)]
mod tests;

pub(crate) use event::{Action, Change, Event, GossipError};

use crate::record_store::RecordStore;
use crate::settings::Settings;
use crate::shared::{GossipState, MemberStatus};
use agenda::{Agenda, ScheduledTimer};
use anti_entropy::{AntiEntropy, Comparison};
use consort_bus::record_signer::SharedRecordSigner;
use consort_protocol::knowledge::{Knowledge, Record, RecordStamp};
use consort_protocol::message::Exchange;
use consort_protocol::units::NodeTime;
use context::{Context, Core};
use membership::Membership;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;

/// State machine of a node's gossip.
pub(crate) struct Gossiper {
    core: Core,
    membership: Membership,
    anti_entropy: AntiEntropy,
}

/// Initial values of a gossiper.
pub(crate) struct GossiperStart {
    pub(crate) settings: Settings,
    /// Knowledge to publish.
    pub(crate) knowledge: Knowledge,
    /// Signer of the own record, if the fleet has certificates.
    pub(crate) signer: Option<SharedRecordSigner>,
    pub(crate) rng: ChaCha8Rng,
}

impl Gossiper {
    /// Creates the state machine and returns the first actions.
    pub(crate) fn new(start: GossiperStart, state: &mut GossipState, now: NodeTime) -> (Gossiper, Vec<Action>) {
        let GossiperStart { settings, knowledge, signer, mut rng } = start;
        // Nodes that were alive for an earlier actor must be contacted again.
        state.status = BTreeMap::from([(settings.node.clone(), MemberStatus::Alive { since: now })]);
        let stamp = RecordStamp { incarnation: settings.incarnation, version: 0 };
        let own = Record { owner: settings.node.clone(), stamp, knowledge, proof: None };
        let records = RecordStore::new(own, signer, state, now);
        let membership = Membership::new(&settings, ChaCha8Rng::from_rng(&mut rng));
        let mut core = Core {
            settings,
            records,
            agenda: Agenda::default(),
            rng,
            full_record_until: now,
            last_published: now,
            changed: true,
        };
        // Nodes that start together must not stay synchronized.
        let (heartbeat, round) = (core.settings.heartbeat, core.settings.round);
        let (heartbeat, round) = (core.random_up_to(heartbeat), core.random_up_to(round));
        let mut context = Context::new(&mut core, state, now);
        context.set_timer(heartbeat, ScheduledTimer::Heartbeat);
        context.set_timer(round, ScheduledTimer::Round);
        context.publish();
        let first = context.actions;
        (Gossiper { core, membership, anti_entropy: AntiEntropy::default() }, first)
    }

    /// Returns the time of the next timer.
    pub(crate) fn next_due(&self) -> Option<NodeTime> {
        self.core.agenda.next_due()
    }

    /// Returns and clears the flag that readable state has changed.
    pub(crate) fn take_changed(&mut self) -> bool {
        std::mem::take(&mut self.core.changed)
    }

    /// Handles an event. An error is the reason why a message is invalid; the message has changed
    /// nothing.
    pub(crate) fn handle(
        &mut self,
        event: Event,
        state: &mut GossipState,
        now: NodeTime,
    ) -> Result<Vec<Action>, GossipError> {
        let Gossiper { core, membership, anti_entropy } = self;
        let context = &mut Context::new(core, state, now);
        match event {
            Event::KnowledgeChanged(change) => change_knowledge(change, context)?,
            Event::MotionChanged(motion) => context.move_robot(motion),
            Event::MotionPublished(owner, update) => reception::receive_motion(owner, &update, membership, context)?,
            Event::Published(owner, update) => reception::receive_update(owner, update, membership, context)?,
            Event::Packet(bytes) => membership.receive_packet(&bytes, context)?,
            Event::Token(node, _) if node == context.core.settings.node => {}
            Event::Token(node, true) => membership.token_appeared(node, context),
            Event::Token(node, false) => membership.token_vanished(node, context)?,
            Event::RequestReceived(Exchange { sums, scope, digest, records }) => {
                reception::merge_records(records, &digest, membership, context)?;
                anti_entropy.reply(&Comparison { sums, scope, digest }, context);
            }
            Event::ReplyReceived(number, Some(Exchange { sums, scope, digest, records })) => {
                let any_new = reception::merge_records(records, &digest, membership, context)?;
                anti_entropy.continue_round(number, &Comparison { sums, scope, digest }, any_new, context);
            }
            Event::ReplyReceived(number, None) => anti_entropy.end_round(number),
            Event::TimerFired => {
                while let Some(timer) = context.core.agenda.take_due(now) {
                    fire_timer(timer, membership, anti_entropy, context)?;
                }
            }
            Event::VersionRaised => raise_version(context),
        }
        Ok(std::mem::take(&mut context.actions))
    }

    /// Announces that the node leaves.
    pub(crate) fn leave(&mut self) -> Vec<Action> {
        self.membership.leave()
    }
}

fn change_knowledge(change: Change, context: &mut Context<'_>) -> Result<(), GossipError> {
    if context.core.records.update(change, context.state, context.now)? {
        context.core.changed = true;
        context.publish();
    }
    Ok(())
}

fn raise_version(context: &mut Context<'_>) {
    context.core.records.republish(context.state, context.now);
    context.publish();
}

fn fire_timer(
    timer: ScheduledTimer,
    membership: &mut Membership,
    anti_entropy: &mut AntiEntropy,
    context: &mut Context<'_>,
) -> Result<(), GossipError> {
    match timer {
        ScheduledTimer::Heartbeat => context.heartbeat(),
        ScheduledTimer::Round => {
            let forget_after = context.core.settings.forget_after;
            context.core.changed |= context.core.records.remove_absent(forget_after, context.state, context.now);
            membership.announce_to_absent(context);
            membership.check_leases(context);
            anti_entropy.begin_round(membership.tokens(), context);
            context.set_timer_jittered(context.core.settings.round, ScheduledTimer::Round);
        }
        ScheduledTimer::Announce => membership.send_announcements(context)?,
        ScheduledTimer::Swim(timer) => membership.fire_timer(timer, context)?,
        ScheduledTimer::QueryTimeout(node, number) => membership.handle_query_timeout(node, number, context)?,
        ScheduledTimer::SuspicionTimeout(suspicion, node, number) => {
            membership.handle_suspicion_timeout(&suspicion, &node, number, context)?;
        }
    }
    Ok(())
}
