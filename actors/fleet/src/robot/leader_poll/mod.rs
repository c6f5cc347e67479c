//! Confirmation of the coordinator by the voters. In a fleet with certificates a robot takes notices (awards, their end,
//! orders of people) and replies to its reports from no other node.
//!
//! A beacon proves nothing, and neither does a reply of its author: a program with the key of a voter can send both.
//! So the robot queries the voters of all beacons that it receives for the leader that each of them follows:
//!
//! ```text
//!  notice ──▶ is its author confirmed, and claims no other node a later term? ── yes ──▶ perform it
//!                │ no
//!                ▼ wire/leader/{voter}, to each voter of the recent beacons
//!              poll ─┬─ the author leads ──▶ perform it, and later notices of this author
//!                    ├─ another node leads, or claims to ──▶ refuse it
//!                    └─ too few replies, no other claim ──▶ perform it; of orders only a hold counts, for some seconds
//! ```
//!
//! A node leads if a majority of the voters in its beacon follow it in the same term, and if fewer voters follow any
//! other node or are late and may follow it. A voter states only its own leader, so a single key loses against a
//! coordinator with two followers. A beacon may name any voters, so only nodes that may vote by their own records count
//! as late.

use bytes::Bytes;
use consort_bus::SharedBus;
use consort_protocol::codec;
use consort_protocol::ids::{ClusterId, NodeId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::lease::Epoch;
use consort_protocol::message::{Beacon, FollowedLeader};
use consort_protocol::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tokio::task::JoinSet;

/// Time for which the beacon of a node makes it a candidate. As long as a robot follows a silent coordinator.
const BEACON_AGE_MAX: Duration = Duration::from_secs(10);

/// Time for which a node counts as refuted without another poll. Raised: an attacker causes fewer polls, and a new
/// coordinator waits longer if voters stated their former leader. A guess.
const REFUTED_FOR: Duration = Duration::from_secs(2);

/// Maximum number of voters of a candidate: twice as many as the autopilot appoints. Each is queried.
const VOTERS_MAX: usize = 18;

/// Timeout of a voter. The sender of a notice waits for longer.
const STATEMENT_TIMEOUT: Duration = Duration::from_millis(300);

/// What the robot knows of the nodes that claim to coordinate.
#[derive(Debug, Default)]
pub(super) struct LeaderCheck {
    /// Latest beacon of each node with a verified author, and its arrival. The certificates of voters bound their
    /// number. Empty in a fleet without certificates.
    beacons: BTreeMap<NodeId, (Beacon, NodeTime)>,
    /// True once a message had a verified author: the fleet has certificates.
    has_certificates: bool,
    confirmed: Option<ConfirmedLeader>,
    /// Nodes against which the latest poll decided, and its time.
    refuted: BTreeMap<NodeId, NodeTime>,
    /// Start of the poll that is under way.
    polling_since: Option<NodeTime>,
}

/// The coordinator that a poll has confirmed.
#[derive(Debug, Clone, PartialEq, Eq)]
struct ConfirmedLeader {
    leader: FollowedLeader,
    cluster: Option<ClusterId>,
}

/// Standing of a node as the coordinator.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Standing {
    /// A poll has confirmed it, or the fleet has no certificates.
    Confirmed,
    /// Only a poll can tell; after a poll: it may lead, and no other node claims to.
    Unconfirmed,
    /// It sends no beacons, a recent poll confirmed another node, or a poll has not decided against another node.
    Refuted,
}

/// Change by a poll.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct LeaderChange {
    /// Another leader session is confirmed.
    pub(super) new_session: bool,
    /// It belongs to another cluster than the session confirmed before.
    pub(super) other_cluster: bool,
}

impl LeaderCheck {
    /// Records that the fleet has certificates: from now on only a poll shows the coordinator.
    pub(super) fn require_polls(&mut self) {
        self.has_certificates = true;
    }

