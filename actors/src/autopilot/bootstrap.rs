//! Who founds the ledger, and with whom.

use super::VOTERS_MAX;
use crate::gossip::SharedKnowledge;
use crate::replica::{RaftId, Replica};
use consort_protocol::ids::NodeId;
use consort_protocol::ledger::Ledger;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tokio::time::Instant;
use tracing::{debug, info, warn};

/// How long a node listens, from its start, before it founds anything. A fleet that is there already is heard of within
/// one exchange of gossip, some milliseconds after the first link is up.
const LISTEN: Duration = Duration::from_millis(600);

/// Founds the ledger once `expect` nodes that may vote have met: the first of them by name does it, with up to `target`
/// voters, an odd number, stationary and mains-powered ones before others.
///
/// Nobody founds who has heard of a cluster of this fleet's name, however little is left of it: its ledger may hold
/// promises. The autopilot of that cluster takes newcomers in.
pub(crate) async fn bootstrap(
    node: NodeId,
    replica: Replica<Ledger>,
    knowledge: SharedKnowledge,
    expect: usize,
    target: usize,
) {
    let listens_until = Instant::now() + LISTEN;
    let mut changed = knowledge.changed();
    let mut warned = false;
    loop {
        if !replica.leadership().borrow().voters.is_empty() {
            return; // somebody has
        }
        let heard_of = knowledge.read(|base| base.iter().find_map(|(_, heard)| heard.record.knowledge.cluster));
        if let Some(cluster) = heard_of.filter(|_| !warned) {
            debug!(%node, %cluster, "founds nothing: there is a cluster of this name");
            warned = true;
        }
        let voters = first_voters(&knowledge, expect, target);
        let now = Instant::now();
        if heard_of.is_none() && now >= listens_until && voters.values().min() == Some(&node) {
            info!(%node, voters = voters.len(), "founds the ledger");
            if let Err(problem) = replica.bootstrap(voters).await {
                warn!(%node, %problem, "did not found the ledger");
            }
            return;
        }
        // A cluster may be forgotten without anybody's saying so.
        let wait = if now < listens_until { listens_until - now } else { Duration::from_secs(5) };
        if let Ok(Err(_)) = tokio::time::timeout(wait, changed.changed()).await {
            return;
        }
    }
}

fn first_voters(knowledge: &SharedKnowledge, expect: usize, target: usize) -> BTreeMap<RaftId, NodeId> {
    let met: Vec<(bool, bool, NodeId, RaftId)> = knowledge.read(|base| {
        let candidates = base.iter().filter_map(|(node, heard)| {
            let known = &heard.record.knowledge;
            let id = known.replica.filter(|_| known.may_vote && !known.leaving)?;
            Some((!known.stationary, !known.mains_powered, node.clone(), RaftId(id)))
        });
        candidates.collect()
    });
    let mut met: BTreeSet<_> = met.into_iter().filter(|(_, _, node, _)| knowledge.alive(node)).collect();
    if met.len() < expect.max(1) {
        return BTreeMap::new();
    }
    let odd = |count: usize| if count.is_multiple_of(2) { count - 1 } else { count };
    let count = odd(met.len().min(target.clamp(1, VOTERS_MAX)));
    let mut voters = BTreeMap::new();
    while voters.len() < count {
        let Some((_, _, node, id)) = met.pop_first() else { break };
        voters.insert(id, node);
    }
    voters
}
