//! Promises: roles that robots get later.
//!
//! An auction may promise a role to a robot that holds a role of another mission. The other roles of the mission
//! start meanwhile. The coordinator awards a promised role once its robot holds no other role and a step
//! of its plan is possible. So a robot holds a role while its tasks run, and not while it would wait for others.
//!
//! A robot that only waits in a role returns it for a promised role that can start, and the returned role
//! becomes a promise (it is *postponed*).
//!
//! A mission waits for the missions that hold the robots of its promises. The ledger rejects an award or a
//! promise that would close a cycle of such waits. Without a cycle there is always a mission that waits for
//! nobody, and a free robot always has a promise that can be awarded to it, so missions cannot block each other.

use super::apply::Ledger;
use super::command::{CommandError, CommandOutcome};
use super::entry::{MissionEntry, RoleAssignment, RoleEntry, RolePhase};
use crate::ids::{MissionId, RobotId, RoleId};
use crate::lease::Epoch;
use crate::mission::RoleKind;
use crate::plan::{Signal, Step, StepAction, StepIndex};
use crate::units::Seconds;
use std::collections::{BTreeMap, BTreeSet};

/// Waits between missions.
struct Waits<'a> {
    /// The mission that holds each robot.
    held: BTreeMap<&'a RobotId, &'a MissionId>,
    /// The robots of the promises of each mission.
    promised: BTreeMap<&'a MissionId, BTreeSet<&'a RobotId>>,
}

impl<'a> Waits<'a> {
    fn of(ledger: &'a Ledger) -> Waits<'a> {
        let mut waits = Waits { held: BTreeMap::new(), promised: BTreeMap::new() };
        for entry in ledger.missions().filter(|entry| !entry.state.is_final()) {
            for (_, role, holder) in entry.assigned_roles() {
                waits.add(&entry.id, &holder.robot, role.phase == RolePhase::Promised);
            }
        }
        waits
    }

    /// Adds a role of a mission, which the robot holds or is promised.
    fn add(&mut self, mission: &'a MissionId, robot: &'a RobotId, promised: bool) {
        if promised {
            self.promised.entry(mission).or_default().insert(robot);
        } else {
            self.held.insert(robot, mission);
        }
    }

    /// Checks whether a mission waits for itself.
    fn contain_cycle_of(&self, mission: &MissionId) -> bool {
        let (mut seen, mut open) = (BTreeSet::new(), vec![mission]);
        while let Some(waiting) = open.pop() {
            let robots = self.promised.get(waiting).into_iter().flatten();
            for other in robots.filter_map(|robot| self.held.get(robot)).filter(|other| **other != waiting) {
                if *other == mission {
                    return true;
                }
                if seen.insert(*other) {
                    open.push(other);
                }
            }
        }
        false
    }
}

impl MissionEntry {
    /// Returns the roles that robots hold now or are promised, with their entries and robots.
    pub fn assigned_roles(&self) -> impl Iterator<Item = (&RoleId, &RoleEntry, &RoleAssignment)> {
        let phases = [RolePhase::Promised, RolePhase::Awarded, RolePhase::Active];
        let assigned = self.roles.iter().filter(move |(_, role)| phases.contains(&role.phase));
        assigned.filter_map(|(id, role)| Some((id, role, role.holder.as_ref()?)))
    }

    /// Returns the promised roles, with their robots.
    pub fn promised_roles(&self) -> impl Iterator<Item = (&RoleId, &RoleAssignment)> {
        let promised = self.assigned_roles().filter(|(_, role, _)| role.phase == RolePhase::Promised);
        promised.map(|(id, _, robot)| (id, robot))
    }

