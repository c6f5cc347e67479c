//! Indexes of the missions by state, rank and robot.

use crate::ids::{MissionId, RobotId};
use crate::ledger::entry::MissionEntry;
use crate::ledger::service_order::ServiceRank;
use crate::ledger::shared_map::SharedMap;
use std::collections::BTreeSet;

/// Group of missions that queries need together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::ledger) enum MissionGroup {
    /// Missions that have not ended and wait for no person.
    Active,
    /// Active missions whose roles have, or had, robots.
    WithRobots,
    /// Active missions with promised roles.
    WithPromises,
    /// Active missions with roles of people, or with open requests to people.
    WithPeople,
    /// Missions with items at robots that may act no more.
    WithItems,
}

impl MissionGroup {
    const ALL: [MissionGroup; 5] = [
        MissionGroup::Active,
        MissionGroup::WithRobots,
        MissionGroup::WithPromises,
        MissionGroup::WithPeople,
        MissionGroup::WithItems,
    ];

    /// Checks whether a mission belongs to the group.
    pub(super) fn contains(self, entry: &MissionEntry) -> bool {
        let is_active = !entry.state.is_final();
        match self {
            MissionGroup::Active => is_active,
            MissionGroup::WithRobots => {
                let has_robots = || entry.roles.values().any(|role| role.holder.is_some());
                is_active && (!entry.former_holders.is_empty() || has_robots())
            }
            MissionGroup::WithPromises => is_active && entry.promised_roles().next().is_some(),
            MissionGroup::WithPeople => {
                let has_requests = || entry.person_requests().any(|(_, request)| request.is_open());
                is_active && (entry.unmanaged_roles().next().is_some() || has_requests())
            }
            MissionGroup::WithItems => !entry.held_items().is_empty(),
        }
    }
}

/// Checks whether a robot holds a role of an active mission.
pub(super) fn holds(entry: &MissionEntry, robot: &RobotId) -> bool {
    !entry.state.is_final() && entry.held_roles().any(|(.., holder)| holder.robot == *robot)
}

/// Checks whether a role of an active mission is promised to a robot.
pub(super) fn is_promised(entry: &MissionEntry, robot: &RobotId) -> bool {
    !entry.state.is_final() && entry.promised_roles().any(|(_, promise)| promise.robot == *robot)
}

/// Indexes of missions.
#[derive(Debug, Clone, Default)]
pub(super) struct MissionIndex {
    /// The missions of each group, in the order in which they are served.
    groups: [SharedMap<(ServiceRank, MissionId), ()>; MissionGroup::ALL.len()],
    held: SharedMap<RobotId, BTreeSet<MissionId>>,
    promised: SharedMap<RobotId, BTreeSet<MissionId>>,
    /// What the indexes contain of each mission that is in any of them.
    indexed: SharedMap<MissionId, IndexedMission>,
}

impl MissionIndex {
    /// Replaces what the indexes contain of a mission.
    pub(super) fn update(&mut self, id: &MissionId, entry: Option<&MissionEntry>) {
        let present = entry.and_then(IndexedMission::of);
        if self.indexed.get(id) == present.as_ref() {
            return;
        }
        if let Some(former) = self.indexed.remove(id) {
            for group in &former.groups {
                self.groups[*group as usize].remove(&(former.rank, id.clone()));
            }
            former.holders.iter().for_each(|robot| remove(&mut self.held, robot, id));
            former.promised.iter().for_each(|robot| remove(&mut self.promised, robot, id));
        }
        if let Some(present) = present {
            for group in &present.groups {
                self.groups[*group as usize].insert((present.rank, id.clone()), ());
            }
            present.holders.iter().for_each(|robot| add(&mut self.held, robot, id));
            present.promised.iter().for_each(|robot| add(&mut self.promised, robot, id));
            self.indexed.insert(id.clone(), present);
        }
    }

    pub(super) fn of_group(&self, group: MissionGroup) -> impl Iterator<Item = &MissionId> {
        self.groups[group as usize].iter().map(|((_, id), ())| id)
    }

    pub(super) fn active_before(&self, rank: ServiceRank) -> impl Iterator<Item = &MissionId> {
        let active = self.groups[MissionGroup::Active as usize].iter().map(|((other, id), ())| (other, id));
        active.take_while(move |(other, _)| **other < rank).map(|(_, id)| id)
    }

    pub(super) fn count(&self, group: MissionGroup) -> usize {
        self.groups[group as usize].len()
    }

    pub(super) fn held_by(&self, robot: &RobotId) -> impl Iterator<Item = &MissionId> {
        self.held.get(robot).into_iter().flatten()
    }

    pub(super) fn promised_to(&self, robot: &RobotId) -> impl Iterator<Item = &MissionId> {
        self.promised.get(robot).into_iter().flatten()
    }
}

fn add(missions: &mut SharedMap<RobotId, BTreeSet<MissionId>>, robot: &RobotId, id: &MissionId) {
    match missions.get_mut(robot) {
        Some(of_robot) => {
            of_robot.insert(id.clone());
        }
        None => missions.insert(robot.clone(), BTreeSet::from([id.clone()])),
    }
}

fn remove(missions: &mut SharedMap<RobotId, BTreeSet<MissionId>>, robot: &RobotId, id: &MissionId) {
    if let Some(of_robot) = missions.get_mut(robot) {
        of_robot.remove(id);
        if of_robot.is_empty() {
            missions.remove(robot);
        }
    }
}

/// What the indexes contain of a mission.
#[derive(Debug, Clone, PartialEq, Eq)]
struct IndexedMission {
    rank: ServiceRank,
    groups: Vec<MissionGroup>,
    /// Robots that hold roles.
    holders: BTreeSet<RobotId>,
    /// Robots that roles are promised to.
    promised: BTreeSet<RobotId>,
}

impl IndexedMission {
    /// Returns `None` for a mission that is in no index.
    fn of(entry: &MissionEntry) -> Option<IndexedMission> {
        let groups: Vec<MissionGroup> = MissionGroup::ALL.into_iter().filter(|group| group.contains(entry)).collect();
        let (mut holders, mut promised) = (BTreeSet::new(), BTreeSet::new());
        if MissionGroup::WithRobots.contains(entry) {
            holders.extend(entry.held_roles().map(|(.., holder)| holder.robot.clone()));
            promised.extend(entry.promised_roles().map(|(_, promise)| promise.robot.clone()));
        }
        (!groups.is_empty()).then(|| IndexedMission { rank: entry.rank(), groups, holders, promised })
    }
}
