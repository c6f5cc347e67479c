//! Replies to clients while there is no leader: at once, and from a single node.
//!
//! Every voter receives requests. While it receives beacons of a live coordinator, it leaves
//! requests to that coordinator. Otherwise the first live voter by name replies that the client
//! should retry; the other nodes send no reply. Before the ledger is founded, every node that may
//! vote receives requests, and the first live one replies instead. A node that has ever received a
//! beacon concludes that the ledger is founded and that the reply is up to the voters. Nodes with
//! different information may for a moment both reply, or neither: two replies do no harm, and
//! without a reply the query times out.

use consort_gossip::SharedKnowledge;
use consort_protocol::api::ErrorReply;
use consort_protocol::ids::NodeId;
use consort_raft::LeadershipView;
use std::collections::BTreeSet;
use std::time::Duration;

/// Suggested delay of a retry in milliseconds: about the duration of a takeover after the loss of a
/// machine. A process that has ended is replaced sooner.
pub(super) const RETRY_AFTER_MS: u64 = 300;

/// Timeout of a coordinator without beacons: a little more than 2 beacon intervals. The ledger's
/// voters detect the failure sooner.
const BEACON_TIMEOUT: Duration = Duration::from_millis(500);

/// Checks whether a reply to a request may be up to this node: as the coordinator, or by
/// [`no_leader_reply`]. The other nodes need not receive requests, which would wake every robot of a
/// large fleet. `has_beacon` is true if the node has ever received the beacon of another coordinator.
pub(super) fn may_reply(node: &NodeId, leadership: &LeadershipView, has_beacon: bool) -> bool {
    let votes = leadership.voters.values().any(|voter| voter == node);
    leadership.is_leader || votes || (leadership.voters.is_empty() && !has_beacon)
}

/// Returns this node's reply to a request, or `None` if the reply is up to another node.
/// `last_beacon` contains the last other coordinator and the age of its beacon.
pub(super) fn no_leader_reply(
    node: &NodeId,
    leadership: &LeadershipView,
    knowledge: &SharedKnowledge,
    last_beacon: Option<(&NodeId, Duration)>,
) -> Option<ErrorReply> {
    let is_active = |(other, age): &(&NodeId, Duration)| *age < BEACON_TIMEOUT && knowledge.is_alive(other);
    let voters_are_known = !leadership.voters.is_empty();
    if last_beacon.as_ref().is_some_and(is_active) || (last_beacon.is_some() && !voters_are_known) {
        return None;
    }
    let other = leadership.leader.as_ref().filter(|leader| *leader != node);
    let deposed = last_beacon.is_some_and(|(_, age)| age >= BEACON_TIMEOUT);
    if !deposed && leadership.leader_id.is_some() && other.is_some_and(|leader| knowledge.is_alive(leader)) {
        return None;
    }
    let alive = |voter: &NodeId| voter == node || knowledge.is_alive(voter);
    let voters: BTreeSet<NodeId> = leadership.voters.values().cloned().collect();
    let repliers = match voters.is_empty() {
        true => knowledge.read(|base| {
            let may_vote = base.iter().filter(|(_, stored)| stored.record.knowledge.may_vote);
            may_vote.map(|(node, _)| node.clone()).collect()
        }),
        false => voters.clone(),
    };
    if repliers.iter().filter(|replier| alive(replier)).min() != Some(node) {
        return None;
    }
    let reachable = voters.iter().filter(|voter| alive(voter)).count();
    let quorum = match reachable > voters.len() / 2 || voters.is_empty() {
        true => String::new(),
        false => format!(" (no quorum: {reachable} of {} voters reachable)", voters.len()),
    };
    Some(retry_reply(quorum))
}

/// Returns a reply that asks the client to retry.
pub(super) fn retry_reply(quorum: String) -> ErrorReply {
    let error = format!("no coordinator yet{quorum}: retry after {RETRY_AFTER_MS} ms");
    busy_reply(&error, Duration::from_millis(RETRY_AFTER_MS))
}

/// Returns an error with a retry delay.
pub(super) fn busy_reply(error: &str, after: Duration) -> ErrorReply {
    ErrorReply::retry_after(error, u64::try_from(after.as_millis()).unwrap_or(u64::MAX).max(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_raft::RaftId;

    #[test]
    fn only_voters_reply_once_there_is_a_ledger() {
        let [ada, bob] = ["ada", "bob"].map(|name| NodeId::new(name).unwrap());
        let unknown = LeadershipView::default();
        let voters = [(RaftId(1), ada.clone())].into();
        let known = LeadershipView { voters, ..LeadershipView::default() };
        assert!(may_reply(&bob, &unknown, false), "no ledger yet");
        assert!(!may_reply(&bob, &unknown, true), "a ledger of others");
        for has_beacon in [false, true] {
            assert!(may_reply(&ada, &known, has_beacon));
            assert!(!may_reply(&bob, &known, has_beacon));
            let leaving = LeadershipView { is_leader: true, ..known.clone() };
            assert!(may_reply(&bob, &leaving, has_beacon), "a leader that is no longer a voter");
        }
    }
}
