//! A robot does nothing in a role after its lease has ended.
//!
//! There are two parts. A robot begins tasks, sends signals and passes waits only while it is
//! active in the role. And when a robot begins a role, the simulated robot of the previous holder
//! is at rest. This is checked in the world, where messages in flight no longer matter. A robot without a role may drive
//! to an assembly place, to a charger, or away from a charger; such a drive belongs to no role.

use super::reference_ledger::ReferenceLedger;
use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId, RoleId};
use consort_protocol::knowledge::Charging;
use consort_protocol::ledger::Ledger;
use consort_protocol::mission::RoleKind;
use consort_skills::actions::{Goal, NavigateToPose};
use consort_world::world::{LoggedEvent, WorldEvent as InWorld};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Longest time after the all-clear in which a robot without a role may begin to drive to an assembly place: it may
/// receive the all-clear only when the longest partition has ended.
const ASSEMBLES_FOR: Duration = Duration::from_secs(60);

/// Time after the end of a role in which goals of the role may still reach the body. A robot without a role waits longer
/// before it drives to a charger: until its claim is old enough. It makes room at a charger at once; its record says so.
const ON_THE_WAY: Duration = Duration::from_millis(1_500);

type Part = (MissionId, RoleId);

#[derive(Default)]
pub(super) struct UnderLease {
    reference: ReferenceLedger,
    /// Latest time at which an alarm was in force.
    alarm_at: Option<Duration>,
    active: BTreeSet<(NodeId, Part)>,
    /// Latest role of each robot.
    last: BTreeMap<String, Part>,
    /// Times at which robots ended their latest roles.
    ended: BTreeMap<String, Duration>,
    /// Active goals in the world.
    at_work: BTreeMap<(String, u64), Work>,
    /// Roles of people. Remembered, since there is no ledger while all nodes are down.
    of_people: BTreeSet<Part>,
}

/// An active goal.
struct Work {
    /// The role for which it was begun.
    part: Option<Part>,
    is_drive: bool,
}

impl UnderLease {
    /// `roles` are those of the mission, if there is a ledger that contains it.
    fn acts(
        &mut self,
        node: &NodeId,
        part: Part,
        what: &str,
        is_robot: bool,
        roles: Option<BTreeMap<RoleId, RoleKind>>,
    ) -> Result<(), InvariantViolation> {
        let people = roles.into_iter().flatten().filter(|(_, kind)| *kind == RoleKind::Unmanaged);
        self.of_people.extend(people.map(|(role, _)| (part.0.clone(), role)));
        // The coordinator, on any node, acts in the roles of people.
        if is_robot && !self.of_people.contains(&part) && !self.active.contains(&(node.clone(), part.clone())) {
            let (mission, role) = part;
            return Err(format!("{node} {what} as {role} of {mission}, in which it is not active").into());
        }
        Ok(())
    }

    /// Records a goal in the world. `leaves` means that the robot leaves a charger or parks, by its own record.
    fn pursues(&mut self, at: Duration, robot: &NodeId, id: u64, goal: &Goal, leaves: bool) {
        let is_drive = goal.is::<NavigateToPose>();
        let assembles = is_drive && self.may_assemble(at);
        let ended = self.ended.get(robot.as_str());
        let has_ended = ended.is_some_and(|ended| leaves && is_drive || at > *ended + ON_THE_WAY);
        let is_active = |part: &Part| self.active.contains(&(robot.clone(), part.clone()));
        let last = self.last.get(robot.as_str()).cloned();
        let part = last.filter(|part| !has_ended && (!assembles || is_active(part)));
        self.at_work.insert((robot.to_string(), id), Work { part, is_drive });
    }

    /// Checks whether robots without a role may drive to assembly places.
    fn may_assemble(&self, at: Duration) -> bool {
        self.alarm_at.is_some_and(|alarm_at| at <= alarm_at + ASSEMBLES_FOR)
    }

    /// Records that a robot has ended a role. A drive to an assembly place goes on without it.
    fn ends(&mut self, at: Duration, node: &NodeId, part: &Part) {
        self.active.remove(&(node.clone(), part.clone()));
        if self.last.get(node.as_str()) == Some(part) {
            self.ended.insert(node.to_string(), at);
        }
        if self.may_assemble(at) {
            for ((robot, _), work) in &mut self.at_work {
                if robot == node.as_str() && work.is_drive {
                    work.part = None;
                }
            }
        }
    }

    fn begins(&mut self, node: &NodeId, part: Part) -> Result<(), InvariantViolation> {
        let (mission, role) = &part;
        let mut others = self.at_work.iter().filter(|((robot, _), _)| robot != node.as_str());
        let other = others.find(|(_, work)| work.part.as_ref() == Some(&part));
        if let Some(((robot, goal), _)) = other {
            return Err(
                format!("{node} begins {role} of {mission} while {robot} still pursues goal {goal} for it").into()
            );
        }
        self.ended.remove(node.as_str());
        self.last.insert(node.to_string(), part.clone());
        self.active.insert((node.clone(), part));
        Ok(())
    }
}