    /// Records a beacon with a verified author. Returns false if the robot must ignore it: it names more voters than a
    /// fleet has.
    pub(super) fn hear(&mut self, beacon: &Beacon, now: NodeTime) -> bool {
        self.require_polls();
        self.beacons.retain(|_, (_, at)| now.since(*at) <= BEACON_AGE_MAX);
        let is_plausible = beacon.voters.len() <= VOTERS_MAX;
        if is_plausible {
            self.beacons.insert(beacon.node.clone(), (beacon.clone(), now));
        }
        is_plausible
    }

    /// Checks whether the fleet has certificates: only a poll shows the coordinator.
    pub(super) fn has_certificates(&self) -> bool {
        self.has_certificates
    }

    /// Returns the standing of a node that sends a message as of this position in the ledger.
    pub(super) fn standing(&self, node: &NodeId, as_of: Epoch, now: NodeTime) -> Standing {
        if !self.has_certificates || self.is_confirmed(node, as_of) && !self.is_contested(now) {
            return Standing::Confirmed;
        }
        match self.is_refuted(node, now) || !self.beacons.contains_key(node) {
            true => Standing::Refuted,
            false => Standing::Unconfirmed,
        }
    }

    /// Returns the standing of a node right after a poll. If the poll has not decided, the leader confirmed before stays
    /// confirmed while another voter follows it; any other node must be unopposed.
    pub(super) fn standing_after(&self, poll: &LeaderPoll, node: &NodeId, as_of: Epoch, now: NodeTime) -> Standing {
        match self.standing(node, as_of, now) {
            Standing::Unconfirmed if self.is_confirmed(node, as_of) && poll.is_upheld(node) => Standing::Confirmed,
            Standing::Unconfirmed if !poll.is_unopposed(node) => Standing::Refuted,
            standing => standing,
        }
    }

    /// Checks whether a poll has confirmed the node. The ledger of a leader has no position of a later term.
    fn is_confirmed(&self, node: &NodeId, as_of: Epoch) -> bool {
        let leads = |leader: &FollowedLeader| leader.node == *node && as_of.term <= leader.term;
        self.confirmed.as_ref().is_some_and(|confirmed| leads(&confirmed.leader))
    }

    /// Checks whether another node states a later term than the confirmed leader, and no recent poll refutes it: the
    /// leader may have been replaced, and its key may be stolen.
    fn is_contested(&self, now: NodeTime) -> bool {
        let Some(ConfirmedLeader { leader, cluster }) = &self.confirmed else { return false };
        self.beacons.values().any(|(beacon, at)| {
            let is_later = beacon.node != leader.node && beacon.term > leader.term;
            let is_same_cluster = cluster.zip(beacon.cluster).is_none_or(|(own, other)| own == other);
            let is_recent = now.since(*at) <= BEACON_AGE_MAX;
            is_later && is_same_cluster && is_recent && !self.is_refuted(&beacon.node, now)
        })
    }

    /// Checks whether a recent poll confirmed another node.
    fn is_refuted(&self, node: &NodeId, now: NodeTime) -> bool {
        self.refuted.get(node).is_some_and(|at| now.since(*at) < REFUTED_FOR)
    }

    /// Checks whether a beacon belongs to another cluster than the confirmed coordinator, and only a poll can tell
    /// whether the robot has moved to it.
    pub(super) fn has_moved(&self, beacon: &Beacon, now: NodeTime) -> bool {
        let confirmed = self.confirmed.as_ref().and_then(|confirmed| confirmed.cluster);
        let is_other = confirmed.zip(beacon.cluster).is_some_and(|(confirmed, cluster)| confirmed != cluster);
        is_other && !self.is_refuted(&beacon.node, now)
    }

