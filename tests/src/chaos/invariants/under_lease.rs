//! A robot does nothing in a role after its lease has ended.
//!
//! There are two parts. A robot begins tasks, sends signals and passes waits only while it is
//! active in the role. And when a robot begins a role, the simulated robot of the previous holder
//! is at rest. This is checked in the world, where messages in flight no longer matter.

use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId, RoleId};
use consort_protocol::ledger::Ledger;
use consort_protocol::mission::RoleKind;
use consort_world::world::{LoggedEvent, WorldEvent as InWorld};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

type Part = (MissionId, RoleId);

#[derive(Default)]
pub(super) struct UnderLease {
    active: BTreeSet<(NodeId, Part)>,
    /// Latest role of each robot.
    last: BTreeMap<String, Part>,
    /// Active goals in the world, with the role they were begun for.
    at_work: BTreeMap<(String, u64), Option<Part>>,
}

impl UnderLease {
    fn acts(
        &self,
        node: &NodeId,
        mission: &MissionId,
        role: &RoleId,
        what: &str,
        fleet: &Fleet,
    ) -> Result<(), InvariantViolation> {
        // The coordinator, on any node, acts in the roles of people.
        let kind = |ledger: &Ledger| Some(ledger.mission(mission)?.roles.get(role)?.kind);
        let of_robot = fleet.ledger(kind).flatten() != Some(RoleKind::Unmanaged);
        if of_robot && fleet.is_robot(node) && !self.active.contains(&(node.clone(), (mission.clone(), role.clone()))) {
            return Err(format!("{node} {what} as {role} of {mission}, in which it is not active").into());
        }
        Ok(())
    }

    fn begins(&mut self, node: &NodeId, part: Part) -> Result<(), InvariantViolation> {
        let (mission, role) = &part;
        let other = self.at_work.iter().find(|((robot, _), of)| robot != node.as_str() && of.as_ref() == Some(&part));
        if let Some(((robot, goal), _)) = other {
            return Err(
                format!("{node} begins {role} of {mission} while {robot} still pursues goal {goal} for it").into()
            );
        }
        self.last.insert(node.to_string(), part.clone());
        self.active.insert((node.clone(), part));
        Ok(())
    }
}

impl Invariant for UnderLease {
    fn name(&self) -> &'static str {
        "under_lease"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, fleet: &Fleet) -> Result<(), InvariantViolation> {
        let node = entry.node();
        if let Observation::TestAction { action: "killed" | "ended", .. } = entry {
            self.active.retain(|(who, _)| who != node);
        }
        match entry.event_kind() {
            Some(EventKind::Started { mission, role, .. } | EventKind::Resumed { mission, role }) => {
                self.begins(node, (mission.clone(), role.clone()))
            }
            Some(
                EventKind::Suspended { mission, role }
                | EventKind::GaveUp { mission, role, .. }
                | EventKind::TaskFailed { mission, role, .. }
                | EventKind::Halted { mission, role, .. },
            ) => {
                self.active.remove(&(node.clone(), (mission.clone(), role.clone())));
                Ok(())
            }
            Some(EventKind::TaskBegan { mission, role, task }) => {
                self.acts(node, mission, role, &format!("begins {task}"), fleet)
            }
            Some(EventKind::Sent { mission, signal }) => {
                self.acts(node, mission, &signal.from, &format!("sends {:?} of {}", signal.kind, signal.task), fleet)
            }
            Some(EventKind::Received { mission, signal }) => self.acts(
                node,
                mission,
                &signal.to,
                &format!("goes on after {:?} of {}", signal.kind, signal.task),
                fleet,
            ),
            _ => Ok(()),
        }
    }

    fn observe_world(&mut self, _: Duration, entry: &LoggedEvent, _: &Fleet) -> Result<(), InvariantViolation> {
        match &entry.event {
            InWorld::GoalStarted { robot, id, .. } => {
                self.at_work.insert((robot.to_string(), id.0), self.last.get(robot.as_str()).cloned());
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
