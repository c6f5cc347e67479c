//! Nothing is done in a role under a lease that has ended.
//!
//! Two sides of it. A robot begins tasks, tells and passes waits only while it is active in the role. And when somebody
//! begins a role, the body of whoever had it before is at rest: in the world, where messages under way no longer count.

use super::Invariant;
use crate::{Entry, Fleet};
use consort_protocol::event::Happening;
use consort_protocol::ids::{MissionId, NodeId, RoleId};
use consort_sim::world::{Happening as InWorld, JournalEntry};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

type Part = (MissionId, RoleId);

#[derive(Default)]
pub(super) struct UnderLease {
    active: BTreeSet<(NodeId, Part)>,
    /// What each robot acted as last.
    last: BTreeMap<String, Part>,
    /// Goals under way in the world, and for which role they were begun.
    at_work: BTreeMap<(String, u64), Option<Part>>,
}

impl UnderLease {
    fn acts(&self, node: &NodeId, mission: &MissionId, role: &RoleId, what: &str, fleet: &Fleet) -> Result<(), String> {
        let managed = fleet.is_robot(node);
        if managed && !self.active.contains(&(node.clone(), (mission.clone(), role.clone()))) {
            return Err(format!("{node} {what} as {role} of {mission}, in which it is not active"));
        }
        Ok(())
    }

    fn begins(&mut self, node: &NodeId, part: Part) -> Result<(), String> {
        let (mission, role) = &part;
        let other = self.at_work.iter().find(|((robot, _), of)| robot != node.as_str() && of.as_ref() == Some(&part));
        if let Some(((robot, goal), _)) = other {
            return Err(format!("{node} begins {role} of {mission} while {robot} still pursues goal {goal} for it"));
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

    fn see(&mut self, _: Duration, entry: &Entry, fleet: &Fleet) -> Result<(), String> {
        let node = entry.node();
        if let Entry::Done { what: "killed", .. } = entry {
            self.active.retain(|(who, _)| who != node);
        }
        match entry.happening() {
            Some(Happening::Started { mission, role, .. } | Happening::Resumed { mission, role }) => {
                self.begins(node, (mission.clone(), role.clone()))
            }
            Some(Happening::Suspended { mission, role } | Happening::Halted { mission, role, .. }) => {
                self.active.remove(&(node.clone(), (mission.clone(), role.clone())));
                Ok(())
            }
            Some(Happening::TaskBegan { mission, role, task }) => {
                self.acts(node, mission, role, &format!("begins {task}"), fleet)
            }
            Some(Happening::Sent { mission, signal }) => {
                self.acts(node, mission, &signal.from, &format!("says {:?} of {}", signal.kind, signal.task), fleet)
            }
            Some(Happening::Heard { mission, signal }) => self.acts(
                node,
                mission,
                &signal.to,
                &format!("goes on after {:?} of {}", signal.kind, signal.task),
                fleet,
            ),
            _ => Ok(()),
        }
    }

    fn see_world(&mut self, _: Duration, entry: &JournalEntry, _: &Fleet) -> Result<(), String> {
        match &entry.what {
            InWorld::GoalBegan { robot, id, .. } => {
                self.at_work.insert((robot.to_string(), id.0), self.last.get(robot.as_str()).cloned());
            }
            InWorld::GoalEnded { robot, id, .. } => {
                self.at_work.remove(&(robot.to_string(), id.0));
            }
            InWorld::Stranded { robot } => self.at_work.retain(|(who, _), _| who != robot.as_str()),
            InWorld::Drawer { .. }
            | InWorld::Approached { .. }
            | InWorld::CalledOff { .. }
            | InWorld::Declined { .. }
            | InWorld::WalkedAway { .. }
            | InWorld::CameBack { .. }
            | InWorld::HandsOut { .. }
            | InWorld::SampleMoved { .. }
            | InWorld::DoorAwaited { .. }
            | InWorld::DoorEntered { .. }
            | InWorld::DoorLeft { .. }
            | InWorld::Door { .. }
            | InWorld::LiftAwaited { .. }
            | InWorld::LiftEntered { .. }
            | InWorld::LiftLeft { .. }
            | InWorld::WayClosed { .. }
            | InWorld::WayOpened { .. }
            | InWorld::Docked { .. }
            | InWorld::Collided { .. } => {}
        }
        Ok(())
    }
}
