//! Goals that the robots of the world pursue, and whether each was begun in a role.

use crate::Observation;
use crate::chaos::chaos_fleet::WORLD;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId, PlaceId, RobotId, RoleId};
use consort_skills::actions::{Goal, NavigateToPose};
use consort_world::world::{LoggedEvent, WorldEvent as InWorld};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Goals in progress.
#[derive(Default)]
pub(super) struct ActiveGoals {
    /// Roles in which the robots act, by their own events.
    pub(super) roles: BTreeSet<(NodeId, MissionId, RoleId)>,
    pub(super) goals: BTreeMap<(RobotId, u64), ActiveGoal>,
    /// Time of the latest start or end of the driver server, which then permits all goals for a while.
    pub(super) server_changed: Duration,
}

/// A goal in progress.
pub(super) struct ActiveGoal {
    /// The robot had a role when the goal began.
    pub(super) in_role: bool,
    /// The place at the end of a drive; `None` for other goals.
    pub(super) drives_to: Option<PlaceId>,
}

impl ActiveGoals {
    /// Follows the events of nodes, and what the test did to them.
    pub(super) fn observe(&mut self, at: Duration, entry: &Observation) {
        let node = entry.node();
        if let Observation::TestAction { action, .. } = entry {
            if matches!(*action, "killed" | "ended" | "left") {
                self.roles.retain(|(robot, ..)| robot != node);
            }
            if node.as_str() == WORLD {
                self.server_changed = at;
            }
        }
        match entry.event_kind() {
            Some(EventKind::Started { mission, role, .. } | EventKind::Resumed { mission, role }) => {
                self.roles.insert((node.clone(), mission.clone(), role.clone()));
            }
            Some(
                EventKind::Suspended { mission, role, .. }
                | EventKind::GaveUp { mission, role, .. }
                | EventKind::TaskFailed { mission, role, .. },
            ) => {
                self.roles.remove(&(node.clone(), mission.clone(), role.clone()));
            }
            Some(EventKind::Halted { mission, role, .. }) => self.end_role(node, mission, role),
            _ => {}
        }
    }

    /// Follows the goals in the world.
    pub(super) fn observe_world(&mut self, entry: &LoggedEvent) {
        match &entry.event {
            InWorld::GoalStarted { robot, id, goal } => self.begin(robot, id.0, goal),
            InWorld::GoalEnded { robot, id, .. } => {
                self.goals.remove(&(robot.clone(), id.0));
            }
            InWorld::Stranded { robot } => self.goals.retain(|(other, _), _| other != robot),
            _ => {}
        }
    }

    pub(super) fn begin(&mut self, robot: &RobotId, id: u64, goal: &Goal) {
        let in_role = self.has_role(&NodeId::from(robot.clone()));
        let drives_to = goal.read::<NavigateToPose>().and_then(Result::ok).and_then(|drive| drive.place);
        self.goals.insert((robot.clone(), id), ActiveGoal { in_role, drives_to });
    }

    /// Ends a role. A drive to an assembly place goes on without a role, and then heeds only what the robot has received: no
    /// lease is renewed.
    fn end_role(&mut self, node: &NodeId, mission: &MissionId, role: &RoleId) {
        self.roles.remove(&(node.clone(), mission.clone(), role.clone()));
        if self.has_role(node) {
            return;
        }
        for ((robot, _), goal) in &mut self.goals {
            if robot.as_str() == node.as_str() && goal.drives_to.is_some() {
                goal.in_role = false;
            }
        }
    }

    fn has_role(&self, node: &NodeId) -> bool {
        self.roles.iter().any(|(other, ..)| other == node)
    }

    /// Returns the time from which the driver server stops a robot that must stop since `since`.
    pub(super) fn stopped_from(&self, since: Duration) -> Duration {
        since.max(self.server_changed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slug;
    use consort_protocol::pose::Pose;
    use consort_skills::actions::Dock;

    #[test]
    fn a_drive_belongs_to_no_role_once_its_robot_has_none() {
        let mut active = ActiveGoals::default();
        let garnet: NodeId = slug("garnet");
        let missions: [MissionId; 2] = ["rest-1", "rest-2"].map(slug);
        for mission in &missions {
            active.roles.insert((garnet.clone(), mission.clone(), slug("r1")));
        }
        let drive = NavigateToPose::to(Pose::new(0.0, 0.0, 0.0), Some(slug("Dock")));
        active.begin(&slug("garnet"), 7, &drive.clone().into());
        active.begin(&slug("garnet"), 8, &Dock { charger: None }.into());
        active.begin(&slug("hazel"), 9, &drive.into());
        for (mission, in_role) in missions.iter().zip([[true, true, false], [false, true, false]]) {
            active.end_role(&garnet, mission, &slug("r1"));
            assert_eq!(active.goals.values().map(|goal| goal.in_role).collect::<Vec<_>>(), in_role, "{mission}");
        }
    }
}
