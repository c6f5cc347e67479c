//! Orders of people about roles: reassignments and pins.
//!
//! ```text
//! held role ──── reassign ─▶ its robot returns it at rest ─▶ open ─▶ awarded to another robot, or to the named robot
//! promised role ─ reassign ─▶ open ─▶ …
//! role that waits ── pin ───▶ only the named robot gets it, in each award
//! ```
//!
//! A role is not reassigned if its robot has, or may have, an item in it, or if other roles have acted on its work. The
//! next robot starts the role from its beginning, so a role with ended tasks is reassigned only if the person permits
//! their repetition. If that becomes true while the robot has not returned the role yet, the reassignment ends.
//!
//! A reassignment holds until a robot is awarded the role: a promise of the role moves only to robots that may get it.

use super::apply::Ledger;
use super::command::ReleaseCause;
use super::command_error::CommandError;
use super::entry::{MissionEntry, RoleAssignment, RolePhase};
use super::mission_order::{ReassignProblem, RoleOrder, RoleReturn};
use crate::auction::RobotRestriction;
use crate::ids::{MissionId, RobotId, RoleId, TaskId};
use crate::mission::RoleKind;
use crate::plan::StepAction;
use std::collections::BTreeMap;

impl MissionEntry {
    /// Returns the orders of people about roles.
    pub fn role_orders(&self) -> &BTreeMap<RoleId, RoleOrder> {
        &self.role_orders
    }

    /// Returns the restrictions of roles to robots.
    pub fn restrictions(&self) -> BTreeMap<RoleId, RobotRestriction> {
        self.role_orders.iter().map(|(role, order)| (role.clone(), order.restriction.clone())).collect()
    }

    /// Returns the held roles that their robots should return.
    pub fn roles_to_return(&self) -> impl Iterator<Item = (&RoleId, &RoleAssignment, &RoleReturn)> {
        self.held_roles().filter_map(move |(id, _, holder)| {
            let pending = self.role_orders.get(id)?.pending.as_ref()?;
            (pending.epoch == holder.epoch).then_some((id, holder, pending))
        })
    }

    /// Returns the reason for which another robot cannot do a held role from its start.
    fn return_problem(&self, role: &RoleId, repeat: bool) -> Option<ReassignProblem> {
        if let Some(held) = self.custody().into_iter().find(|held| held.role == *role) {
            return Some(ReassignProblem::Custody { robot: held.robot, item: held.item });
        }
        if self.has_signalled(role) {
            return Some(ReassignProblem::ActedUpon);
        }
        let tasks = self.ended_tasks(role);
        (!repeat && !tasks.is_empty()).then_some(ReassignProblem::TasksEnded { tasks })
    }

    fn ended_tasks(&self, role: &RoleId) -> Vec<TaskId> {
        let (Some(plan), Some(entry)) = (self.plan(role), self.roles.get(role)) else { return vec![] };
        let ended = entry.ended.iter().filter_map(|step| plan.steps.get(*step as usize));
        let tasks = ended.filter_map(|step| match &step.action {
            StepAction::Task { id, .. } => Some(id.clone()),
            StepAction::Send(_) | StepAction::Wait(_) => None,
        });
        tasks.collect()
    }

    /// Ends the returns that have taken place, and the reassignments of roles that can no longer be returned.
    pub(super) fn follow_role_orders(&mut self) {
        let mut orders = std::mem::take(&mut self.role_orders);
        orders.retain(|role, order| {
            let Some(pending) = &order.pending else { return true };
            if self.held_roles().any(|(id, _, holder)| id == role && holder.epoch == pending.epoch) {
                return self.return_problem(role, pending.repeat).is_none();
            }
            order.pending = None;
            self.roles.get(role).is_some_and(|role| role.phase != RolePhase::Ended)
        });
        self.role_orders = orders;
    }

    /// Ends the restrictions for the next award of these roles, which robots get now.
    pub(super) fn end_next_restrictions<'a>(&mut self, awarded: impl Iterator<Item = &'a RoleId>) {
        for role in awarded {
            if self.role_orders.get(role).is_some_and(|order| !order.restriction.outlasts_awards()) {
                self.role_orders.remove(role);
            }
        }
    }

    /// Checks that the order of a person does not keep a robot from a role.
    pub(super) fn check_permitted(&self, role: &RoleId, robot: &RobotId) -> Result<(), CommandError> {
        match self.role_orders.get(role).map(|order| &order.restriction) {
            Some(restriction) if !restriction.permits(robot) => Err(CommandError::NotPermitted {
                mission: self.id.clone(),
                role: role.clone(),
                robot: robot.clone(),
                restriction: restriction.clone(),
            }),
            Some(_) | None => Ok(()),
        }
    }

    /// Checks whether the robot of a role should return it.
    pub(super) fn is_returned(&self, role: &RoleId) -> bool {
        self.roles_to_return().any(|(id, ..)| id == role)
    }
}