impl Invariant for UnderLease {
    fn name(&self) -> &'static str {
        "under_lease"
    }

    fn observe(&mut self, at: Duration, entry: &Observation, fleet: &Fleet) -> Result<(), InvariantViolation> {
        self.reference.observe(entry);
        if self.reference.ledger.has_alarm() {
            self.alarm_at = Some(at);
        }
        let node = entry.node();
        if let Observation::TestAction { action: "killed" | "ended", .. } = entry {
            self.active.retain(|(who, _)| who != node);
        }
        let mut acts = |mission: &MissionId, role: &RoleId, what: &str| {
            let kinds = |ledger: &Ledger| {
                let roles = &ledger.mission(mission)?.roles;
                Some(roles.iter().map(|(role, declared)| (role.clone(), declared.kind)).collect())
            };
            let roles = fleet.ledger(kinds).flatten();
            self.acts(node, (mission.clone(), role.clone()), what, fleet.is_robot(node), roles)
        };
        match entry.event_kind() {
            Some(EventKind::Started { mission, role, .. } | EventKind::Resumed { mission, role }) => {
                self.begins(node, (mission.clone(), role.clone()))
            }
            Some(
                EventKind::Suspended { mission, role, .. }
                | EventKind::GaveUp { mission, role, .. }
                | EventKind::TaskFailed { mission, role, .. },
            ) => {
                self.active.remove(&(node.clone(), (mission.clone(), role.clone())));
                Ok(())
            }
            Some(EventKind::Halted { mission, role, .. }) => {
                self.ends(at, node, &(mission.clone(), role.clone()));
                Ok(())
            }
            Some(EventKind::TaskBegan { mission, role, task }) => acts(mission, role, &format!("begins {task}")),
            Some(EventKind::Sent { mission, signal }) => {
                acts(mission, &signal.from, &format!("sends {:?} of {}", signal.kind, signal.task))
            }
            Some(EventKind::Received { mission, signal }) => {
                acts(mission, &signal.to, &format!("goes on after {:?} of {}", signal.kind, signal.task))
            }
            _ => Ok(()),
        }
    }

    fn observe_world(&mut self, at: Duration, entry: &LoggedEvent, fleet: &Fleet) -> Result<(), InvariantViolation> {
        match &entry.event {
            InWorld::GoalStarted { robot, id, goal } => {
                let node = NodeId::from(robot.clone());
                let charging = fleet.knowledge_of(robot.as_str(), &node).and_then(|record| record.charging);
                self.pursues(at, &node, id.0, goal, matches!(charging, Some(Charging::Leaving { .. })));
            }
            InWorld::GoalEnded { robot, id, .. } => {
                self.at_work.remove(&(robot.to_string(), id.0));
            }
            InWorld::Stranded { robot } => self.at_work.retain(|(who, _), _| who != robot.as_str()),
            InWorld::DrawerMoved { .. }
            | InWorld::Approached { .. }
            | InWorld::MissionCanceled { .. }
            | InWorld::HandoverDeclined { .. }
            | InWorld::PersonLeft { .. }
            | InWorld::PersonReturned { .. }
            | InWorld::HandoverStarted { .. }
            | InWorld::SampleMoved { .. }
            | InWorld::SampleCreated { .. }
            | InWorld::SampleConsumed { .. }
            | InWorld::DoorRequested { .. }
            | InWorld::DoorEntered { .. }
            | InWorld::DoorLeft { .. }
            | InWorld::DoorMoved { .. }
            | InWorld::LiftRequested { .. }
            | InWorld::LiftEntered { .. }
            | InWorld::LiftLeft { .. }
            | InWorld::LaneBlocked { .. }
            | InWorld::LaneCleared { .. }
            | InWorld::Docked { .. }
            | InWorld::Collided { .. } => {}
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::pose::Pose;
    use consort_skills::actions::Dock;

    #[test]
    fn roles_of_people_are_known_while_all_nodes_are_down() {
        let (mut state, node) = (UnderLease::default(), NodeId::new("garnet").unwrap());
        let mission: MissionId = "rounds-1".parse().unwrap();
        let part = |role: &str| (mission.clone(), RoleId::new(role).unwrap());
        let roles = [(part("nurse").1, RoleKind::Unmanaged), (part("r1").1, RoleKind::Managed)];
        assert!(state.acts(&node, part("nurse"), "begins it", true, Some(BTreeMap::from(roles))).is_ok());
        assert!(state.acts(&node, part("nurse"), "goes on", true, None).is_ok());
        let violation = state.acts(&node, part("r1"), "goes on", true, None).unwrap_err();
        assert_eq!(violation.0, "garnet goes on as r1 of rounds-1, in which it is not active");
    }

    #[test]
    fn a_drive_to_an_assembly_place_belongs_to_a_role_only_while_the_robot_has_it() {
        let (garnet, hazel) = (NodeId::new("garnet").unwrap(), NodeId::new("hazel").unwrap());
        let part: Part = ("rounds-1".parse().unwrap(), RoleId::new("r1").unwrap());
        let drive = Goal::from(NavigateToPose::to(Pose::new(0.0, 0.0, 0.0), None));
        let secs = Duration::from_secs;
        // Garnet begins the role, and loses it or not; it drives at 100 s, and hazel begins the role.
        let begins = |alarm_at: Option<Duration>, is_active: bool, goal: &Goal| {
            let mut state = UnderLease { alarm_at, ..UnderLease::default() };
            assert_eq!(state.begins(&garnet, part.clone()), Ok(()));
            if !is_active {
                state.active.clear();
            }
            state.pursues(secs(100), &garnet, 7, goal, false);
            state.begins(&hazel, part.clone())
        };
        assert!(begins(None, false, &drive).is_err(), "there is no alarm");
        assert!(begins(Some(secs(39)), false, &drive).is_err(), "the alarm is over");
        assert_eq!(begins(Some(secs(40)), false, &drive), Ok(()));
        assert!(begins(Some(secs(100)), true, &drive).is_err(), "it drives in its role");
        assert!(begins(Some(secs(100)), false, &Dock { charger: None }.into()).is_err(), "it does not drive");
    }

    #[test]
    fn a_drive_to_an_assembly_place_outlasts_its_role() {
        let (garnet, hazel) = (NodeId::new("garnet").unwrap(), NodeId::new("hazel").unwrap());
        let part: Part = ("rounds-1".parse().unwrap(), RoleId::new("r1").unwrap());
        let drive = Goal::from(NavigateToPose::to(Pose::new(0.0, 0.0, 0.0), None));
        let dock = Goal::from(Dock { charger: None });
        let secs = Duration::from_secs;
        // Garnet pursues a goal in its role, and ends the role at 100 s; hazel begins the role.
        let begins = |alarm_at: Option<Duration>, goal: &Goal| {
            let mut state = UnderLease { alarm_at, ..UnderLease::default() };
            assert_eq!(state.begins(&garnet, part.clone()), Ok(()));
            state.pursues(secs(90), &garnet, 7, goal, false);
            state.ends(secs(100), &garnet, &part);
            state.begins(&hazel, part.clone())
        };
        assert!(begins(None, &drive).is_err(), "it drives on in its role");
        assert_eq!(begins(Some(secs(100)), &drive), Ok(()), "it drives to an assembly place");
        assert!(begins(Some(secs(100)), &dock).is_err());
    }

    #[test]
    fn a_robot_that_has_ended_a_role_charges_without_it() {
        let (garnet, hazel) = (NodeId::new("garnet").unwrap(), NodeId::new("hazel").unwrap());
        let part: Part = ("rounds-1".parse().unwrap(), RoleId::new("r1").unwrap());
        let dock = Goal::from(Dock { charger: None });
        // Garnet ends the role at 100 s or not, and begins a goal; hazel begins the role.
        let begins = |ends: bool, goal_at_ms: u64| {
            let mut state = UnderLease::default();
            assert_eq!(state.begins(&garnet, part.clone()), Ok(()));
            if ends {
                state.ends(Duration::from_secs(100), &garnet, &part);
            }
            state.pursues(Duration::from_millis(goal_at_ms), &garnet, 7, &dock, false);
            state.begins(&hazel, part.clone())
        };
        assert_eq!(begins(true, 101_600), Ok(()));
        assert!(begins(true, 101_500).is_err(), "the goal was on its way");
        assert!(begins(false, 101_600).is_err(), "it has not ended its role");
    }

    /// A robot was paused in its role at a charger for which another robot waited meanwhile. It received the end of the role
    /// and made room at once, and the next robot began the role during this drive.
    #[test]
    fn a_robot_that_has_ended_a_role_makes_room_at_a_charger() {
        let (indigo, hazel) = (NodeId::new("indigo").unwrap(), NodeId::new("hazel").unwrap());
        let part: Part = ("rounds-1".parse().unwrap(), RoleId::new("r1").unwrap());
        let drive = Goal::from(NavigateToPose::to(Pose::new(0.0, 0.0, 0.0), None));
        let begins = |ends: bool, goal: &Goal, leaves: bool| {
            let mut state = UnderLease::default();
            assert_eq!(state.begins(&indigo, part.clone()), Ok(()));
            if ends {
                state.ends(Duration::from_millis(47_607), &indigo, &part);
            }
            state.pursues(Duration::from_millis(47_720), &indigo, 7, goal, leaves);
            state.begins(&hazel, part.clone())
        };
        assert_eq!(begins(true, &drive, true), Ok(()));
        assert!(begins(true, &drive, false).is_err(), "a drive of its role was on its way");
        assert!(begins(false, &drive, true).is_err(), "it has not ended its role");
        assert!(begins(true, &Dock { charger: None }.into(), true).is_err(), "it does not drive");
    }
}
