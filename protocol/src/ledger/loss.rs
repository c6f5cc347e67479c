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

use super::apply::{Ledger, Outcome, Refused};
use super::custody::Stranded;
use super::entry::{MissionEntry, MissionState, RELEASES_KEPT, Released, RolePhase};
use crate::ids::{MissionId, PlaceId, RobotId, RoleId};
use crate::lease::Epoch;
use crate::mission::{OnLoss, RoleKind};
use std::collections::BTreeMap;

/// How often the roles of a mission may be taken from robots that had confirmed them; then it fails. Raised: a mission
/// outlives more losses, and one that no robot can carry out wears out more of them. Default: a guess.
pub const RELEASES_MAX: usize = 5;

/// Why a role is taken from its holder.
pub(super) struct Loss {
    pub(super) cause: String,
    pub(super) blamed: bool,
    pub(super) place: Option<PlaceId>,
}

impl Ledger {
    pub(super) fn release(
        &mut self,
        mission: &MissionId,
        role_id: &RoleId,
        epoch: Epoch,
        loss: &Loss,
    ) -> Result<Outcome, Refused> {
        let role = self.held_role(mission, role_id, epoch)?;
        if role.phase == RolePhase::Ended {
            return Ok(Outcome::Done); // carried out: nobody needs to do it again
        }
        let Some(robot) = role.holder.as_ref().map(|holder| holder.robot.clone()) else { return Ok(Outcome::Done) };
        let confirmed = role.phase == RolePhase::Active;
        let Loss { cause, blamed, place } = loss;
        let entry = self.live_mission(mission)?;
        let (role, who) = (role_id.clone(), robot.clone());
        entry.releases.push(Released { role, robot: who, cause: cause.clone(), blamed: *blamed, confirmed });
        entry.released = entry.released.saturating_add(1);
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
                return Ok(Outcome::Done);
            }
            let has = if lost.certain { "has" } else { "may have" };
            let cause = format!("{robot} was lost as {role_id} and {has} the {}: {cause}", lost.item);
            entry.state = MissionState::NeedsRescue { cause, items: kept };
            return Ok(Outcome::Done);
        }
        if entry.only_cleaning_up_is_left(role_id) {
            self.held_role(mission, role_id, epoch)?.phase = RolePhase::Ended;
            return self.complete_if_done(mission);
        }
        let on_loss = entry.mission().roles.get(role_id).map_or(OnLoss::Fail, |role| role.on_loss);
        if entry.has_told(role_id) && on_loss == OnLoss::Fail {
            let cause = format!("{robot} was lost as {role_id} after others had acted on its work: {cause}");
            return self.end(mission, MissionState::Failed { cause }, &places);
        }
        let worn: Vec<&Released> = entry.releases.iter().filter(|released| released.confirmed).collect();
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
        self.live_mission(mission)?.state = MissionState::Pending;
        Ok(Outcome::Done)
    }

    /// Ends a mission so, unless somebody has an item in hand: then it needs rescue.
    pub(super) fn end(
        &mut self,
        mission: &MissionId,
        state: MissionState,
        places: &BTreeMap<RobotId, PlaceId>,
    ) -> Result<Outcome, Refused> {
        let entry = self.live_mission(mission)?;
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
        self.forget_oldest();
        Ok(Outcome::Done)
    }

    /// Withdraws a mission. One that waits for a person stays so, since only a person who has been there can close it; and
    /// whoever asks again for want of an answer has been heard.
    pub(super) fn cancel(
        &mut self,
        mission: &MissionId,
        by: String,
        places: &BTreeMap<RobotId, PlaceId>,
    ) -> Result<Outcome, Refused> {
        match self.missions.get(mission).map(|entry| &entry.state) {
            Some(MissionState::NeedsRescue { .. }) => Ok(Outcome::Done),
            Some(MissionState::Canceled { by: known }) if *known == by => Ok(Outcome::Done),
            _ => self.end(mission, MissionState::Canceled { by }, places),
        }
    }

    pub(super) fn rescued(&mut self, mission: &MissionId, by: &str) -> Result<Outcome, Refused> {
        let Some(entry) = self.missions.get_mut(mission) else {
            return Err(Refused::NoMission { mission: mission.clone() });
        };
        let closing = format!("; rescued by {by}");
        let cause = match &entry.state {
            MissionState::NeedsRescue { cause, .. } => cause,
            // Asked once more for want of an answer.
            MissionState::Failed { cause } if cause.ends_with(&closing) => return Ok(Outcome::Done),
            state => {
                let state = state.word().to_owned();
                return Err(Refused::NoRescue { mission: mission.clone(), state });
            }
        };
        entry.state = MissionState::Failed { cause: format!("{cause}{closing}") };
        // The oldest are forgotten when the next mission ends: this one may be among them, and is still to be looked at.
        Ok(Outcome::Done)
    }

    /// Completes a mission whose managed roles have all ended. If its recovery branch left something where it was, a person
    /// is still needed.
    pub(super) fn complete_if_done(&mut self, mission: &MissionId) -> Result<Outcome, Refused> {
        let entry = self.live_mission(mission)?;
        let mut managed = entry.roles.values().filter(|role| role.kind == RoleKind::Managed);
        if !managed.all(|role| role.phase == RolePhase::Ended) {
            return Ok(Outcome::Done);
        }
        match entry.left_behind() {
            items if items.is_empty() => entry.state = MissionState::Completed,
            items => {
                let cause = format!("the recovery branch was carried out; {}", whereabouts(&items));
                entry.state = MissionState::NeedsRescue { cause, items };
            }
        }
        self.forget_oldest();
        Ok(Outcome::Done)
    }
}

impl MissionEntry {
    /// What the recovery branch has not moved: it is still where it was lost.
    pub(super) fn left_behind(&self) -> Vec<Stranded> {
        if self.inherited.is_empty() {
            return vec![];
        }
        self.custody().into_iter().filter(|kept| self.inherited.contains(kept)).collect()
    }
}

fn in_places(mut kept: Vec<Stranded>, places: &BTreeMap<RobotId, PlaceId>) -> Vec<Stranded> {
    for item in &mut kept {
        if let Some(place) = places.get(&item.robot) {
            item.place = Some(place.clone());
        }
    }
    kept
}

/// `the sample is with amber at IC Room 6`.
fn whereabouts(items: &[Stranded]) -> String {
    let line = |kept: &Stranded| {
        let is = if kept.certain { "is" } else { "may be" };
        let at = kept.place.as_ref().map(|place| format!(" at {place}")).unwrap_or_default();
        format!("the {} {is} with {}{at}", kept.item, kept.robot)
    };
    items.iter().map(line).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests;
