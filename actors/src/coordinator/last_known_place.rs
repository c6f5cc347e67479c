//! Where robots were last known to be, which is where to look for what they carry, and who is in another cluster.

use crate::gossip::SharedKnowledge;
use consort_protocol::ids::{ClusterId, NodeId, PlaceId, RobotId};
use consort_protocol::ledger::MissionEntry;
use std::collections::BTreeMap;

/// Where a robot last said that it was.
pub(super) fn last_known_place(knowledge: &SharedKnowledge, robot: &RobotId) -> Option<PlaceId> {
    knowledge.read(|base| {
        let heard = base.get(&NodeId::from(robot.clone()))?;
        heard.record.knowledge.robot.as_ref().map(|worker| worker.place.clone())
    })
}

/// Where the robots of a mission are.
pub(super) fn last_known_places(
    knowledge: &SharedKnowledge,
    entry: Option<&MissionEntry>,
) -> BTreeMap<RobotId, PlaceId> {
    let holders = entry.map(MissionEntry::holders).unwrap_or_default().into_values();
    holders.filter_map(|robot| last_known_place(knowledge, &robot).map(|place| (robot, place))).collect()
}

/// Other clusters of this fleet's name that are heard of, and a node of each.
pub(crate) fn foreign_clusters(knowledge: &SharedKnowledge, own: Option<ClusterId>) -> BTreeMap<ClusterId, NodeId> {
    knowledge.read(|base| {
        let its = base.iter().filter_map(|(node, heard)| Some((heard.record.knowledge.cluster?, node.clone())));
        its.filter(|(cluster, _)| Some(*cluster) != own).collect()
    })
}
