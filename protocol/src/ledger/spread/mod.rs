//! Roles of spread loops: robots get them one by one, while the mission runs.
//!
//! The iterations of a spread loop are unordered, but a role outside the loop may order them: joint tasks that
//! share a role follow the order of the file. A robot in a later iteration waits for the earlier iteration. If it
//! is the only free robot, the earlier iteration must have a robot before it, or both wait for ever. So an iteration
//! is auctioned after the iterations that it waits for. If the robot of an earlier iteration is lost later, a robot that
//! only waits for it returns its own iteration, as long as no other role has been signalled about it.

use super::apply::Ledger;
use super::entry::{MissionEntry, RoleAssignment};
use crate::auction::AuctionEntry;
use crate::ids::{RobotId, RoleId};
use crate::plan::{LocalPlan, Signal, StepAction, StepIndex};
use std::collections::{BTreeMap, BTreeSet};

impl MissionEntry {
    /// Checks whether the role belongs to a spread loop. It may stay open while other roles are held.
    pub fn is_spread(&self, role: &RoleId) -> bool {
        self.mission().roles.get(role).is_some_and(|role| role.spread)
    }

    /// Returns the open roles to be auctioned now: all, unless some belong to a spread loop. Then roles that wait
    /// for others are left out, because the robots are needed for the loop, and so are iterations that cannot end
    /// before an open iteration.
    pub fn roles_to_auction(&self) -> BTreeSet<RoleId> {
        let mut roles = self.open_roles();
        let spread: BTreeSet<RoleId> = roles.iter().filter(|role| self.is_spread(role)).cloned().collect();
        if spread.is_empty() {
            return roles;
        }
        roles.retain(|role| self.can_proceed(role));
        let later = self.later_iterations(&spread);
        // Iterations that wait for each other in a circle have no first.
        if roles.iter().any(|role| spread.contains(role) && !later.contains(role)) {
            roles.retain(|role| !later.contains(role));
        }
        roles
    }

    /// Checks whether robots can be assigned to these roles together.
    pub(super) fn may_be_awarded(&self, roles: &BTreeSet<RoleId>) -> bool {
        let open = self.open_roles();
        match open.iter().any(|role| self.is_spread(role)) {
            true => !roles.is_empty() && roles.is_subset(&open),
            false => !roles.is_empty() && *roles == open,
        }
    }

    /// Checks whether another robot can do a held role from its start: no other role has been signalled about it, and its
    /// robot has no item in it.
    fn can_be_restarted(&self, role: &RoleId) -> bool {
        !self.has_signalled(role) && self.custody().iter().all(|held| held.role != *role)
    }

    /// Returns those of these roles that wait for another of them, which does not wait for them.
    fn later_iterations(&self, roles: &BTreeSet<RoleId>) -> BTreeSet<RoleId> {
        let waits = StepWaits::of(self);
        let awaited: BTreeMap<&RoleId, BTreeSet<&RoleId>> =
            roles.iter().map(|role| (role, waits.roles_before(role))).collect();
        let is_later = |role: &&RoleId| {
            let earlier = awaited[*role].iter().filter(|earlier| *earlier != role);
            earlier.filter_map(|earlier| awaited.get(*earlier)).any(|before| !before.contains(*role))
        };
        roles.iter().filter(is_later).cloned().collect()
    }
}

impl Ledger {
    /// Returns the iteration of a spread loop that its robot should return, since it only waits for an open iteration and
    /// the auction of that found no free robot: of several the one that waits for most roles. `None` while a robot that
    /// was busy then is free: it is asked first.
    pub fn iteration_to_return<'m>(&self, entry: &'m MissionEntry) -> Option<(&'m RoleId, &'m RoleAssignment)> {
        let auction = entry.auction.as_ref().filter(|auction| auction.failure.is_some())?;
        let mut open = entry.roles_to_auction();
        open.retain(|role| entry.is_spread(role));
        let busy = auction.entries.iter().filter(|entry| open.contains(&entry.role) && entry.is_busy());
        let busy: BTreeSet<&RobotId> = busy.flat_map(AuctionEntry::robots).collect();
        if busy.is_empty() {
            return None;
        }
        let waits = StepWaits::of(entry);
        let waits_for_open = |role: &RoleId| {
            let before = waits.roles_before(role);
            open.iter().any(|earlier| before.contains(earlier) && !waits.roles_before(earlier).contains(role))
        };
        let returnable = entry.held_roles().filter(|(role, _, holder)| {
            let is_candidate = busy.contains(&holder.robot) && entry.is_spread(role) && !entry.can_proceed(role);
            is_candidate && entry.can_be_restarted(role) && waits_for_open(role)
        });
        let (role, _, holder) = returnable.max_by_key(|(role, ..)| waits.roles_before(role).len())?;
        busy.into_iter().all(|robot| self.held_by(robot).is_some()).then_some((role, holder))
    }
}

/// Steps of a mission that have not ended, and the steps that they wait for.
struct StepWaits<'m> {
    plans: BTreeMap<&'m RoleId, (&'m LocalPlan, &'m BTreeSet<StepIndex>)>,
    /// Step that sends each signal.
    sends: BTreeMap<&'m Signal, (&'m RoleId, StepIndex)>,
}

impl<'m> StepWaits<'m> {
    fn of(entry: &'m MissionEntry) -> StepWaits<'m> {
        let plans = entry.roles.iter().filter_map(|(id, role)| Some((id, (entry.plan(id)?, &role.ended))));
        let plans: BTreeMap<_, _> = plans.collect();
        let sends = plans.iter().flat_map(|(role, (plan, _))| {
            (0..).zip(&plan.steps).filter_map(move |(index, step)| match &step.action {
                StepAction::Send(signal) => Some((signal, (*role, index))),
                StepAction::Task { .. } | StepAction::Wait(_) => None,
            })
        });
        StepWaits { sends: sends.collect(), plans }
    }

    /// Returns the roles with steps that must end before the role ends.
    fn roles_before(&self, role: &RoleId) -> BTreeSet<&'m RoleId> {
        let own = self.plans.get_key_value(role).into_iter();
        let own = own.flat_map(|(id, (plan, _))| (0..).zip(&plan.steps).map(move |(index, _)| (*id, index)));
        let mut open: Vec<(&RoleId, StepIndex)> = own.collect();
        let mut seen = BTreeSet::new();
        while let Some((id, index)) = open.pop() {
            let Some((plan, ended)) = self.plans.get(id) else { continue };
            let Some(step) = plan.steps.get(index as usize).filter(|_| !ended.contains(&index)) else { continue };
            if !seen.insert((id, index)) {
                continue;
            }
            open.extend(step.after.iter().map(|before| (id, *before)));
            if let StepAction::Wait(signal) = &step.action {
                open.extend(self.sends.get(signal).copied());
            }
        }
        seen.into_iter().map(|(id, _)| id).collect()
    }
}

#[cfg(test)]
mod tests;