    /// Checks whether the holder of a role could perform a step of it now, according to the ended steps. Signals
    /// of people count as sent: a task of a person may wait for the holder of the role.
    pub fn can_proceed(&self, role: &RoleId) -> bool {
        let (Some(plan), Some(entry)) = (self.plan(role), self.roles.get(role)) else { return true };
        let sent = self.signals_to(role);
        let is_of_person = |role: &RoleId| self.roles.get(role).is_some_and(|entry| entry.kind == RoleKind::Unmanaged);
        let has_arrived = |signal: &Signal| sent.contains(signal) || is_of_person(&signal.from);
        let mut passed = vec![false; plan.steps.len()];
        let is_enabled = |step: &Step, passed: &[bool]| {
            step.after.iter().all(|before| passed.get(*before as usize).copied().unwrap_or(false))
        };
        // Steps follow the steps that they depend on, so a single pass is enough.
        for (index, step) in plan.steps.iter().enumerate() {
            match &step.action {
                _ if entry.ended.contains(&(index as StepIndex)) => passed[index] = true,
                StepAction::Wait(signal) => passed[index] = has_arrived(signal) && is_enabled(step, &passed),
                StepAction::Task { .. } | StepAction::Send(_) if is_enabled(step, &passed) => return true,
                StepAction::Task { .. } | StepAction::Send(_) => {}
            }
        }
        passed.into_iter().all(|passed| passed)
    }
}

impl Ledger {
    /// Checks whether a mission with these robots would wait for itself.
    pub fn would_wait_circularly(
        &self,
        mission: &MissionId,
        holders: &BTreeMap<RoleId, RobotId>,
        promised: &BTreeMap<RoleId, Seconds>,
    ) -> bool {
        let mut waits = Waits::of(self);
        for (role, robot) in holders {
            waits.add(mission, robot, promised.contains_key(role));
        }
        waits.contain_cycle_of(mission)
    }

    /// Checks that a promised role can be awarded to its robot, which then holds no other role.
    ///
    /// # Errors
    /// [`CommandError`] states the reason.
    pub fn check_promise(&self, mission: &MissionId, role: &RoleId, epoch: Epoch) -> Result<(), CommandError> {
        let not_promised = || CommandError::NotPromised { mission: mission.clone(), role: role.clone() };
        let entry = self.mission(mission).ok_or_else(|| self.no_mission(mission))?;
        let (_, robot) = entry.promised_roles().find(|(id, _)| *id == role).ok_or_else(not_promised)?;
        if entry.state.is_final() || robot.epoch != epoch {
            return Err(not_promised());
        }
        self.check_free(mission, &robot.robot)?;
        let mut waits = Waits::of(self);
        waits.add(mission, &robot.robot, false);
        match waits.contain_cycle_of(mission) {
            true => Err(CommandError::CircularWait { mission: mission.clone() }),
            false => Ok(()),
        }
    }

    pub(super) fn award_promised(
        &mut self,
        mission: &MissionId,
        role: &RoleId,
        epoch: Epoch,
        at: Epoch,
    ) -> Result<CommandOutcome, CommandError> {
        self.check_promise(mission, role, epoch)?;
        let not_promised = || CommandError::NotPromised { mission: mission.clone(), role: role.clone() };
        let role = self.active_mission(mission)?.roles.get_mut(role).ok_or_else(not_promised)?;
        role.phase = RolePhase::Awarded;
        if let Some(holder) = &mut role.holder {
            holder.epoch = at;
        }
        Ok(CommandOutcome::Awarded { epoch: at })
    }

    pub(super) fn postpone(
        &mut self,
        mission: &MissionId,
        role_id: &RoleId,
        epoch: Epoch,
    ) -> Result<CommandOutcome, CommandError> {
        let can_proceed = self.active_mission(mission)?.can_proceed(role_id);
        let role = self.held_role(mission, role_id, epoch)?;
        let is_held = role.kind == RoleKind::Managed && role.phase != RolePhase::Ended;
        if can_proceed || !is_held || !role.ended.is_empty() {
            return Err(CommandError::CanStart { mission: mission.clone(), role: role_id.clone() });
        }
        role.phase = RolePhase::Promised;
        if let Some(holder) = &mut role.holder {
            holder.incarnation = None;
        }
        Ok(CommandOutcome::Done)
    }

    /// Checks that a robot holds no role and has no item of another mission.
    pub(super) fn check_free(&self, mission: &MissionId, robot: &RobotId) -> Result<(), CommandError> {
        if let Some((held, role, _)) = self.held_by(robot) {
            let (robot, mission, role) = (robot.clone(), held.id.clone(), role.clone());
            return Err(CommandError::TwoRoles { robot, mission, role });
        }
        self.check_carries_nothing(mission, robot)
    }

    /// Checks that a robot has no item of another mission.
    pub(super) fn check_carries_nothing(&self, mission: &MissionId, robot: &RobotId) -> Result<(), CommandError> {
        let mut others = self.held_items().filter(|(entry, _)| entry.id != *mission);
        match others.find(|(_, held_item)| held_item.robot == *robot) {
            None => Ok(()),
            Some((entry, held_item)) => {
                let (robot, item, mission) = (robot.clone(), held_item.item, entry.id.clone());
                Err(CommandError::CarriesItem { robot, item, mission })
            }
        }
    }
}

#[cfg(test)]
mod tests;
