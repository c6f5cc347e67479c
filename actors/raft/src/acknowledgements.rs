//! Acknowledgements of a leader by its voters, and the last contact with each voter.

use super::types::{RaftId, Vote};
use consort_bus::BootInstant;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, PoisonError};

/// Acknowledgements of a leader: send time of the last acknowledged request, by voter.
#[derive(Debug, Clone, Default)]
pub(super) struct LeaderAcks {
    vote: Option<Vote>,
    sent: BTreeMap<RaftId, BootInstant>,
}

impl LeaderAcks {
    /// Records an acknowledgement. One for an earlier vote of this node is late, and of no use.
    pub(super) fn record(&mut self, vote: Vote, voter: RaftId, sent_at: BootInstant) {
        if self.vote.is_some_and(|present| vote.leader_id().term < present.leader_id().term) {
            return;
        }
        if self.vote != Some(vote) {
            *self = LeaderAcks { vote: Some(vote), sent: BTreeMap::new() };
        }
        let last = self.sent.entry(voter).or_insert(sent_at);
        *last = sent_at.max(*last);
    }

    /// Returns the send time of the newest request that a majority of each of `halves` has
    /// acknowledged for the leader `vote`. `me` counts as part of the majority.
    pub(super) fn quorum_ack(&self, vote: &Vote, me: RaftId, halves: &[BTreeSet<RaftId>]) -> Option<BootInstant> {
        let is_current = self.vote.as_ref() == Some(vote);
        let now = BootInstant::now();
        let of_half = |half: &BTreeSet<RaftId>| {
            let sent = |voter: &RaftId| match *voter == me {
                true => Some(now),
                false => self.sent.get(voter).filter(|_| is_current).copied(),
            };
            let mut sent: Vec<BootInstant> = half.iter().filter_map(sent).collect();
            sent.sort_unstable_by(|a, b| b.cmp(a));
            sent.get(half.len() / 2).copied()
        };
        halves.iter().map(of_half).min().flatten()
    }
}

/// Last contact with each voter, as the send time of the last request that it replied to. The age
/// of the quorum's acknowledgement is measured in the same way.
#[derive(Debug, Default)]
pub(super) struct LastContacts(Mutex<BTreeMap<RaftId, BootInstant>>);

impl LastContacts {
    pub(super) fn record(&self, voter: RaftId, sent_at: BootInstant) {
        let mut contacts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let last = contacts.entry(voter).or_insert(sent_at);
        *last = sent_at.max(*last);
    }

    /// Returns the send time of the last request that `voter` has replied to.
    pub(super) fn of(&self, voter: RaftId) -> Option<BootInstant> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get(&voter).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_acknowledgement_of_an_earlier_vote_removes_no_later_ones() {
        let [me, voter] = [RaftId(1), RaftId(2)];
        let [earlier, present] = [5, 7].map(|term| Vote::new_committed(term, me));
        let halves = [BTreeSet::from([me, voter, RaftId(3)])];
        let sent_at = BootInstant::now();
        let mut acks = LeaderAcks::default();
        acks.record(earlier, voter, sent_at);
        acks.record(present, voter, sent_at);
        acks.record(earlier, voter, sent_at);
        assert_eq!(acks.quorum_ack(&present, me, &halves), Some(sent_at));
        assert_eq!(acks.quorum_ack(&earlier, me, &halves), None);
    }
}
