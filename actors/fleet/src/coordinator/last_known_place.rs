//! Last known places of robots, which is where to search for the items they carry, and nodes of
//! other clusters.

use consort_gossip::SharedKnowledge;
use consort_protocol::ids::{ClusterId, NodeId, PlaceId, RobotId};
use consort_protocol::ledger::MissionEntry;
use std::collections::BTreeMap;

/// Returns the last published place of a robot.
pub(crate) fn last_known_place(knowledge: &SharedKnowledge, robot: &RobotId) -> Option<PlaceId> {
    knowledge.read(|base| {
        let stored = base.get(&NodeId::from(robot.clone()))?;
        stored.knowledge().robot.as_ref().map(|worker| worker.place.clone())
    })
}

/// Returns the last published places of a mission's robots.
pub(super) fn last_known_places(
    knowledge: &SharedKnowledge,
    entry: Option<&MissionEntry>,
) -> BTreeMap<RobotId, PlaceId> {
    let holders = entry.map(MissionEntry::holders).unwrap_or_default().into_values();
    holders.filter_map(|robot| last_known_place(knowledge, &robot).map(|place| (robot, place))).collect()
}

/// Returns the other clusters with the name of this fleet, according to received records, each with
/// a node of it.
pub(crate) fn foreign_clusters(knowledge: &SharedKnowledge, own: Option<ClusterId>) -> BTreeMap<ClusterId, NodeId> {
    knowledge.read(|base| {
        let clusters = base.iter().filter_map(|(node, stored)| Some((stored.record.knowledge.cluster?, node.clone())));
        clusters.filter(|(cluster, _)| Some(*cluster) != own).collect()
    })
}
