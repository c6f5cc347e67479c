//! Consequences for a mission when a robot is lost, and when the mission fails, is canceled or is
//! closed.
//!
//! ```text
//! a role is released from its holder, which …
//!   has, or may have, an item ──────▶ the mission's recovery branch, else needs intervention
//!   has only cleanup left ──────────▶ the role has ended
//!   has found that no robot can ────▶ failed
//!   has signalled no other role ────▶ the role is open again       (also: `on_loss: restart`)
//!   has signalled other roles ──────▶ failed
//! in the recovery branch: the robot has an item that the branch moves ──▶ needs intervention; else as above,
//!   and the item that was lost first is still where it was
//! failed or canceled while a robot has, or may have, an item ──▶ needs intervention ── a person ──▶ failed
//! ```

use super::apply::Ledger;
use super::command::{CommandOutcome, ReleaseCause};
use super::command_error::CommandError;
use super::entry::{HeldItem, MissionEntry, MissionState, RoleEntry, RolePhase, RoleRelease};
use super::limits::CAUSE_BYTES_MAX;
use crate::bounds::limit_text;
use crate::cause::CauseClass;
use crate::ids::{MissionId, PlaceId, RobotId, RoleId};
use crate::lease::Epoch;
use crate::mission::{OnLoss, RoleKind};
use crate::plan::ItemMove;
use std::collections::BTreeMap;

/// Maximum number of releases from robots that had confirmed their roles and did not give way; then the mission fails.
/// Raised: a mission survives more losses, but a mission that no robot can complete occupies more
/// robots. Default: a guess.
const RELEASES_MAX: usize = 5;

impl Ledger {
    pub(super) fn release(
        &mut self,
        mission: &MissionId,
        role_id: &RoleId,
        epoch: Epoch,
        loss: &ReleaseCause,
    ) -> Result<CommandOutcome, CommandError> {
        let role = self.assigned_role(mission, role_id, epoch)?;
        if role.phase == RolePhase::Ended {
            return Ok(CommandOutcome::Done); // completed: it need not be repeated
        }
        let Some(robot) = role.holder.as_ref().map(|holder| holder.robot.clone()) else {
            return Ok(CommandOutcome::Done);
        };
        let confirmed = role.phase == RolePhase::Active;
        let ReleaseCause { cause, class, moved_nothing, place, gave_way } = loss;
        // A robot that was lost, or gave the role back, leaves it to another robot.
        let mission_class = class.unwrap_or(CauseClass::Robot);
        let has_limits = self.keeps_history();
        let entry = self.active_mission(mission)?;
        entry.add_release(RoleRelease {
            role: role_id.clone(),
            robot: robot.clone(),
            cause: cause.clone(),
            class: *class,
            confirmed,
            gave_way: *gave_way,
        });

        let undone: &dyn Fn(&ItemMove) -> bool =
            &|item_move| *moved_nothing && item_move.performers.iter().eq([role_id]);
        let places = place.iter().map(|place| (robot.clone(), place.clone())).collect();
        let held = in_places(entry.custody_without(undone), &places);
        let lost =
            held.iter().filter(|held| held.role == *role_id && held.robot == robot).min_by_key(|held| !held.certain);
        if let Some(lost) = lost.cloned() {
            if entry.recover(&lost, held.clone()) {
                return Ok(CommandOutcome::Done);
            }
            let has = if lost.certain { "has" } else { "may have" };
            let cause = format!("{robot} was lost as {role_id} and {has} the {}: {cause}", lost.item);
            entry.state = MissionState::NeedsIntervention { cause, items: held, class: mission_class };
            if has_limits {
                entry.state.limit_cause();
            }
            return Ok(CommandOutcome::Done);
        }
        if entry.only_cleanup_remains(role_id) {
            self.assigned_role(mission, role_id, epoch)?.phase = RolePhase::Ended;
            return self.complete_if_done(mission);
        }
        let on_loss = entry.mission().roles.get(role_id).map_or(OnLoss::Fail, |role| role.on_loss);
        if entry.has_signalled(role_id) && on_loss == OnLoss::Fail {
            let cause = format!("{robot} was lost as {role_id} after others had acted on its work: {cause}");
            return self.end(mission, MissionState::Failed { cause, class: mission_class }, &places, undone);
        }
        if *class == Some(CauseClass::Task) {
            let (cause, class) = (cause.clone(), mission_class);
            return self.end(mission, MissionState::Failed { cause, class }, &places, undone);
        }
        let counted: Vec<&RoleRelease> = entry.releases.iter().filter(|released| released.counts()).collect();
        if counted.len() >= RELEASES_MAX {
            let causes = counted.iter().map(|released| format!("{} ({})", released.cause, released.role));
            let causes = causes.collect::<Vec<_>>().join("; ");
            let cause = format!("its roles were given up {} times: {causes}", counted.len());
            return self.end(mission, MissionState::Failed { cause, class: mission_class }, &places, undone);
        }
        self.active_mission(mission)?.keep_energy_of(role_id);
        let role = self.assigned_role(mission, role_id, epoch)?;
        role.holder = None;
        role.phase = RolePhase::Open;
        role.ended.clear();
        let entry = self.active_mission(mission)?;
        entry.state = entry.active_state();
        Ok(CommandOutcome::Done)
    }