    /// Begins a poll. Returns `None` while a poll is under way. `may_vote` checks the record of a node.
    pub(super) fn begin_poll(&mut self, now: NodeTime, may_vote: impl Fn(&NodeId) -> bool) -> Option<LeaderPoll> {
        // A poll ends with the timeout of the voters; twice as long shows that its task was lost.
        if self.polling_since.is_some_and(|since| now.since(since) < 2 * STATEMENT_TIMEOUT) {
            return None;
        }
        self.polling_since = Some(now);
        let candidates: BTreeMap<NodeId, Beacon> =
            self.beacons.values().map(|(beacon, _)| (beacon.node.clone(), beacon.clone())).collect();
        let named = candidates.values().flat_map(|beacon| &beacon.voters);
        // Only a voter sends beacons.
        let is_voter = |node: &&NodeId| candidates.contains_key(*node) || may_vote(node);
        let known_voters = named.filter(is_voter).cloned().collect();
        let confirmed = self.confirmed.as_ref().map(|confirmed| confirmed.leader.node.clone());
        Some(LeaderPoll { candidates, known_voters, confirmed, statements: BTreeMap::new() })
    }

    /// Ends a poll.
    pub(super) fn end_poll(&mut self, poll: &LeaderPoll, now: NodeTime) -> LeaderChange {
        self.polling_since = None;
        self.refuted.retain(|_, at| now.since(*at) < REFUTED_FOR);
        let Some((beacon, leader)) = poll.leader() else { return LeaderChange::default() };
        let others = poll.candidates.keys().filter(|node| **node != leader.node);
        self.refuted.extend(others.map(|node| (node.clone(), now)));
        self.refuted.remove(&leader.node);
        let cluster_before = self.confirmed.as_ref().and_then(|confirmed| confirmed.cluster);
        let change = LeaderChange {
            new_session: self.confirmed.as_ref().is_none_or(|confirmed| confirmed.leader != leader),
            other_cluster: cluster_before.zip(beacon.cluster).is_some_and(|(before, now)| before != now),
        };
        self.confirmed = Some(ConfirmedLeader { leader, cluster: beacon.cluster.or(cluster_before) });
        change
    }
}

/// A poll of the voters.
#[derive(Debug)]
pub(crate) struct LeaderPoll {
    /// Nodes that claim to coordinate, with their beacons.
    candidates: BTreeMap<NodeId, Beacon>,
    /// Voters in these beacons that may vote by their own records, too.
    known_voters: BTreeSet<NodeId>,
    /// The node confirmed before: it wins a tie.
    confirmed: Option<NodeId>,
    /// Leader that each voter states; `None` for a voter that follows none or is absent. A late voter has no entry.
    statements: BTreeMap<NodeId, Option<FollowedLeader>>,
}

impl LeaderPoll {
    /// Queries the voters until a leader is certain, or all have replied or are late.
    pub(super) async fn run(mut self, bus: &SharedBus, keys: &Keys) -> LeaderPoll {
        let mut replies = JoinSet::new();
        for voter in self.voters() {
            let (bus, key) = (bus.clone(), keys.write(&Key::Leader(voter.clone())));
            replies.spawn(async move {
                let statement = query_leader(&bus, &key, &voter).await;
                (voter, statement)
            });
        }
        while let Some(reply) = replies.join_next().await {
            // A late voter and a task that failed leave no statement.
            if let Ok((voter, Some(statement))) = reply {
                self.statements.insert(voter, statement);
            }
            if self.leader().is_some() {
                break;
            }
        }
        self
    }

    fn voters(&self) -> BTreeSet<NodeId> {
        self.candidates.values().flat_map(|beacon| &beacon.voters).cloned().collect()
    }

    /// Returns the node that leads, whatever the voters without a statement follow, and its beacon.
    fn leader(&self) -> Option<(&Beacon, FollowedLeader)> {
        self.candidates.values().find_map(|beacon| Some((beacon, self.lead_of(beacon)?)))
    }

