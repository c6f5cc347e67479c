//! The coordinator that a node follows, by the beacons of coordinators and by its own queries to
//! them.
//!
//! A beacon with a later term shows a new coordinator. It proves nothing: a coordinator that no
//! majority follows answers neither a report nor a query for missions. A node that fails to answer,
//! or that the voters contradict, loses its precedence, whatever term its beacons contain.

use consort_bus::clock::Clock;
use consort_bus::{Sample, Stream};
use consort_protocol::codec;
use consort_protocol::ids::NodeId;
use consort_protocol::message::Beacon;
use consort_protocol::units::NodeTime;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Number of consecutive queries without an answer by a coordinator after which beacons of other
/// nodes take precedence.
const FAILURES_MAX: u32 = 2;

/// Time for which a node that did not answer as a coordinator has no precedence.
const DISTRUSTED_FOR: Duration = Duration::from_secs(30);

/// Time without a beacon of the followed node after which a beacon of any term is followed.
const SILENCE_MAX: Duration = Duration::from_secs(10);

/// The coordinator that tasks of a node follow, by its beacons.
pub(crate) type LastBeacon = Arc<Mutex<FollowedCoordinator>>;

/// Stores the latest beacon.
pub(crate) async fn follow_beacons(mut beacons: Stream<Sample>, latest_beacon: LastBeacon, clock: Clock) {
    while let Some(sample) = beacons.recv().await {
        let Ok(beacon) = codec::decode::<Beacon>(&sample.payload) else { continue };
        latest_beacon.lock().unwrap_or_else(PoisonError::into_inner).receive(beacon, clock.now());
    }
}

/// The followed coordinator.
#[derive(Debug, Default)]
pub(crate) struct FollowedCoordinator {
    latest: Option<(Beacon, NodeTime)>,
    /// Consecutive queries that the followed node did not answer as a coordinator.
    failures: u32,
    /// Nodes that did not answer as a coordinator, and since when.
    distrusted: BTreeMap<NodeId, NodeTime>,
}

/// Effect of a beacon.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct BeaconChange {
    /// It belongs to another leader session than the previous beacon.
    pub(crate) new_session: bool,
    /// It belongs to another cluster than the previous beacon.
    pub(crate) other_cluster: bool,
}

impl FollowedCoordinator {
    /// Returns the latest beacon of the followed coordinator.
    pub(crate) fn beacon(&self) -> Option<&Beacon> {
        self.latest.as_ref().map(|(beacon, _)| beacon)
    }

    /// Returns the latest beacon of the followed coordinator and its arrival.
    pub(crate) fn latest(&self) -> Option<&(Beacon, NodeTime)> {
        self.latest.as_ref()
    }

    /// Follows the coordinator of a beacon. Returns `None` if another coordinator takes precedence.
    pub(crate) fn receive(&mut self, beacon: Beacon, now: NodeTime) -> Option<BeaconChange> {
        self.distrusted.retain(|_, since| now.since(*since) < DISTRUSTED_FOR);
        let known = self.latest.as_ref();
        if known.is_some_and(|(known, at)| !self.supersedes(&beacon, known, now.since(*at))) {
            return None;
        }
        let known = self.beacon();
        let change = BeaconChange {
            new_session: beacon.is_other_leader_session(known),
            other_cluster: known.is_some_and(|known| beacon.is_other_cluster(known)),
        };
        // Not at each new session: a node may claim a later term in each beacon.
        if known.is_none_or(|known| known.node != beacon.node) {
            self.failures = 0;
        }
        self.latest = Some((beacon, now));
        Some(change)
    }

    /// Checks whether a beacon replaces the known one, which arrived `age` ago.
    fn supersedes(&self, beacon: &Beacon, known: &Beacon, age: Duration) -> bool {
        let distrusts = |node: &NodeId| self.distrusted.contains_key(node);
        // The receiver has moved to another cluster, where terms are counted anew.
        if beacon.is_other_cluster(known) && !distrusts(&beacon.node) || age > SILENCE_MAX {
            return true;
        }
        match (distrusts(&known.node), distrusts(&beacon.node)) {
            (true, false) => true,
            (false, true) => false,
            (true, true) | (false, false) => beacon.term >= known.term,
        }
    }

    /// Records that a node answered a query as a coordinator does.
    pub(crate) fn answered(&mut self, node: &NodeId) {
        self.distrusted.remove(node);
        if self.beacon().is_some_and(|beacon| beacon.node == *node) {
            self.failures = 0;
        }
    }

    /// Records that a node did not answer a query, or not as a coordinator.
    pub(crate) fn not_answered(&mut self, node: &NodeId, now: NodeTime) {
        if self.beacon().is_none_or(|beacon| beacon.node != *node) {
            return;
        }
        self.failures += 1;
        if self.failures >= FAILURES_MAX {
            self.failures = 0;
            self.distrust(node.clone(), now);
        }
    }