    /// Ends a mission in the given state. If a robot has an item, the mission needs intervention
    /// instead. The moves in `undone` have certainly not happened.
    pub(super) fn end(
        &mut self,
        mission: &MissionId,
        state: MissionState,
        places: &BTreeMap<RobotId, PlaceId>,
        undone: &dyn Fn(&ItemMove) -> bool,
    ) -> Result<CommandOutcome, CommandError> {
        let has_limits = self.keeps_history();
        let entry = self.active_mission(mission)?;
        let items = in_places(entry.custody_without(undone), places);
        let (cause, class) = match &state {
            MissionState::Failed { cause, class } => (cause.clone(), *class),
            // The same mission may succeed later.
            MissionState::Canceled { by } => (format!("canceled by {by}"), CauseClass::Transient),
            MissionState::Completed => ("completed".to_owned(), CauseClass::default()),
            MissionState::Pending | MissionState::Running | MissionState::NeedsIntervention { .. } => {
                (String::new(), CauseClass::default())
            }
        };
        entry.state = if items.is_empty() {
            state
        } else {
            MissionState::NeedsIntervention { cause: format!("{cause}; {}", custody_text(&items)), items, class }
        };
        if has_limits {
            entry.state.limit_cause();
        }
        self.record_end(mission);
        Ok(CommandOutcome::Done)
    }

    /// Cancels a mission. A mission that waits for a person keeps its state, since only a person on
    /// site can close it. A client that repeats the request, for lack of a reply, gets the same
    /// outcome.
    pub(super) fn cancel(
        &mut self,
        mission: &MissionId,
        by: String,
        places: &BTreeMap<RobotId, PlaceId>,
    ) -> Result<CommandOutcome, CommandError> {
        match self.mission_state(mission) {
            Some(MissionState::NeedsIntervention { .. }) => Ok(CommandOutcome::Done),
            Some(MissionState::Canceled { by: known }) if *known == by => Ok(CommandOutcome::Done),
            _ => self.end(mission, MissionState::Canceled { by }, places, &|_| false),
        }
    }

    pub(super) fn resolve(&mut self, mission: &MissionId, by: &str) -> Result<CommandOutcome, CommandError> {
        let has_limits = self.keeps_history();
        let Some(entry) = self.missions.get_mut(mission) else {
            return Err(self.no_mission(mission));
        };
        let closing = format!("; resolved by {by}");
        let (cause, class) = match &entry.state {
            MissionState::NeedsIntervention { cause, class, .. } => (cause, *class),
            // The request was repeated for lack of a reply.
            MissionState::Failed { cause, .. } if cause.ends_with(&closing) => return Ok(CommandOutcome::Done),
            state => {
                let state = state.as_str().to_owned();
                return Err(CommandError::NoInterventionNeeded { mission: mission.clone(), state });
            }
        };
        let mut cause = cause.clone();
        if has_limits {
            limit_text(&mut cause, CAUSE_BYTES_MAX.saturating_sub(closing.len()));
        }
        entry.state = MissionState::Failed { cause: format!("{cause}{closing}"), class };
        // Without a history, the end would drop the mission with the lowest number, perhaps this one.
        if has_limits {
            self.record_end(mission);
        }
        Ok(CommandOutcome::Done)
    }

    /// Completes a mission once all its roles have ended. If its recovery branch left an
    /// item in place, a person is still needed.
    pub(super) fn complete_if_done(&mut self, mission: &MissionId) -> Result<CommandOutcome, CommandError> {
        let entry = self.active_mission(mission)?;
        if !entry.roles.keys().all(|role| entry.is_role_done(role)) {
            return Ok(CommandOutcome::Done);
        }
        match entry.unmoved_items() {
            items if items.is_empty() => entry.state = MissionState::Completed,
            items => {
                let cause = format!("the recovery branch was completed; {}", custody_text(&items));
                // A robot was lost with the item.
                entry.state = MissionState::NeedsIntervention { cause, items, class: CauseClass::Robot };
            }
        }
        self.record_end(mission);
        Ok(CommandOutcome::Done)
    }
}

impl MissionEntry {
    /// Checks whether a role has ended, or has nothing to do.
    fn is_role_done(&self, id: &RoleId) -> bool {
        let is_idle = |role: &RoleEntry| {
            role.kind == RoleKind::Unmanaged && self.plan(id).is_none_or(|plan| plan.steps.is_empty())
        };
        self.roles.get(id).is_some_and(|role| role.phase == RolePhase::Ended || is_idle(role))
    }

    /// Returns the items at robots that may act no more in the roles in which they received them.
    pub(super) fn held_items(&self) -> Vec<HeldItem> {
        match &self.state {
            MissionState::NeedsIntervention { items, .. } => items.clone(),
            MissionState::Pending | MissionState::Running => self.unmoved_items(),
            MissionState::Completed | MissionState::Failed { .. } | MissionState::Canceled { .. } => vec![],
        }
    }

    /// Returns the items that the recovery branch has not moved: they are still where they were
    /// lost.
    fn unmoved_items(&self) -> Vec<HeldItem> {
        if self.items_at_recovery.is_empty() {
            return vec![];
        }
        self.custody().into_iter().filter(|held| self.items_at_recovery.contains(held)).collect()
    }
}

fn in_places(mut held: Vec<HeldItem>, places: &BTreeMap<RobotId, PlaceId>) -> Vec<HeldItem> {
    for item in &mut held {
        if let Some(place) = places.get(&item.robot) {
            item.place = Some(place.clone());
        }
    }
    held
}

/// Formats custody: `the parcel is with amber at IC Room 6`.
fn custody_text(items: &[HeldItem]) -> String {
    let line = |held: &HeldItem| {
        let is = if held.certain { "is" } else { "may be" };
        let at = held.place.as_ref().map(|place| format!(" at {place}")).unwrap_or_default();
        format!("the {} {is} with {}{at}", held.item, held.robot)
    };
    items.iter().map(line).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests;