    /// Returns the leader session of a candidate that leads.
    fn lead_of(&self, beacon: &Beacon) -> Option<FollowedLeader> {
        let own = |(voter, followed): &(&NodeId, &FollowedLeader)| {
            followed.node == beacon.node && beacon.voters.contains(*voter)
        };
        let (leader, followers) = largest(self.stated().filter(own))?;
        let rival = self.rival_followers(&beacon.node);
        let wins = followers > rival || followers == rival && self.confirmed.as_ref() == Some(&beacon.node);
        (wins && 2 * followers > beacon.voters.len()).then(|| leader.clone())
    }

    /// Returns the largest number of voters that follow another node, or may: known voters without a statement may follow
    /// a candidate that names them.
    fn rival_followers(&self, node: &NodeId) -> usize {
        let others = self.stated().filter(|(_, followed)| followed.node != *node);
        let stated = largest(others).map_or(0, |(_, followers)| followers);
        let rivals = self.candidates.values().filter(|rival| rival.node != *node);
        let possible = rivals.map(|rival| {
            let own = self.stated().filter(|(_, followed)| followed.node == rival.node);
            let is_open = |voter: &&NodeId| self.known_voters.contains(*voter) && !self.statements.contains_key(*voter);
            let open = rival.voters.iter().filter(is_open).count();
            largest(own).map_or(0, |(_, followers)| followers) + open
        });
        possible.max().unwrap_or(0).max(stated)
    }

    /// Checks whether voters follow the node, none follows another, and no other node claims to coordinate without
    /// following it. The voters of a rival may be late.
    fn is_unopposed(&self, node: &NodeId) -> bool {
        let follows = |voter: &NodeId| self.stated().any(|(stated, _)| stated == voter);
        self.stated().next().is_some()
            && self.stated().all(|(_, followed)| followed.node == *node)
            && self.candidates.keys().all(|candidate| candidate == node || follows(candidate))
    }

    /// Checks whether another voter follows the node, and of other nodes none has a follower but itself.
    fn is_upheld(&self, node: &NodeId) -> bool {
        self.stated().any(|(voter, followed)| voter != node && followed.node == *node)
            && self.stated().all(|(voter, followed)| followed.node == *node || followed.node == *voter)
    }

    /// Checks whether another node leads, and only the node itself states that it does.
    pub(super) fn is_impostor(&self, node: &NodeId) -> bool {
        let is_followed = self.stated().any(|(voter, followed)| voter != node && followed.node == *node);
        !is_followed && self.leader().is_some_and(|(beacon, _)| beacon.node != *node)
    }

    fn stated(&self) -> impl Iterator<Item = (&NodeId, &FollowedLeader)> {
        self.statements.iter().filter_map(|(voter, statement)| Some((voter, statement.as_ref()?)))
    }
}

/// Returns the leader session that most voters state, and their number.
fn largest<'a>(stated: impl Iterator<Item = (&'a NodeId, &'a FollowedLeader)>) -> Option<(&'a FollowedLeader, usize)> {
    let mut followers: BTreeMap<&FollowedLeader, usize> = BTreeMap::new();
    for (_, followed) in stated {
        *followers.entry(followed).or_default() += 1;
    }
    followers.into_iter().max_by_key(|(_, count)| *count)
}

/// Queries a voter for the leader that it follows. Returns `Some(None)` if it follows none or is absent, and `None` if
/// it is late.
async fn query_leader(bus: &SharedBus, key: &str, voter: &NodeId) -> Option<Option<FollowedLeader>> {
    let statement = async {
        let mut replies = bus.query(key, Bytes::new(), 2 * STATEMENT_TIMEOUT).await.ok()?;
        while let Some(reply) = replies.recv().await {
            if reply.author.may_be(voter.as_str()) {
                return codec::decode::<Option<FollowedLeader>>(&reply.payload.ok()?).ok()?;
            }
        }
        None
    };
    tokio::time::timeout(STATEMENT_TIMEOUT, statement).await.ok()
}

#[cfg(test)]
mod tests;