impl Ledger {
    /// Gives a role to another robot.
    pub(super) fn reassign(
        &mut self,
        mission: &MissionId,
        role: &RoleId,
        to: Option<&RobotId>,
        (repeat, by): (bool, &str),
    ) -> Result<(), CommandError> {
        let rejected = |problem| CommandError::CannotReassign { mission: mission.clone(), role: role.clone(), problem };
        let (phase, holder) = self.role_to_change(mission, role, to)?;
        if let Some(robot) = to {
            self.check_takes_roles(robot)?;
            self.check_carries_nothing(mission, robot)?;
        }
        let (restriction, pending) = match (phase, holder) {
            (RolePhase::Open, _) | (_, None) => match to {
                Some(robot) => (RobotRestriction::Next(robot.clone()), None),
                None => return Err(rejected(ReassignProblem::NoHolder)),
            },
            (_, Some(RoleAssignment { robot, .. })) if to == Some(&robot) => {
                return Err(rejected(ReassignProblem::SameRobot { robot }));
            }
            (_, Some(RoleAssignment { robot, epoch, .. })) => {
                let restriction = to.cloned().map_or(RobotRestriction::Except(robot), RobotRestriction::Next);
                if phase == RolePhase::Promised {
                    self.release_promise(mission, role, by)?;
                    (restriction, None)
                } else if let Some(problem) = self.active_mission(mission)?.return_problem(role, repeat) {
                    return Err(rejected(problem));
                } else {
                    (restriction, Some(RoleReturn { epoch, repeat, by: by.to_owned() }))
                }
            }
        };
        self.active_mission(mission)?.role_orders.insert(role.clone(), RoleOrder { restriction, pending });
        Ok(())
    }

    /// Restricts a role to a robot; without one, ends the order about the role.
    pub(super) fn pin(
        &mut self,
        mission: &MissionId,
        role: &RoleId,
        robot: Option<&RobotId>,
        by: &str,
    ) -> Result<(), CommandError> {
        let (phase, holder) = self.role_to_change(mission, role, robot)?;
        let Some(robot) = robot else {
            self.active_mission(mission)?.role_orders.remove(role);
            return Ok(());
        };
        if let Some(holder) = holder.filter(|holder| holder.robot != *robot) {
            if phase != RolePhase::Promised {
                let problem = ReassignProblem::Held { robot: holder.robot };
                return Err(CommandError::CannotReassign { mission: mission.clone(), role: role.clone(), problem });
            }
            self.release_promise(mission, role, by)?;
        }
        let order = RoleOrder { restriction: RobotRestriction::Pinned(robot.clone()), pending: None };
        self.active_mission(mission)?.role_orders.insert(role.clone(), order);
        Ok(())
    }

    /// Returns the phase and the robot of a role that has not ended. `robot`, which should get it, has no other role of the
    /// mission.
    fn role_to_change(
        &mut self,
        mission: &MissionId,
        id: &RoleId,
        robot: Option<&RobotId>,
    ) -> Result<(RolePhase, Option<RoleAssignment>), CommandError> {
        let rejected = |problem| CommandError::CannotReassign { mission: mission.clone(), role: id.clone(), problem };
        let entry = self.active_mission(mission)?;
        let Some(role) = entry.roles.get(id) else {
            return Err(CommandError::NoRole { mission: mission.clone(), role: id.clone() });
        };
        if role.kind == RoleKind::Unmanaged {
            return Err(rejected(ReassignProblem::People));
        }
        if role.phase == RolePhase::Ended {
            return Err(rejected(ReassignProblem::Ended));
        }
        if let Some(robot) = robot
            && let Some((other, ..)) =
                entry.assigned_roles().find(|(other, _, holder)| *other != id && holder.robot == *robot)
        {
            let (robot, mission, role) = (robot.clone(), mission.clone(), other.clone());
            return Err(CommandError::TwoRoles { robot, mission, role });
        }
        Ok((role.phase, role.holder.as_deref().cloned()))
    }

    /// Opens a promised role again, unless others have acted on the promise.
    fn release_promise(&mut self, mission: &MissionId, role: &RoleId, by: &str) -> Result<(), CommandError> {
        let entry = self.active_mission(mission)?;
        let Some(epoch) = entry.promised_roles().find(|(id, _)| *id == role).map(|(_, promise)| promise.epoch) else {
            return Err(CommandError::NotPromised { mission: mission.clone(), role: role.clone() });
        };
        if entry.has_signalled(role) {
            return Err(CommandError::ActedOn { mission: mission.clone(), role: role.clone() });
        }
        let cause = format!("reassigned by {by}");
        let cause = ReleaseCause { cause, class: None, moved_nothing: true, place: None, gave_way: true };
        self.release(mission, role, epoch, &cause).map(drop)
    }
}

#[cfg(test)]
mod tests;
