//! What clients are told while nobody coordinates: at once, and by one voice.
//!
//! Every node that keeps the ledger hears requests. While it knows of a live coordinator it leaves them to that one. Else
//! the first by name of the live voters (of the nodes that may vote, before there are any) says that the request should be
//! made again; the others stay silent. Nodes that have heard differently may for a moment both speak, or neither: both does
//! no harm, and neither is answered by the end of the question.

use crate::gossip::SharedKnowledge;
use crate::replica::Leadership;
use consort_protocol::ids::NodeId;
use serde_json::{Value, json};
use std::collections::BTreeSet;

/// After how many milliseconds a request may be made again: about what a takeover takes.
pub(super) const RETRY_AFTER_MS: u64 = 300;

/// What this node says to a request; nothing if it is for another to answer.
pub(super) fn nobody_yet(node: &NodeId, leadership: &Leadership, knowledge: &SharedKnowledge) -> Option<Value> {
    let other = leadership.leader.as_ref().filter(|leader| *leader != node);
    if leadership.reign.is_some() && other.is_some_and(|leader| knowledge.alive(leader)) {
        return None;
    }
    let alive = |voter: &NodeId| voter == node || knowledge.alive(voter);
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
    let error = format!("no coordinator yet{quorum}: retry after {RETRY_AFTER_MS} ms");
    Some(json!({ "error": error, "retry_after_ms": RETRY_AFTER_MS }))
}
