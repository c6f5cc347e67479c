//! Applies views of missions.

use super::state::{MissionModel, RoleModel};
use super::update::{flag, list, number, text};
use super::{FleetModel, bounds};
use consort_protocol::ledger::MissionState;
use serde_json::Value;
use std::collections::BTreeMap;

impl FleetModel {
    /// Returns the missions to query individually: first running missions, then missions without a
    /// known plan; the latest first.
    pub fn missions_to_query(&self) -> Vec<String> {
        let incomplete = |mission: &MissionModel| !mission.ended || mission.tasks.is_none();
        let mut wanted: Vec<_> = self.missions.iter().filter(|(_, mission)| incomplete(mission)).collect();
        wanted.sort_by_key(|(_, mission)| (mission.ended, std::cmp::Reverse(mission.number)));
        wanted.into_iter().map(|(id, _)| id.clone()).collect()
    }

    pub(super) fn apply_missions(&mut self, view: &Value, now_ms: u64) {
        for (index, brief) in (1..).zip(list(&view["missions"])) {
            let Some(id) = text(brief, "mission") else { continue };
            // An ended mission changes no more, except when it is resolved.
            let is_known = |known: &MissionModel| {
                known.ended && known.number > 0 && text(brief, "state") == Some(known.state.as_str())
            };
            if self.missions.get(id).is_some_and(is_known) {
                continue;
            }
            let mission = self.missions.get_or_insert_with(id.to_owned(), MissionModel::default);
            mission.apply_brief(brief, now_ms);
            if mission.number == 0 {
                mission.number = index;
            }
        }
        self.forget_old_missions();
    }

    pub(super) fn apply_mission(&mut self, id: &str, view: &Value, now_ms: u64) {
        let mission = self.missions.get_or_insert_with(id.to_owned(), MissionModel::default);
        mission.apply_brief(view, now_ms);
        if let Some(number) = number(view, "number") {
            mission.number = number;
        }
        mission.tasks = view.get("tasks").filter(|tasks| tasks.is_array()).cloned().or(mission.tasks.take());
        let roles = list(&view["roles"]).filter_map(|role| Some((text(role, "role")?.to_owned(), role_model(role))));
        let roles: BTreeMap<String, RoleModel> = roles.collect();
        if !roles.is_empty() {
            let held = roles.iter().filter_map(|(role, shown)| Some((role.clone(), shown.holder.clone()?)));
            mission.holders = held.collect();
            mission.roles = roles;
            mission.apply_holders(now_ms);
        }
        let auction = view.get("auction").filter(|auction| auction.is_object()).cloned();
        let robots: Vec<String> = mission.holders.values().cloned().collect();
        if let Some(auction) = auction {
            self.apply_auction(&auction);
        }
        for robot in robots {
            self.update_route(&robot);
        }
        self.forget_old_missions();
    }

    /// Keeps only the latest ended missions.
    fn forget_old_missions(&mut self) {
        let mut ended: Vec<(u64, String)> = self
            .missions
            .iter()
            .filter(|(_, mission)| mission.ended)
            .map(|(id, mission)| (mission.number, id.clone()))
            .collect();
        ended.sort_unstable();
        let surplus = ended.len().saturating_sub(bounds::ENDED_MISSIONS);
        for (_, id) in ended.drain(..surplus) {
            self.missions.remove(&id);
        }
    }
}

impl MissionModel {
    fn apply_brief(&mut self, view: &Value, now_ms: u64) {
        let state = serde_json::from_value::<MissionState>(view["detail"].clone());
        if let Ok(state) = &state {
            // An ended mission stays ended, whatever an older view contains; only a resolution
            // still changes it.
            let ended_before = self.ended && self.state != "needs_intervention";
            if !ended_before || state.is_final() {
                self.apply_state(state, now_ms);
            }
        }
        self.priority = view["priority"].as_i64().unwrap_or(self.priority);
        self.deadline_ms = number(view, "deadline_at_ms").or(self.deadline_ms);
        text(view, "branch").unwrap_or("main").clone_into(&mut self.branch);
        if let Ok(parameters) = serde_json::from_value(view["parameters"].clone()) {
            self.parameters = parameters;
        }
        if let Ok(holders) = serde_json::from_value(view["holders"].clone()) {
            self.holders = holders;
        }
        self.done = number(view, "done").unwrap_or(self.done);
        self.steps = number(view, "steps").unwrap_or(self.steps);
        // Recordings of earlier releases use the name `why_pending`.
        let reason = text(view, "pending_reason").or_else(|| text(view, "why_pending"));
        self.pending_reason = reason.map(str::to_owned).or(self.pending_reason.take());
        if self.state != "pending" {
            self.pending_reason = None;
        }
        self.items = view.get("items").filter(|items| list(items).next().is_some()).cloned();
        self.submitted_ms = number(view, "submitted_at_ms").unwrap_or(self.submitted_ms);
    }

    /// Applies the mission's state. The end time is known only if the end was observed; a mission
    /// that is first seen ended has no end time.
    pub(super) fn apply_state(&mut self, state: &MissionState, at_ms: u64) {
        let seen_running = !self.state.is_empty() && !self.ended;
        state.as_str().clone_into(&mut self.state);
        self.cause = match state {
            MissionState::Failed { cause } | MissionState::NeedsIntervention { cause, .. } => Some(cause.clone()),
            MissionState::Canceled { by } => Some(format!("by {by}")),
            MissionState::Pending | MissionState::Running | MissionState::Completed => None,
        };
        if state.is_final() {
            if seen_running {
                self.ended_ms.get_or_insert(at_ms);
            }
            for bar in self.bars.iter_mut().filter(|bar| bar.to_ms.is_none()) {
                bar.to_ms = Some(at_ms);
                "aborted".clone_into(&mut bar.state);
            }
            self.end_all_assignments(at_ms, *state == MissionState::Completed);
        }
        self.ended = state.is_final();
    }
}

fn role_model(role: &Value) -> RoleModel {
    let phase = &role["phase"];
    let phase = phase.as_str().map(str::to_owned).or_else(|| phase.as_object()?.keys().next().cloned());
    let own = |key: &str| text(role, key).map(str::to_owned);
    let steps = role.get("steps").filter(|steps| steps.is_array()).map(|steps| {
        let brief = list(steps).map(
            |step| serde_json::json!({ "type": step["type"], "label": step["label"], "done": flag(step, "done") }),
        );
        brief.collect()
    });
    let kind = own("kind").unwrap_or_default();
    RoleModel { kind, phase: phase.unwrap_or_default(), holder: own("holder"), epoch: own("epoch"), steps }
}
