//! Where robots were last known to be: where to look for what they carry.

use crate::gossip::SharedKnowledge;
use consort_protocol::ids::{NodeId, PlaceId, RobotId};
use consort_protocol::ledger::MissionEntry;
use std::collections::BTreeMap;

/// Where a robot last said that it was.
pub(super) fn place(knowledge: &SharedKnowledge, robot: &RobotId) -> Option<PlaceId> {
    knowledge.read(|base| {
        let heard = base.get(&NodeId::from(robot.clone()))?;
        heard.record.knowledge.worker.as_ref().map(|worker| worker.place.clone())
    })
}

/// Where the robots of a mission are.
pub(super) fn places(knowledge: &SharedKnowledge, entry: Option<&MissionEntry>) -> BTreeMap<RobotId, PlaceId> {
    let holders = entry.map(MissionEntry::holders).unwrap_or_default().into_values();
    holders.filter_map(|robot| place(knowledge, &robot).map(|place| (robot, place))).collect()
}
