//! Applies views of missions.

use super::state::{MissionModel, RoleModel, StepModel};
use super::{FleetModel, bounds};
use consort_protocol::ledger::{MissionState, RolePhase};
use consort_protocol::view::{MissionBrief, MissionSummary, MissionView, MissionsView, RoleView, StepView};
use std::collections::BTreeMap;

impl FleetModel {
    /// Returns the missions to query individually: first running missions, then ended missions that
    /// were not received whole since; the latest first.
    pub(crate) fn missions_to_query(&self) -> Vec<String> {
        let mut wanted: Vec<_> = self.missions.iter().filter(|(_, mission)| !mission.is_complete).collect();
        wanted.sort_by_key(|(_, mission)| (mission.ended, std::cmp::Reverse(mission.number)));
        wanted.into_iter().map(|(id, _)| id.clone()).collect()
    }

    pub(super) fn apply_missions(&mut self, view: MissionsView, now_ms: u64) {
        for (index, MissionSummary { brief, pending_reason }) in (1..).zip(view.missions) {
            // An ended mission changes no more, except when it is resolved.
            let is_known =
                |known: &MissionModel| known.ended && known.number > 0 && known.state == brief.status.detail.as_str();
            if self.missions.get(brief.mission.as_str()).is_some_and(is_known) {
                continue;
            }
            let mission = self.missions.get_or_insert_with(brief.mission.to_string(), MissionModel::default);
            mission.apply_brief(brief, pending_reason, now_ms);
            if mission.number == 0 {
                mission.number = index;
            }
        }
        self.forget_old_missions();
    }

    pub(super) fn apply_mission(&mut self, view: MissionView, now_ms: u64) {
        let MissionView { brief, tasks, tree, roles, auction, .. } = view;
        let (id, number, is_final) = (brief.mission.to_string(), brief.number, brief.status.detail.is_final());
        let mission = self.missions.get_or_insert_with(id, MissionModel::default);
        mission.apply_brief(brief, None, now_ms);
        if number > 0 {
            mission.number = number;
        }
        mission.is_complete |= is_final;
        if !tasks.is_empty() {
            mission.tasks = Some(tasks);
        }
        // Results never change. A view from a node that lags behind lacks the latest.
        let results = tree.map(|tree| tree.task_results()).unwrap_or_default();
        mission.task_results.extend(results.into_iter().map(|(task, results)| (task.to_string(), results)));
        let roles: BTreeMap<String, RoleModel> =
            roles.into_iter().map(|role| (role.role.to_string(), role_model(role))).collect();
        if !roles.is_empty() {
            let held = roles.iter().filter(|(_, shown)| shown.phase != RolePhase::Promised);
            let held = held.filter_map(|(role, shown)| Some((role.clone(), shown.holder.clone()?)));
            mission.holders = held.collect();
            mission.roles = roles;
            mission.apply_holders(now_ms);
        }
        let robots: Vec<String> = mission.holders.values().cloned().collect();
        if let Some(auction) = auction {
            self.apply_auction_record(&auction);
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
    fn apply_brief(&mut self, brief: MissionBrief, pending_reason: Option<String>, now_ms: u64) {
        let MissionBrief { status, terms, progress, result, .. } = brief;
        // An ended mission stays ended, whatever an older view contains; only a resolution still
        // changes it.
        let ended_before = self.ended && self.state != "needs_intervention";
        if !ended_before || status.detail.is_final() {
            self.apply_state(&status.detail, now_ms);
        }
        self.branch = status.branch;
        self.priority = i64::from(terms.priority.get());
        self.deadline_ms = terms.deadline_at_ms.or(self.deadline_ms);
        self.parameters = terms.parameters;
        self.result = result;
        self.submitted_ms = terms.submitted_at_ms;
        let holders = progress.holders.into_iter();
        self.holders = holders.map(|(role, robot)| (role.to_string(), robot.to_string())).collect();
        self.orders = progress.orders.into_iter().map(|(role, order)| (role.to_string(), order)).collect();
        (self.done, self.steps) = (progress.done as u64, progress.steps as u64);
        self.items = Some(progress.items).filter(|items| !items.is_empty());
        self.pending_reason = pending_reason.or(self.pending_reason.take());
        if self.state != "pending" {
            self.pending_reason = None;
        }
    }

    /// Applies the mission's state. The end time is known only if the end was observed; a mission
    /// that is first seen ended has no end time.
    pub(super) fn apply_state(&mut self, state: &MissionState, at_ms: u64) {
        let seen_running = !self.state.is_empty() && !self.ended;
        state.as_str().clone_into(&mut self.state);
        (self.cause, self.cause_class) = match state {
            MissionState::Failed { cause, class } | MissionState::NeedsIntervention { cause, class, .. } => {
                (Some(cause.clone()), Some(*class))
            }
            MissionState::Canceled { by } => (Some(format!("by {by}")), None),
            MissionState::Pending | MissionState::Running | MissionState::Completed => (None, None),
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

fn role_model(role: RoleView) -> RoleModel {
    let step = |StepView { step_type, label, done, .. }| StepModel { step_type, label, done };
    RoleModel {
        kind: role.kind,
        phase: role.phase,
        holder: role.holder.map(|robot| robot.to_string()),
        epoch: role.epoch,
        steps: role.steps.map(|steps| steps.into_iter().map(step).collect()),
        promise: role.promise,
    }
}

#[cfg(test)]
mod tests {
    use super::super::FloorPlan;
    use super::*;
    use consort_protocol::keys::Key;
    use serde_json::json;

    /// The last results of a mission are in its view only after its end.
    #[test]
    fn a_mission_is_queried_until_it_was_received_after_its_end() {
        let mut model = FleetModel::new("ward", "desk", FloorPlan::default(), 0);
        let key = Key::ViewMission("m-1".parse().unwrap());
        let view = |state: &str| json!({ "mission": "m-1", "detail": state, "roles": [] });
        let list = |state: &str| json!({ "missions": [{ "mission": "m-1", "number": 1, "detail": state }] });
        model.apply_view(&Key::ViewMissions, &list("running"), 10);
        model.apply_view(&key, &view("running"), 20);
        assert_eq!(model.missions_to_query(), ["m-1"]);
        model.apply_view(&Key::ViewMissions, &list("completed"), 30);
        assert_eq!(model.missions_to_query(), ["m-1"]);
        // A node that lags behind replies.
        model.apply_view(&key, &view("running"), 40);
        assert_eq!(model.missions_to_query(), ["m-1"]);
        model.apply_view(&key, &view("completed"), 50);
        assert_eq!(model.missions_to_query(), [] as [&str; 0]);
    }
}
