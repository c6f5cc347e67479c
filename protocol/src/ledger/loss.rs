//! What becomes of a mission when a robot is lost, or when it is given up, withdrawn or closed.
//!
//! ```text
//! a role is taken from its holder, which …
//!   has, or may have, an item ──────▶ the mission's recovery branch, else needs rescue
//!   has only cleaning up left ──────▶ the role has ended
//!   told nobody of its work ────────▶ the role is open again       (also: `on_loss: restart`)
//!   told others ────────────────────▶ failed
//! the same within the recovery branch, of which there is one: with what it moves in hand ──▶ needs rescue; else as above,
//!   and what was lost at first is still where it was
//! given up or withdrawn while somebody has, or may have, an item ──▶ needs rescue ── a person ──▶ failed
//! ```

use super::apply::{CommandError, CommandOutcome, Ledger};
use super::custody::HeldItem;
use super::entry::{MissionEntry, MissionState, RELEASES_KEPT, RolePhase, RoleRelease};
use crate::ids::{MissionId, PlaceId, RobotId, RoleId};
use crate::lease::Epoch;
use crate::mission::{OnLoss, RoleKind};
use std::collections::BTreeMap;

/// How often the roles of a mission may be taken from robots that had confirmed them; then it fails. Raised: a mission
/// outlives more losses, and one that no robot can carry out wears out more of them. Default: a guess.
pub const RELEASES_MAX: usize = 5;

/// Why a role is taken from its holder.
pub(super) struct ReleaseCause {
    pub(super) cause: String,
    pub(super) robot_failed: bool,
    pub(super) place: Option<PlaceId>,
}

impl Ledger {
    pub(super) fn release(
        &mut self,
        mission: &MissionId,
        role_id: &RoleId,
        epoch: Epoch,
        loss: &ReleaseCause,
    ) -> Result<CommandOutcome, CommandError> {
        let role = self.held_role(mission, role_id, epoch)?;
        if role.phase == RolePhase::Ended {
            return Ok(CommandOutcome::Done); // carried out: nobody needs to do it again
        }
        let Some(robot) = role.holder.as_ref().map(|holder| holder.robot.clone()) else {
            return Ok(CommandOutcome::Done);
        };
        let confirmed = role.phase == RolePhase::Active;
        let ReleaseCause { cause, robot_failed: blamed, place } = loss;
        let entry = self.active_mission(mission)?;
        let (role, who) = (role_id.clone(), robot.clone());
        entry.releases.push(RoleRelease { role, robot: who, cause: cause.clone(), blamed: *blamed, confirmed });
        entry.release_count = entry.release_count.saturating_add(1);
        if entry.releases.len() > RELEASES_KEPT {
            let first = entry.releases.iter().position(|released| !released.confirmed).unwrap_or(0);
            entry.releases.remove(first);
        }

        let places = place.iter().map(|place| (robot.clone(), place.clone())).collect();
        let kept = in_places(entry.custody(), &places);
        let lost =
            kept.iter().filter(|kept| kept.role == *role_id && kept.robot == robot).min_by_key(|kept| !kept.certain);
        if let Some(lost) = lost.cloned() {
            if entry.recover(&lost, kept.clone()) {
                return Ok(CommandOutcome::Done);
            }
            let has = if lost.certain { "has" } else { "may have" };
            let cause = format!("{robot} was lost as {role_id} and {has} the {}: {cause}", lost.item);
            entry.state = MissionState::NeedsRescue { cause, items: kept };
            return Ok(CommandOutcome::Done);
        }
        if entry.only_cleanup_remains(role_id) {
            self.held_role(mission, role_id, epoch)?.phase = RolePhase::Ended;
            return self.complete_if_done(mission);
        }
        let on_loss = entry.mission().roles.get(role_id).map_or(OnLoss::Fail, |role| role.on_loss);
        if entry.has_signalled(role_id) && on_loss == OnLoss::Fail {
            let cause = format!("{robot} was lost as {role_id} after others had acted on its work: {cause}");
            return self.end(mission, MissionState::Failed { cause }, &places);
        }
        let worn: Vec<&RoleRelease> = entry.releases.iter().filter(|released| released.confirmed).collect();
        if worn.len() >= RELEASES_MAX {
            let causes = worn.iter().map(|released| format!("{} ({})", released.cause, released.role));
            let causes = causes.collect::<Vec<_>>().join("; ");
            let cause = format!("its roles were given up {} times: {causes}", worn.len());
            return self.end(mission, MissionState::Failed { cause }, &places);
        }
        let role = self.held_role(mission, role_id, epoch)?;
        role.holder = None;
        role.phase = RolePhase::Open;
        role.ended.clear();
        self.active_mission(mission)?.state = MissionState::Pending;
        Ok(CommandOutcome::Done)
    }

