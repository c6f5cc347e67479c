//! Who founds the ledger, and with whom: [`Promise`] decides, and this carries it out.

use super::VOTERS_MAX;
use super::bootstrap_promise::{BootstrapPromise, ObservedFleet};
use crate::bus::{Query, SharedBus, Stream};
use crate::cluster_membership::ClusterMembership;
use crate::gossip::SharedKnowledge;
use crate::raft::{RaftId, Replica};
use crate::reply;
use bytes::Bytes;
use consort_protocol::codec;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::ledger::Ledger;
use consort_protocol::message::{BootstrapReply, BootstrapRequest};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;
use tracing::{debug, info, warn};

/// How long a node listens, from its start, before it founds anything. A fleet that is there already is heard of within
/// one exchange of gossip, some milliseconds after the first link is up.
const LISTEN: Duration = Duration::from_millis(600);

/// A promise to let somebody else found holds for so many times the time that its question may take: it founds when that
/// has passed, at the latest, and soon afterwards all know. A guess.
const PROMISE_HOLDS: u32 = 3;

/// What it takes to found a ledger, or to leave that to others.
pub(crate) struct Bootstrap {
    /// This node, as one that could.
    pub(crate) me: BootstrapRequest,
    pub(crate) keys: Keys,
    pub(crate) bus: SharedBus,
    pub(crate) replica: Replica<Ledger>,
    pub(crate) knowledge: SharedKnowledge,
    pub(crate) membership: ClusterMembership,
    /// Nodes that may vote and must have met, and agree.
    pub(crate) expected_nodes: usize,
    /// Voters aimed at.
    pub(crate) target_voters: usize,
    /// How long a node that does not answer is waited for.
    pub(crate) reply_timeout: Duration,
}

impl Bootstrap {
    /// Founds the ledger if that is this node's turn, and answers all others that would.
    ///
    /// Once `expect` nodes that may vote have met, they are to keep the ledger: up to `target` of them, an odd number, stationary
    /// and mains-powered ones before others. It is the turn of the first of these by name, who asks all that it can reach, and
    /// founds the ledger. Nobody founds who has heard of a
    /// cluster of this fleet's name, however little is left of it: its ledger may hold promises. The autopilot of that
    /// cluster takes newcomers in.
    pub(crate) async fn run(self, asked: Stream<Query>) {
        let promise = Mutex::new(BootstrapPromise::new(self.me.clone(), self.reply_timeout * PROMISE_HOLDS));
        tokio::join!(self.answer_all(&promise, asked), self.found_in_turn(&promise));
    }

    async fn answer_all(&self, promise: &Mutex<BootstrapPromise>, mut asked: Stream<Query>) {
        let key = self.keys.write(&Key::Bootstrap(self.me.node.clone()));
        while let Some(query) = asked.recv().await {
            let Some(founder) = reply::decode_or_refuse::<BootstrapRequest>(&query).await else { continue };
            let said = lock(promise).reply(&founder, &self.heard(), Instant::now());
            reply::wire(&query, &key, &said).await;
        }
    }

    async fn found_in_turn(&self, promise: &Mutex<BootstrapPromise>) {
        let node = &self.me.node;
        let listens_until = Instant::now() + LISTEN;
        let mut changed = self.knowledge.changes();
        loop {
            let heard = self.heard();
            if heard.has_voters {
                return; // somebody has founded it
            }
            let enough = self.met().len() >= self.expected_nodes.max(1);
            let now = Instant::now();
            if now >= listens_until && enough && lock(promise).begin_request(&heard, now) {
                match self.all_agree().await {
                    Ok(()) if lock(promise).confirm(&self.heard(), Instant::now()) => {
                        let met = self.met();
                        let voters = first_voters(met.keys().cloned().collect(), self.target_voters);
                        let voters: BTreeMap<_, _> = voters.map(|voter| (met[&voter], voter.node)).collect();
                        info!(%node, voters = voters.len(), "founds the ledger");
                        if let Err(problem) = self.replica.bootstrap(voters).await {
                            warn!(%node, %problem, "did not found the ledger");
                        }
                        return;
                    }
                    Ok(()) => debug!(%node, "founds nothing: it has given way"),
                    Err(reason) => debug!(%node, reason, "founds nothing"),
                }
                tokio::time::sleep(self.reply_timeout).await;
                continue;
            }
            // A cluster may be forgotten without anybody's saying so, and a promise end.
            let wait = if now < listens_until { listens_until - now } else { self.reply_timeout * PROMISE_HOLDS };
            if let Ok(Err(_)) = tokio::time::timeout(wait, changed.changed()).await {
                return;
            }
        }
    }

    /// Asks all that can be reached, met or not, whether this node may found the ledger.
    async fn all_agree(&self) -> Result<(), String> {
        let asked = codec::encode(&self.me).map_err(|problem| problem.to_string())?;
        let replies = self.bus.query(&self.keys.any_bootstrap(), Bytes::from(asked), self.reply_timeout).await;
        let mut replies = replies.map_err(|problem| problem.to_string())?;
        let mut agreed = BTreeSet::from([self.me.node.clone()]);
        while let Some(reply) = replies.recv().await {
            let said = reply.payload.ok().and_then(|payload| codec::decode(&payload).ok());
            match (self.keys.read(&reply.key), said) {
                (Some(Key::Bootstrap(node)), Some(BootstrapReply::Agreed)) => drop(agreed.insert(node)),
                (Some(Key::Bootstrap(node)), Some(BootstrapReply::Refused { reason })) => {
                    return Err(format!("{node} says: {reason}"));
                }
                (key, said) => debug!(?key, ?said, "no answer to who may found"),
            }
        }
        match agreed.len() >= self.expected_nodes {
            true => Ok(()),
            false => Err(format!("{} of {} expected have agreed", agreed.len(), self.expected_nodes)),
        }
    }

    fn heard(&self) -> ObservedFleet {
        let told = self.knowledge.read(|base| base.iter().find_map(|(_, heard)| heard.record.knowledge.cluster));
        let met = self.met().into_keys().collect();
        ObservedFleet {
            cluster: self.membership.cluster().or(told),
            has_voters: !self.replica.leadership().borrow().voters.is_empty(),
            next_founder: first_voters(met, self.target_voters).map(|voter| voter.node).min(),
        }
    }

    /// All that could found a ledger, with the numbers under which they would vote.
    fn met(&self) -> BTreeMap<BootstrapRequest, RaftId> {
        let mut met: BTreeMap<BootstrapRequest, RaftId> = self.knowledge.read(|base| {
            let candidates = base.iter().filter_map(|(node, heard)| {
                let known = &heard.record.knowledge;
                let id = known.replica.filter(|_| known.may_vote && !known.leaving)?;
                let (mobile, on_battery) = (!known.stationary, !known.mains_powered);
                Some((BootstrapRequest { mobile, on_battery, node: node.clone() }, RaftId(id)))
            });
            candidates.collect()
        });
        met.retain(|founder, _| self.knowledge.is_alive(&founder.node));
        met
    }
}

fn lock(promise: &Mutex<BootstrapPromise>) -> MutexGuard<'_, BootstrapPromise> {
    promise.lock().unwrap_or_else(PoisonError::into_inner)
}

/// An odd number of these, the best placed.
fn first_voters(met: BTreeSet<BootstrapRequest>, target: usize) -> impl Iterator<Item = BootstrapRequest> {
    let count = met.len().min(target.clamp(1, VOTERS_MAX));
    let odd = if count.is_multiple_of(2) { count.saturating_sub(1) } else { count };
    met.into_iter().take(odd)
}
