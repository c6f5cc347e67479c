//! Snapshot of the cluster for the autopilot: members, candidates, and for how long each of them
//! has been healthy.

use super::decide::{Member, MemberHealth};
use consort_gossip::SharedKnowledge;
use consort_protocol::ids::{ClusterId, NodeId};
use consort_protocol::knowledge::Knowledge;
use consort_protocol::ledger::Ledger;
use consort_raft::{LeadershipView, RaftId, Replica};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tokio::time::Instant;

/// Factor by which a voter without replies may stay silent longer while gossip still reaches it:
/// its process may be blocked by its disk.
const GOSSIP_SILENCE_FACTOR: u32 = 3;

/// State of the members at a single moment.
pub(super) struct ClusterSnapshot<'a> {
    me: RaftId,
    /// A member with contact within this time is healthy.
    contact_max: Duration,
    /// Time for which this node has been the leader.
    led_for: Duration,
    last_contacts: BTreeMap<RaftId, Option<Duration>>,
    lags: BTreeMap<RaftId, Option<u64>>,
    /// Knowledge that nodes have published about themselves.
    known: BTreeMap<NodeId, Knowledge>,
    gossip: &'a SharedKnowledge,
}

impl ClusterSnapshot<'_> {
    pub(super) fn take<'a>(
        replica: &Replica<Ledger>,
        gossip: &'a SharedKnowledge,
        contact_max: Duration,
        led_for: Duration,
    ) -> ClusterSnapshot<'a> {
        let known = gossip
            .read(|base| base.iter().map(|(node, entry)| (node.clone(), entry.record.knowledge.clone())).collect());
        let (me, last_contacts, lags) = (replica.id(), replica.last_contacts(), replica.replication_lags());
        ClusterSnapshot { me, contact_max, led_for, last_contacts, lags, known, gossip }
    }

    /// Returns the members with their present health; [`StabilityTracker`] adds since when they are
    /// healthy.
    pub(super) fn members(&self, all: &BTreeMap<RaftId, NodeId>) -> BTreeMap<RaftId, Member> {
        all.iter().map(|(id, node)| (*id, self.member(*id, node, self.health(*id, node)))).collect()
    }

    /// Returns other nodes that are alive, may vote and belong to no other cluster.
    pub(super) fn candidates(&self, leadership: &LeadershipView, cluster: ClusterId) -> BTreeMap<RaftId, Member> {
        let candidates = self.known.iter().filter_map(|(node, record)| {
            let id = RaftId(record.replica.filter(|_| record.may_vote)?);
            let is_new = !leadership.voters.contains_key(&id) && !leadership.learners.contains_key(&id);
            let in_cluster = record.cluster.is_none_or(|other| other == cluster);
            let health = MemberHealth::Healthy { since: Duration::ZERO };
            (is_new && in_cluster && self.gossip.is_alive(node)).then(|| (id, self.member(id, node, health)))
        });
        candidates.collect()
    }

    fn member(&self, id: RaftId, node: &NodeId, health: MemberHealth) -> Member {
        let record = self.known.get(node);
        Member {
            node: node.clone(),
            health,
            preferred: record.is_some_and(|record| record.stationary && record.mains_powered),
            leaving: record.is_some_and(|record| record.leaving),
            lag: self.lags.get(&id).copied().flatten(),
        }
    }

    fn health(&self, id: RaftId, node: &NodeId) -> MemberHealth {
        if id == self.me {
            return MemberHealth::Healthy { since: Duration::ZERO };
        }
        let is_alive = self.gossip.is_alive(node);
        if is_alive && self.known.get(node).is_some_and(|record| record.replica != Some(id.0)) {
            return MemberHealth::Replaced;
        }
        let silent = self.last_contacts.get(&id).copied().flatten().map_or(self.led_for, |age| age.min(self.led_for));
        match silent {
            silent if silent <= self.contact_max => MemberHealth::Healthy { since: Duration::ZERO },
            silent if is_alive => MemberHealth::Unresponsive { since: silent / GOSSIP_SILENCE_FACTOR },
            silent => MemberHealth::Unresponsive { since: silent },
        }
    }
}

/// Times since which members are healthy without interruption, as far as this leader knows.
#[derive(Default)]
pub(super) struct StabilityTracker(BTreeMap<RaftId, Instant>);

impl StabilityTracker {
    /// Updates the times from the present members, and writes the durations into their health.
    pub(super) fn update<const N: usize>(&mut self, members: [&mut BTreeMap<RaftId, Member>; N]) {
        let now = Instant::now();
        let mut healthy = BTreeSet::new();
        for (id, member) in members.into_iter().flatten() {
            if let MemberHealth::Healthy { since } = &mut member.health {
                healthy.insert(*id);
                *since = now.saturating_duration_since(*self.0.entry(*id).or_insert(now));
            }
        }
        self.0.retain(|id, _| healthy.contains(id));
    }
}
