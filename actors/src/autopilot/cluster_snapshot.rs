//! What the decision sees: who keeps the ledger, who could, and for how long each of them has been there.

use super::decide::{Member, MemberHealth};
use crate::gossip::SharedKnowledge;
use crate::raft::{LeadershipView, RaftId, Replica};
use consort_protocol::ids::{ClusterId, NodeId};
use consort_protocol::knowledge::Knowledge;
use consort_protocol::ledger::Ledger;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tokio::time::Instant;

/// A voter that answers nothing counts as there for so much longer while gossip reaches it: its process may be held up
/// by its disk.
const HELD_UP: u32 = 3;

/// What is known of members at one moment.
pub(super) struct ClusterSnapshot<'a> {
    me: RaftId,
    /// A member that has answered within this time is there.
    near: Duration,
    /// How long this node has led.
    reign: Duration,
    heard: BTreeMap<RaftId, Option<Duration>>,
    lags: BTreeMap<RaftId, Option<u64>>,
    /// What nodes say of themselves.
    known: BTreeMap<NodeId, Knowledge>,
    gossip: &'a SharedKnowledge,
}

impl ClusterSnapshot<'_> {
    pub(super) fn take<'a>(
        replica: &Replica<Ledger>,
        gossip: &'a SharedKnowledge,
        near: Duration,
        reign: Duration,
    ) -> ClusterSnapshot<'a> {
        let known = gossip
            .read(|base| base.iter().map(|(node, heard)| (node.clone(), heard.record.knowledge.clone())).collect());
        let (me, heard, lags) = (replica.id(), replica.last_contacts(), replica.replication_lags());
        ClusterSnapshot { me, near, reign, heard, lags, known, gossip }
    }

    /// Members as they are; since when those that are there have been, is for [`Attendance`] to say.
    pub(super) fn members(&self, all: &BTreeMap<RaftId, NodeId>) -> BTreeMap<RaftId, Member> {
        all.iter().map(|(id, node)| (*id, self.member(*id, node, self.health(*id, node)))).collect()
    }

    /// Others that are there, may vote and belong to no other cluster.
    pub(super) fn candidates(&self, leadership: &LeadershipView, cluster: ClusterId) -> BTreeMap<RaftId, Member> {
        let candidates = self.known.iter().filter_map(|(node, said)| {
            let id = RaftId(said.replica.filter(|_| said.may_vote)?);
            let new = !leadership.voters.contains_key(&id) && !leadership.learners.contains_key(&id);
            let ours = said.cluster.is_none_or(|its| its == cluster);
            let there = MemberHealth::Healthy { since: Duration::ZERO };
            (new && ours && self.gossip.is_alive(node)).then(|| (id, self.member(id, node, there)))
        });
        candidates.collect()
    }

    fn member(&self, id: RaftId, node: &NodeId, health: MemberHealth) -> Member {
        let said = self.known.get(node);
        Member {
            node: node.clone(),
            health,
            preferred: said.is_some_and(|said| said.stationary && said.mains_powered),
            leaving: said.is_some_and(|said| said.leaving),
            lag: self.lags.get(&id).copied().flatten(),
        }
    }

    fn health(&self, id: RaftId, node: &NodeId) -> MemberHealth {
        if id == self.me {
            return MemberHealth::Healthy { since: Duration::ZERO };
        }
        let gossips = self.gossip.is_alive(node);
        if gossips && self.known.get(node).is_some_and(|said| said.replica != Some(id.0)) {
            return MemberHealth::Replaced;
        }
        let silent = self.heard.get(&id).copied().flatten().map_or(self.reign, |age| age.min(self.reign));
        match silent {
            silent if silent <= self.near => MemberHealth::Healthy { since: Duration::ZERO },
            silent if gossips => MemberHealth::Unresponsive { since: silent / HELD_UP },
            silent => MemberHealth::Unresponsive { since: silent },
        }
    }
}

/// Since when members are there without a break, as far as this leader knows.
#[derive(Default)]
pub(super) struct StabilityTracker(BTreeMap<RaftId, Instant>);

impl StabilityTracker {
    /// Takes in who is there, and writes down for how long.
    pub(super) fn update<const N: usize>(&mut self, members: [&mut BTreeMap<RaftId, Member>; N]) {
        let now = Instant::now();
        let mut there = BTreeSet::new();
        for (id, member) in members.into_iter().flatten() {
            if let MemberHealth::Healthy { since } = &mut member.health {
                there.insert(*id);
                *since = now.saturating_duration_since(*self.0.entry(*id).or_insert(now));
            }
        }
        self.0.retain(|id, _| there.contains(id));
    }
}
