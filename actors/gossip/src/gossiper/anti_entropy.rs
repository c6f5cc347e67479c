//! Rounds of anti-entropy: the comparison of records with a peer.

use super::context::Context;
use super::event::Action;
use crate::exchange::ExchangeCursors;
use consort_protocol::ids::NodeId;
use consort_protocol::knowledge::{Digest, DigestScope, RecordStamp};
use consort_protocol::message::Exchange;
use rand::RngExt;
use std::collections::BTreeSet;

/// Maximum number of messages to a peer per round; the rest waits for the next round.
const MESSAGES_PER_ROUND: u32 = 4;

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

/// Comparison of this node's records with those of its peers.
#[derive(Default)]
pub(super) struct AntiEntropy {
    round: Option<Round>,
    cursors: ExchangeCursors,
    /// True if the last round completed. The next round may then find no difference, and begins
    /// with sums.
    last_round_completed: bool,
}

/// Content of a peer's message without its records, which are merged before.
pub(super) struct Comparison {
    pub(super) sums: Vec<u64>,
    pub(super) scope: DigestScope,
    pub(super) digest: Digest,
}

impl AntiEntropy {
    /// Starts a round with a peer: an owner of a missed update if any, else a random node that is
    /// alive, else a node with a token.
    pub(super) fn begin_round(&mut self, tokens: &BTreeSet<NodeId>, context: &mut Context<'_>) {
        if let Some(peer) = context.core.records.next_missing_owner(context.state) {
            return self.compare(peer, false, context);
        }
        let state = &*context.state;
        let mut peers: Vec<&NodeId> = state.status.keys().filter(|node| state.is_alive(node)).collect();
        peers.retain(|node| **node != context.core.settings.node);
        if peers.is_empty() {
            peers = tokens.iter().collect();
        }
        if peers.is_empty() {
            return;
        }
        let peer = peers[context.core.rng.random_range(0..peers.len())].clone();
        self.compare(peer, self.last_round_completed, context);
    }

    /// Starts a round, with sums or directly with the digest.
    fn compare(&mut self, peer: NodeId, by_sums: bool, context: &mut Context<'_>) {
        let number = context.core.agenda.number();
        let base = &context.state.base;
        let message = if by_sums {
            let sums = base.class_sums();
            Exchange { sums, scope: DigestScope::NONE, digest: Digest::new(), records: vec![] }
        } else {
            self.cursors.compose(DigestScope::ALL, base.digest(DigestScope::ALL), &[])
        };
        context.state.counters.requests_sent += 1;
        context.actions.push(Action::SendRequest(number, peer.clone(), message));
        self.round = Some(Round { number, peer, messages: u32::from(!by_sums), sent: BTreeSet::new() });
    }

    /// Replies to a request of a peer.
    pub(super) fn reply(&mut self, request: &Comparison, context: &mut Context<'_>) {
        let Comparison { sums, scope, digest } = request;
        context.state.counters.requests_answered += 1;
        let (records, state) = (&context.core.records, &*context.state);
        let reply = if sums.is_empty() {
            let own_digest = records.digest_for(state, *scope, digest);
            self.cursors.compose(*scope, own_digest, &records.missing_records(state, *scope, digest))
        } else {
            // The scope of the difference. The peer requests what it lacks in its next message.
            let scope = DigestScope::of_difference(&state.base.class_sums_like(sums), sums);
            self.cursors.compose(scope, state.base.digest(scope), &[])
        };
        context.actions.push(Action::SendReply(reply));
    }

    /// Continues a round after the reply of the peer. `any_new` is true if the reply contained new
    /// records.
    pub(super) fn continue_round(&mut self, number: u64, reply: &Comparison, any_new: bool, context: &mut Context<'_>) {
        let Some(mut round) = self.round.take_if(|round| round.number == number) else { return };
        self.last_round_completed = true;
        let state = &*context.state;
        let mut missing = context.core.records.missing_records(state, reply.scope, &reply.digest);
        missing.retain(|record| !round.sent.contains(&(record.owner.clone(), record.stamp)));
        // The reply to sums contains no records. Later, a reply without new records is the peer's
        // last.
        let expects_more = (any_new || round.messages == 0) && !state.base.outdated_owners(&reply.digest).is_empty();
        if round.messages < MESSAGES_PER_ROUND && (!missing.is_empty() || expects_more) {
            round.messages += 1;
            let message = self.cursors.compose(reply.scope, state.base.digest(reply.scope), &missing);
            round.sent.extend(message.records.iter().map(|record| (record.owner.clone(), record.stamp)));
            context.state.counters.requests_sent += 1;
            context.actions.push(Action::SendRequest(number, round.peer.clone(), message));
            self.round = Some(round);
        }
    }

    /// Ends a round without a reply.
    pub(super) fn end_round(&mut self, number: u64) {
        if self.round.take_if(|round| round.number == number).is_some() {
            self.last_round_completed = false;
        }
    }
}
