//! What the decision sees: who keeps the ledger, who could, and for how long each of them has been there.

use super::decide::{Health, Member};
use crate::gossip::SharedKnowledge;
use crate::replica::{Leadership, RaftId, Replica};
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
pub(super) struct Sight<'a> {
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

impl Sight<'_> {
    pub(super) fn of<'a>(
        replica: &Replica<Ledger>,
        gossip: &'a SharedKnowledge,
        near: Duration,
        reign: Duration,
    ) -> Sight<'a> {
        let known = gossip
            .read(|base| base.iter().map(|(node, heard)| (node.clone(), heard.record.knowledge.clone())).collect());
        let (me, heard, lags) = (replica.id(), replica.heard(), replica.lags());
        Sight { me, near, reign, heard, lags, known, gossip }
    }

    /// Members as they are; since when those that are there have been, is for [`Attendance`] to say.
    pub(super) fn members(&self, all: &BTreeMap<RaftId, NodeId>) -> BTreeMap<RaftId, Member> {
        all.iter().map(|(id, node)| (*id, self.member(*id, node, self.health(*id, node)))).collect()
    }

    /// Others that are there, may vote and belong to no other cluster.
    pub(super) fn candidates(&self, leadership: &Leadership, cluster: ClusterId) -> BTreeMap<RaftId, Member> {
        let candidates = self.known.iter().filter_map(|(node, said)| {
            let id = RaftId(said.replica.filter(|_| said.may_vote)?);
            let new = !leadership.voters.contains_key(&id) && !leadership.observers.contains_key(&id);
            let ours = said.cluster.is_none_or(|its| its == cluster);
            let there = Health::Well { since: Duration::ZERO };
            (new && ours && self.gossip.alive(node)).then(|| (id, self.member(id, node, there)))
        });
        candidates.collect()
    }

    fn member(&self, id: RaftId, node: &NodeId, health: Health) -> Member {
        let said = self.known.get(node);
        Member {
            node: node.clone(),
            health,
            fixed: said.is_some_and(|said| said.stationary && said.mains_powered),
            leaving: said.is_some_and(|said| said.leaving),
            lag: self.lags.get(&id).copied().flatten(),
        }
    }

    fn health(&self, id: RaftId, node: &NodeId) -> Health {
        if id == self.me {
            return Health::Well { since: Duration::ZERO };
        }
        let gossips = self.gossip.alive(node);
        if gossips && self.known.get(node).is_some_and(|said| said.replica != Some(id.0)) {
            return Health::Replaced;
        }
        let silent = self.heard.get(&id).copied().flatten().map_or(self.reign, |age| age.min(self.reign));
        match silent {
            silent if silent <= self.near => Health::Well { since: Duration::ZERO },
            silent if gossips => Health::Silent { since: silent / HELD_UP },
            silent => Health::Silent { since: silent },
        }
    }
}

/// Since when members are there without a break, as far as this leader knows.
#[derive(Default)]
pub(super) struct Attendance(BTreeMap<RaftId, Instant>);

impl Attendance {
    /// Takes in who is there, and writes down for how long.
    pub(super) fn follow<const N: usize>(&mut self, members: [&mut BTreeMap<RaftId, Member>; N]) {
        let now = Instant::now();
        let mut there = BTreeSet::new();
        for (id, member) in members.into_iter().flatten() {
            if let Health::Well { since } = &mut member.health {
                there.insert(*id);
                *since = now.saturating_duration_since(*self.0.entry(*id).or_insert(now));
            }
        }
        self.0.retain(|id, _| there.contains(id));
    }
}