    /// Ends a mission so, unless somebody has an item in hand: then it needs rescue.
    pub(super) fn end(
        &mut self,
        mission: &MissionId,
        state: MissionState,
        places: &BTreeMap<RobotId, PlaceId>,
    ) -> Result<CommandOutcome, CommandError> {
        let entry = self.active_mission(mission)?;
        let items = in_places(entry.custody(), places);
        let cause = match &state {
            MissionState::Failed { cause } => cause.clone(),
            MissionState::Canceled { by } => format!("canceled by {by}"),
            MissionState::Completed => "carried out".to_owned(),
            MissionState::Pending | MissionState::Running | MissionState::NeedsRescue { .. } => String::new(),
        };
        entry.state = match items.is_empty() {
            true => state,
            false => MissionState::NeedsRescue { cause: format!("{cause}; {}", whereabouts(&items)), items },
        };
        self.prune_history();
        Ok(CommandOutcome::Done)
    }

    /// Withdraws a mission. One that waits for a person stays so, since only a person who has been there can close it; and
    /// whoever asks again for want of an answer has been heard.
    pub(super) fn cancel(
        &mut self,
        mission: &MissionId,
        by: String,
        places: &BTreeMap<RobotId, PlaceId>,
    ) -> Result<CommandOutcome, CommandError> {
        match self.missions.get(mission).map(|entry| &entry.state) {
            Some(MissionState::NeedsRescue { .. }) => Ok(CommandOutcome::Done),
            Some(MissionState::Canceled { by: known }) if *known == by => Ok(CommandOutcome::Done),
            _ => self.end(mission, MissionState::Canceled { by }, places),
        }
    }

    pub(super) fn resolve(&mut self, mission: &MissionId, by: &str) -> Result<CommandOutcome, CommandError> {
        let Some(entry) = self.missions.get_mut(mission) else {
            return Err(CommandError::NoMission { mission: mission.clone() });
        };
        let closing = format!("; rescued by {by}");
        let cause = match &entry.state {
            MissionState::NeedsRescue { cause, .. } => cause,
            // Asked once more for want of an answer.
            MissionState::Failed { cause } if cause.ends_with(&closing) => return Ok(CommandOutcome::Done),
            state => {
                let state = state.as_str().to_owned();
                return Err(CommandError::NoInterventionNeeded { mission: mission.clone(), state });
            }
        };
        entry.state = MissionState::Failed { cause: format!("{cause}{closing}") };
        // The oldest are forgotten when the next mission ends: this one may be among them, and is still to be looked at.
        Ok(CommandOutcome::Done)
    }

    /// Completes a mission whose managed roles have all ended. If its recovery branch left something where it was, a person
    /// is still needed.
    pub(super) fn complete_if_done(&mut self, mission: &MissionId) -> Result<CommandOutcome, CommandError> {
        let entry = self.active_mission(mission)?;
        let mut managed = entry.roles.values().filter(|role| role.kind == RoleKind::Managed);
        if !managed.all(|role| role.phase == RolePhase::Ended) {
            return Ok(CommandOutcome::Done);
        }
        match entry.unmoved_items() {
            items if items.is_empty() => entry.state = MissionState::Completed,
            items => {
                let cause = format!("the recovery branch was carried out; {}", whereabouts(&items));
                entry.state = MissionState::NeedsRescue { cause, items };
            }
        }
        self.prune_history();
        Ok(CommandOutcome::Done)
    }
}

impl MissionEntry {
    /// What the recovery branch has not moved: it is still where it was lost.
    pub(super) fn unmoved_items(&self) -> Vec<HeldItem> {
        if self.items_at_recovery.is_empty() {
            return vec![];
        }
        self.custody().into_iter().filter(|kept| self.items_at_recovery.contains(kept)).collect()
    }
}

fn in_places(mut kept: Vec<HeldItem>, places: &BTreeMap<RobotId, PlaceId>) -> Vec<HeldItem> {
    for item in &mut kept {
        if let Some(place) = places.get(&item.robot) {
            item.place = Some(place.clone());
        }
    }
    kept
}

/// `the sample is with amber at IC Room 6`.
fn whereabouts(items: &[HeldItem]) -> String {
    let line = |kept: &HeldItem| {
        let is = if kept.certain { "is" } else { "may be" };
        let at = kept.place.as_ref().map(|place| format!(" at {place}")).unwrap_or_default();
        format!("the {} {is} with {}{at}", kept.item, kept.robot)
    };
    items.iter().map(line).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests;