    /// Lets the beacons of other nodes take precedence over those of this node for a while.
    pub(crate) fn distrust(&mut self, node: NodeId, now: NodeTime) {
        self.distrusted.insert(node, now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::ids::ClusterId;
    use std::collections::BTreeSet;

    fn beacon(node: &str, term: u64) -> Beacon {
        let node = node.parse().unwrap();
        Beacon { node, term, voters: BTreeSet::new(), since_ms: 0, cluster: Some(ClusterId(1)), wire: None }
    }

    fn at(seconds: u64) -> NodeTime {
        NodeTime::ZERO + Duration::from_secs(seconds)
    }

    fn node(followed: &FollowedCoordinator) -> &str {
        followed.beacon().unwrap().node.as_str()
    }

    fn change(new_session: bool, other_cluster: bool) -> Option<BeaconChange> {
        Some(BeaconChange { new_session, other_cluster })
    }

    #[test]
    fn a_later_term_or_another_cluster_is_followed() {
        let mut followed = FollowedCoordinator::default();
        assert_eq!(followed.receive(beacon("one", 2), at(0)), change(true, false));
        assert_eq!(followed.receive(beacon("one", 2), at(1)), change(false, false));
        assert_eq!(followed.receive(beacon("two", 1), at(1)), None);
        assert_eq!(followed.receive(Beacon { cluster: None, ..beacon("two", 1) }, at(1)), None);
        assert_eq!(node(&followed), "one");
        assert_eq!(followed.receive(beacon("two", 3), at(2)), change(true, false));
        let other = Beacon { cluster: Some(ClusterId(2)), ..beacon("one", 1) };
        assert_eq!(followed.receive(other, at(2)), change(true, true));
    }

    #[test]
    fn a_node_that_does_not_answer_loses_its_precedence() {
        let mut followed = FollowedCoordinator::default();
        followed.receive(beacon("one", 2), at(0));
        assert_eq!(followed.receive(beacon("eve", u64::MAX), at(0)), change(true, false));
        followed.not_answered(&"eve".parse().unwrap(), at(1));
        assert_eq!(followed.receive(beacon("one", 2), at(1)), None, "a single reply may be lost");
        followed.not_answered(&"eve".parse().unwrap(), at(2));
        assert_eq!(followed.receive(beacon("eve", u64::MAX), at(2)), change(false, false), "no other is known");
        assert_eq!(followed.receive(beacon("one", 2), at(2)), change(true, false));
        assert_eq!(followed.receive(beacon("eve", u64::MAX), at(3)), None);
        // The true coordinator has answered: a single failure changes nothing.
        followed.not_answered(&"one".parse().unwrap(), at(3));
        followed.answered(&"one".parse().unwrap());
        followed.not_answered(&"one".parse().unwrap(), at(4));
        assert_eq!(followed.receive(beacon("eve", u64::MAX), at(4)), None);
        assert_eq!(followed.receive(beacon("one", 2), at(30)), change(false, false));
        assert_eq!(followed.receive(beacon("eve", u64::MAX), at(33)), change(true, false), "once more, later");
    }

    #[test]
    fn a_later_term_does_not_excuse_a_node_that_does_not_answer() {
        let mut followed = FollowedCoordinator::default();
        followed.receive(beacon("one", 2), at(0));
        for second in 0..2 {
            assert_eq!(followed.receive(beacon("eve", 10 + second), at(second)), change(true, false));
            followed.not_answered(&"eve".parse().unwrap(), at(second));
        }
        assert_eq!(followed.receive(beacon("one", 2), at(2)), change(true, false));
        assert_eq!(followed.receive(beacon("eve", 12), at(2)), None);
    }

    #[test]
    fn a_distrusted_node_is_not_followed_to_another_cluster() {
        let mut followed = FollowedCoordinator::default();
        let other = Beacon { cluster: Some(ClusterId(2)), ..beacon("eve", 1) };
        followed.receive(other.clone(), at(0));
        followed.distrust("eve".parse().unwrap(), at(0));
        assert_eq!(followed.receive(beacon("one", 2), at(1)), change(true, true));
        assert_eq!(followed.receive(other, at(1)), None);
    }

    #[test]
    fn a_silent_coordinator_is_replaced_by_any_other() {
        let mut followed = FollowedCoordinator::default();
        followed.receive(beacon("eve", u64::MAX), at(0));
        assert_eq!(followed.receive(beacon("one", 2), at(10)), None);
        assert_eq!(followed.receive(beacon("one", 2), at(11)), change(true, false));
        assert_eq!(node(&followed), "one");
    }
}
