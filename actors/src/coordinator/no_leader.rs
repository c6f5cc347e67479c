//! What clients are told while nobody coordinates: at once, and by one voice.
//!
//! Every node that may keep the ledger hears requests. While it hears a live coordinator it leaves them to that one. Else the
//! first by name of the live voters says that the request should be made again; the others stay silent. Before the ledger is
//! founded, that is the first of the live nodes that may vote; a node that has ever heard a coordinator knows that it is
//! founded, and that it is for the voters to speak. Nodes that have heard differently may for a moment both speak, or
//! neither: both does no harm, and neither is answered by the end of the question.

use crate::gossip::SharedKnowledge;
use crate::raft::LeadershipView;
use consort_protocol::ids::NodeId;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::time::Duration;

/// After how many milliseconds a request may be made again: about what a takeover takes.
pub(super) const RETRY_AFTER_MS: u64 = 300;

/// A coordinator that says nothing for so long is taken for gone: a little more than two of its beats. The ledger's voters
/// know sooner.
const SILENT: Duration = Duration::from_millis(500);

/// What this node says to a request; nothing if it is for another to answer. `heard` is the last beacon of another node, and
/// how long ago it was heard.
pub(super) fn no_leader_reply(
    node: &NodeId,
    leadership: &LeadershipView,
    knowledge: &SharedKnowledge,
    heard: Option<(&NodeId, Duration)>,
) -> Option<Value> {
    let speaks = |(other, ago): &(&NodeId, Duration)| *ago < SILENT && knowledge.is_alive(other);
    let voters_are_known = !leadership.voters.is_empty();
    if heard.as_ref().is_some_and(speaks) || (heard.is_some() && !voters_are_known) {
        return None;
    }
    let other = leadership.leader.as_ref().filter(|leader| *leader != node);
    let deposed = heard.is_some_and(|(_, ago)| ago >= SILENT);
    if !deposed && leadership.leader_id.is_some() && other.is_some_and(|leader| knowledge.is_alive(leader)) {
        return None;
    }
    let alive = |voter: &NodeId| voter == node || knowledge.is_alive(voter);
    let voters: BTreeSet<NodeId> = leadership.voters.values().cloned().collect();
    let speakers = match voters.is_empty() {
        true => knowledge.read(|base| {
            let may_vote = base.iter().filter(|(_, heard)| heard.record.knowledge.may_vote);
            may_vote.map(|(node, _)| node.clone()).collect()
        }),
        false => voters.clone(),
    };
    if speakers.iter().filter(|speaker| alive(speaker)).min() != Some(node) {
        return None;
    }
    let reachable = voters.iter().filter(|voter| alive(voter)).count();
    let quorum = match reachable > voters.len() / 2 || voters.is_empty() {
        true => String::new(),
        false => format!(" (no quorum: {reachable} of {} voters reachable)", voters.len()),
    };
    Some(retry_reply(quorum))
}

/// Asks a client to ask again.
pub(super) fn retry_reply(quorum: String) -> Value {
    let error = format!("no coordinator yet{quorum}: retry after {RETRY_AFTER_MS} ms");
    busy_reply(&error, Duration::from_millis(RETRY_AFTER_MS))
}

/// Asks a client to ask again after some time, and says why.
pub(super) fn busy_reply(error: &str, after: Duration) -> Value {
    json!({ "error": error, "retry_after_ms": u64::try_from(after.as_millis()).unwrap_or(u64::MAX).max(1) })
}
