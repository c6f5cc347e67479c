//! Who founds the ledger, and with whom: [`Promise`] decides, and this carries it out.

use super::VOTERS_MAX;
use super::founding::{Heard, Promise};
use crate::allegiance::Allegiance;
use crate::answer;
use crate::bus::{Query, SharedBus, Stream};
use crate::gossip::SharedKnowledge;
use crate::replica::{RaftId, Replica};
use bytes::Bytes;
use consort_protocol::codec;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::ledger::Ledger;
use consort_protocol::message::{Founder, FoundingAnswer};
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
    pub(crate) me: Founder,
    pub(crate) keys: Keys,
    pub(crate) bus: SharedBus,
    pub(crate) replica: Replica<Ledger>,
    pub(crate) knowledge: SharedKnowledge,
    pub(crate) allegiance: Allegiance,
    /// Nodes that may vote and must have met, and agree.
    pub(crate) expect: usize,
    /// Voters aimed at.
    pub(crate) target: usize,
    /// How long a node that does not answer is waited for.
    pub(crate) answers_within: Duration,
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
        let promise = Mutex::new(Promise::new(self.me.clone(), self.answers_within * PROMISE_HOLDS));
        tokio::join!(self.answer_all(&promise, asked), self.found_in_turn(&promise));
    }

    async fn answer_all(&self, promise: &Mutex<Promise>, mut asked: Stream<Query>) {
        let key = self.keys.write(&Key::Found(self.me.node.clone()));
        while let Some(query) = asked.recv().await {
            let Some(founder) = answer::read::<Founder>(&query).await else { continue };
            let said = lock(promise).answer(&founder, &self.heard(), Instant::now());
            answer::wire(&query, &key, &said).await;
        }
    }

    async fn found_in_turn(&self, promise: &Mutex<Promise>) {
        let node = &self.me.node;
        let listens_until = Instant::now() + LISTEN;
        let mut changed = self.knowledge.changed();
        loop {
            let heard = self.heard();
            if heard.keeps_ledger {
                return; // somebody has founded it
            }
            let enough = self.met().len() >= self.expect.max(1);
            let now = Instant::now();
            if now >= listens_until && enough && lock(promise).stand(&heard, now) {
                match self.all_agree().await {
                    Ok(()) if lock(promise).found(&self.heard(), Instant::now()) => {
                        let met = self.met();
                        let voters = first_voters(met.keys().cloned().collect(), self.target);
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
                tokio::time::sleep(self.answers_within).await;
                continue;
            }
            // A cluster may be forgotten without anybody's saying so, and a promise end.
            let wait = if now < listens_until { listens_until - now } else { self.answers_within * PROMISE_HOLDS };
            if let Ok(Err(_)) = tokio::time::timeout(wait, changed.changed()).await {
                return;
            }
        }
    }

    /// Asks all that can be reached, met or not, whether this node may found the ledger.
    async fn all_agree(&self) -> Result<(), String> {
        let asked = codec::encode(&self.me).map_err(|problem| problem.to_string())?;
        let replies = self.bus.query(&self.keys.any_found(), Bytes::from(asked), self.answers_within).await;
        let mut replies = replies.map_err(|problem| problem.to_string())?;
        let mut agreed = BTreeSet::from([self.me.node.clone()]);
        while let Some(reply) = replies.recv().await {
            let said = reply.payload.ok().and_then(|payload| codec::decode(&payload).ok());
            match (self.keys.read(&reply.key), said) {
                (Some(Key::Found(node)), Some(FoundingAnswer::Agreed)) => drop(agreed.insert(node)),
                (Some(Key::Found(node)), Some(FoundingAnswer::Refused { reason })) => {
                    return Err(format!("{node} says: {reason}"));
                }
                (key, said) => debug!(?key, ?said, "no answer to who may found"),
            }
        }
        match agreed.len() >= self.expect {
            true => Ok(()),
            false => Err(format!("{} of {} expected have agreed", agreed.len(), self.expect)),
        }
    }

    fn heard(&self) -> Heard {
        let told = self.knowledge.read(|base| base.iter().find_map(|(_, heard)| heard.record.knowledge.cluster));
        let met = self.met().into_keys().collect();
        Heard {
            cluster: self.allegiance.cluster().or(told),
            keeps_ledger: !self.replica.leadership().borrow().voters.is_empty(),
            turn: first_voters(met, self.target).map(|voter| voter.node).min(),
        }
    }

    /// All that could found a ledger, with the numbers under which they would vote.
    fn met(&self) -> BTreeMap<Founder, RaftId> {
        let mut met: BTreeMap<Founder, RaftId> = self.knowledge.read(|base| {
            let candidates = base.iter().filter_map(|(node, heard)| {
                let known = &heard.record.knowledge;
                let id = known.replica.filter(|_| known.may_vote && !known.leaving)?;
                let (mobile, on_battery) = (!known.stationary, !known.mains_powered);
                Some((Founder { mobile, on_battery, node: node.clone() }, RaftId(id)))
            });
            candidates.collect()
        });
        met.retain(|founder, _| self.knowledge.alive(&founder.node));
        met
    }
}

fn lock(promise: &Mutex<Promise>) -> MutexGuard<'_, Promise> {
    promise.lock().unwrap_or_else(PoisonError::into_inner)
}

/// An odd number of these, the best placed.
fn first_voters(met: BTreeSet<Founder>, target: usize) -> impl Iterator<Item = Founder> {
    let count = met.len().min(target.clamp(1, VOTERS_MAX));
    let odd = if count.is_multiple_of(2) { count.saturating_sub(1) } else { count };
    met.into_iter().take(odd)
}
