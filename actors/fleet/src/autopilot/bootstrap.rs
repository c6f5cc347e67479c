//! Bootstrap of the cluster: selects the first voters. [`BootstrapPromise`] decides, and this
//! module performs the I/O.

use super::bootstrap_promise::{BootstrapPromise, ObservedFleet};
use bytes::Bytes;
use consort_bus::cluster_membership::ClusterMembership;
use consort_bus::{BusError, Query, SharedBus, Stream, reply};
use consort_gossip::SharedKnowledge;
use consort_protocol::codec::{self, CodecError};
use consort_protocol::ids::{ClusterId, NodeId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::ledger::Ledger;
use consort_protocol::message::{BootstrapReply, BootstrapRequest};
use consort_raft::{RaftId, Replica};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;
use tracing::{debug, info, warn};

/// Greatest number of voters: more voters slow down every commit and add little fault tolerance.
pub const VOTERS_MAX: usize = 9;

/// Default target number of voters: two of five may fail at the same time.
pub const VOTERS: usize = 5;

/// Time from its start for which a node only listens, before it bootstraps a cluster. It learns of
/// an existing cluster within a single exchange of gossip, some milliseconds after the first link
/// is up.
const LISTEN_TIME: Duration = Duration::from_millis(600);

/// Duration of a promise to let another node bootstrap, as a multiple of the time limit of its
/// requests: that node bootstraps before this time has passed, and soon afterwards all nodes have
/// received the result. A guess.
const PROMISE_REPLY_TIMEOUTS: u32 = 3;

/// The expected nodes have not agreed to the bootstrap. The next attempt asks again.
#[derive(Debug, thiserror::Error)]
enum Disagreement {
    /// The request does not fit a message.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// The request was not sent.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Another node bootstraps the cluster, or knows of a ledger.
    #[error("{node} refused: {reason}")]
    Refused { node: NodeId, reason: String },
    /// Common at the start of a fleet: not all nodes are reachable yet.
    #[error("{agreed} of {expected} expected nodes have agreed")]
    Incomplete { agreed: usize, expected: usize },
}

/// State needed to bootstrap a cluster, or to leave the bootstrap to another node.
pub(crate) struct Bootstrap {
    /// This node as a candidate for the bootstrap.
    pub(crate) me: BootstrapRequest,
    pub(crate) keys: Keys,
    pub(crate) bus: SharedBus,
    pub(crate) replica: Replica<Ledger>,
    pub(crate) knowledge: SharedKnowledge,
    pub(crate) membership: ClusterMembership,
    /// The store of this node replaces a damaged store.
    pub(crate) replaces_damaged: bool,
    /// Number of nodes with the right to vote that must be reachable and agree.
    pub(crate) expected_nodes: usize,
    /// Target number of voters.
    pub(crate) target_voters: usize,
    /// Time limit for the replies of other nodes.
    pub(crate) reply_timeout: Duration,
}

impl Bootstrap {
    /// Bootstraps the cluster if it is this node's turn, and replies to the bootstrap requests of
    /// other nodes.
    ///
    /// The bootstrap starts once `expected_nodes` nodes with the right to vote are known. The first
    /// voters are up to `target_voters` of these nodes, an odd number, stationary and mains-powered
    /// nodes before others. It is the turn of the first of them by name. That node asks all nodes
    /// that it can reach, and then bootstraps the cluster. A node that knows of a cluster of this
    /// fleet's name never bootstraps, even if little of that cluster is left: its ledger may
    /// contain promises. The autopilot of that cluster adds new nodes. A node whose store replaces a
    /// damaged store never bootstraps either.
    pub(crate) async fn run(self, requests: Stream<Query>) {
        let promise = Mutex::new(BootstrapPromise::new(self.me.clone(), self.reply_timeout * PROMISE_REPLY_TIMEOUTS));
        tokio::join!(self.reply_to_all(&promise, requests), self.bootstrap_in_turn(&promise));
    }

    async fn reply_to_all(&self, promise: &Mutex<BootstrapPromise>, mut requests: Stream<Query>) {
        let key = self.keys.write(&Key::Bootstrap(self.me.node.clone()));
        while let Some(query) = requests.recv().await {
            let Some(request) = reply::decode_or_refuse::<BootstrapRequest>(&query).await else { continue };
            let answer = lock(promise).reply(&request, &self.observed_fleet(), Instant::now());
            reply::wire(&query, &key, &answer).await;
        }
    }

    async fn bootstrap_in_turn(&self, promise: &Mutex<BootstrapPromise>) {
        let node = &self.me.node;
        let listen_deadline = Instant::now() + LISTEN_TIME;
        let mut changed = self.knowledge.changes();
        loop {
            if self.has_voters() {
                return; // another node has bootstrapped the cluster
            }
            let now = Instant::now();
            if now >= listen_deadline && self.begins_request(promise, now) {
                match self.all_agree().await {
                    Ok(()) if lock(promise).confirm(&self.observed_fleet(), Instant::now()) => {
                        let candidates = self.candidates();
                        let voters = first_voters(candidates.keys().cloned().collect(), self.target_voters);
                        let voters: BTreeMap<_, _> = voters.map(|voter| (candidates[&voter], voter.node)).collect();
                        info!(%node, voters = voters.len(), "bootstrapping the cluster");
                        if let Err(error) = self.replica.bootstrap(voters).await {
                            warn!(%node, %error, "bootstrap failed");
                        }
                        return;
                    }
                    Ok(()) => debug!(%node, "no bootstrap: this node has given way"),
                    Err(disagreement) => debug!(%node, reason = disagreement.to_string(), "no bootstrap"),
                }
                tokio::time::sleep(self.reply_timeout).await;
                continue;
            }
            // The record of a cluster may expire without a notification, and so may a promise.
            let wait =
                if now < listen_deadline { listen_deadline - now } else { self.reply_timeout * PROMISE_REPLY_TIMEOUTS };
            if let Ok(Err(_)) = tokio::time::timeout(wait, changed.changed()).await {
                return;
            }
        }
    }

    /// Checks whether this node may ask the other nodes now. A node that knows of a cluster may not, and does not count the
    /// candidates: robots that are not voters get here with each record that changes.
    fn begins_request(&self, promise: &Mutex<BootstrapPromise>, now: Instant) -> bool {
        self.known_cluster().is_none()
            && self.candidates().len() >= self.expected_nodes.max(1)
            && lock(promise).begin_request(&self.observed_fleet(), now)
    }

    /// Asks all reachable nodes, known or not, whether this node may bootstrap the cluster.
    async fn all_agree(&self) -> Result<(), Disagreement> {
        let request = codec::encode(&self.me)?;
        let mut replies = self.bus.query(&self.keys.any_bootstrap(), Bytes::from(request), self.reply_timeout).await?;
        let mut agreed = BTreeSet::from([self.me.node.clone()]);
        while let Some(reply) = replies.recv().await {
            let answer = reply.payload.ok().and_then(|payload| codec::decode(&payload).ok());
            match (self.keys.read(&reply.key), answer) {
                (Some(Key::Bootstrap(node)), Some(BootstrapReply::Agreed)) => drop(agreed.insert(node)),
                (Some(Key::Bootstrap(node)), Some(BootstrapReply::Refused { reason })) => {
                    return Err(Disagreement::Refused { node, reason });
                }
                (key, answer) => debug!(?key, ?answer, "unexpected reply to the bootstrap request"),
            }
        }
        match (agreed.len(), self.expected_nodes) {
            (agreed, expected) if agreed >= expected => Ok(()),
            (agreed, expected) => Err(Disagreement::Incomplete { agreed, expected }),
        }
    }

    fn observed_fleet(&self) -> ObservedFleet {
        let candidates = self.candidates().into_keys().collect();
        ObservedFleet {
            cluster: self.known_cluster(),
            has_voters: self.has_voters(),
            replaces_damaged: self.replaces_damaged,
            next_founder: first_voters(candidates, self.target_voters).map(|voter| voter.node).min(),
        }
    }

    /// Checks whether the node's own replica of the ledger has voters.
    fn has_voters(&self) -> bool {
        !self.replica.leadership().borrow().voters.is_empty()
    }

    /// Returns the cluster of this node, or one that another node has stated.
    fn known_cluster(&self) -> Option<ClusterId> {
        let stated = || self.knowledge.read(|base| base.iter().find_map(|(_, entry)| entry.record.knowledge.cluster));
        self.membership.cluster().or_else(stated)
    }

    /// Returns all nodes that could bootstrap the cluster, with their raft ids.
    fn candidates(&self) -> BTreeMap<BootstrapRequest, RaftId> {
        let mut candidates: BTreeMap<BootstrapRequest, RaftId> = self.knowledge.read(|base| {
            let known_nodes = base.iter().filter_map(|(node, entry)| {
                let knowledge = &entry.record.knowledge;
                let id = knowledge.replica.filter(|_| knowledge.may_vote && !knowledge.leaving)?;
                let (mobile, on_battery) = (!knowledge.stationary, !knowledge.mains_powered);
                Some((BootstrapRequest { mobile, on_battery, node: node.clone() }, RaftId(id)))
            });
            known_nodes.collect()
        });
        candidates.retain(|request, _| self.knowledge.is_alive(&request.node));
        candidates
    }
}

fn lock(promise: &Mutex<BootstrapPromise>) -> MutexGuard<'_, BootstrapPromise> {
    promise.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns an odd number of the candidates, the most suitable first.
fn first_voters(candidates: BTreeSet<BootstrapRequest>, target: usize) -> impl Iterator<Item = BootstrapRequest> {
    let count = candidates.len().min(target.clamp(1, VOTERS_MAX));
    let odd = if count.is_multiple_of(2) { count.saturating_sub(1) } else { count };
    candidates.into_iter().take(odd)
}
