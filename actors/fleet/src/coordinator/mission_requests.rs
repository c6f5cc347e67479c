//! Requests of people that change missions.

use super::api::{ApiError, ApiHandler, not_committed};
use super::last_known_place::last_known_places;
use consort_bus::Requester;
use consort_protocol::api::{
    CancelMissionsReply, CancelMissionsRequest, MissionSelection, PriorityReply, PriorityRequest, SelectionCondition,
    parse_request,
};
use consort_protocol::ids::{MissionId, PlaceId, RequestId, RobotId};
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::{
    Command, CommandError, Ledger, MissionCancelation, MissionChange, MissionEntry, MissionFilter, MissionState,
    OrderRequest, Priority,
};
use std::collections::{BTreeMap, BTreeSet};

/// The missions of a request.
#[derive(Debug, Default, PartialEq, Eq)]
struct SelectedMissions {
    /// Missions that can be canceled, and those that the person has canceled before.
    accepted: BTreeSet<MissionId>,
    /// The other missions, with the reasons.
    refused: BTreeMap<MissionId, String>,
}

impl ApiHandler {
    /// Cancels missions, or lists those that it would cancel.
    pub(super) async fn cancel_missions(&self, payload: &[u8]) -> Result<CancelMissionsReply, ApiError> {
        let CancelMissionsRequest { missions: selection, dry_run, by, request } =
            parse_request(ApiCall::CancelMissions, payload)?;
        let (by, request) = (self.responsible(by), self.request_id(request)?);
        if self.replica.read(|ledger| request.as_ref().is_some_and(|request| ledger.remembers_order(request))) {
            return Ok(CancelMissionsReply { missions: BTreeMap::new(), refused: BTreeMap::new(), again: true });
        }
        // A dry run commits nothing, nor does a selection without active missions.
        self.confirm_leadership().await?;
        let SelectedMissions { accepted, refused } = self.selected_missions(&selection, &by)?;
        let active = self.replica.read(|ledger| {
            let active = accepted.iter().filter_map(|mission| ledger.mission(mission));
            let active = active.filter(|entry| !entry.state.is_final());
            active.map(|entry| (entry.id.clone(), last_known_places(&self.knowledge, Some(entry)))).collect()
        });
        if !dry_run {
            self.cancel_all(active, by, request).await?;
        }
        let missions = self.replica.read(|ledger| {
            let states = accepted.into_iter().map(|mission| {
                let state = ledger.mission_state(&mission).cloned();
                (mission, state)
            });
            states.collect()
        });
        Ok(CancelMissionsReply { missions, refused, again: false })
    }

    /// Cancels missions in one entry of the ledger. A request with an id has an entry even if it cancels none: a copy of it
    /// cancels no later mission. In a ledger of an earlier wire version, which has no such entries, it cancels them one by
    /// one.
    async fn cancel_all(
        &self,
        missions: BTreeMap<MissionId, BTreeMap<RobotId, PlaceId>>,
        by: String,
        request: Option<RequestId>,
    ) -> Result<(), ApiError> {
        let at_ms = self.audit_ms();
        let keeps_requests = self.replica.read(|ledger| ledger.history_limits().is_some());
        if keeps_requests && (request.is_some() || !missions.is_empty()) {
            let order = OrderRequest { change: MissionCancelation { missions }, by, at_ms, request };
            return self.commit_order(Command::CancelMissions { order }).await;
        }
        for (mission, places) in missions {
            let command = Command::Cancel { mission, by: by.clone(), places, at_ms };
            self.propose(command).await.map_err(|problem| not_committed(&problem))?;
        }
        Ok(())
    }

    /// Changes the priority of a mission.
    pub(super) async fn set_priority(&self, payload: &[u8]) -> Result<PriorityReply, ApiError> {
        let PriorityRequest { mission, priority, by, request } = parse_request(ApiCall::Priority, payload)?;
        let priority = Priority::new(priority).map_err(|problem| problem.to_string())?;
        self.change_mission(&mission, MissionChange::SetPriority(priority), by, request).await?;
        let priority = self.replica.read(|ledger| ledger.mission(&mission).map(|entry| entry.submission.priority));
        Ok(PriorityReply { mission, priority })
    }

    /// Commits a change of a mission. The ledger rejects it for an unknown mission, and for one that has ended.
    pub(super) async fn change_mission(
        &self,
        mission: &MissionId,
        change: MissionChange,
        by: Option<String>,
        request: Option<RequestId>,
    ) -> Result<(), ApiError> {
        self.replica.read(|ledger| ledger.mission(mission).map_or(Ok(()), |entry| self.check_change_right(entry)))?;
        let order = self.order_request(change, by, request)?;
        self.commit_order(Command::ChangeMission { mission: mission.clone(), order }).await
    }

    /// Checks whether the signer may change a mission, in a closed fleet: whether it may submit it.
    pub(super) fn check_change_right(&self, entry: &MissionEntry) -> Result<(), String> {
        let Some(Requester { author, .. }) = &self.requester else { return Ok(()) };
        let permitted = author.missions.check(&author.name, Some(entry.submission.mission.name.as_str()));
        permitted.map_err(|problem| format!("only people who may submit a mission change it: {problem}"))
    }

    fn selected_missions(&self, selection: &MissionSelection, by: &str) -> Result<SelectedMissions, ApiError> {
        let check = |entry: &MissionEntry| self.check_change_right(entry);
        match selection {
            MissionSelection::Named(names) if names.is_empty() => {
                Err("missions is empty; name a mission".to_owned().into())
            }
            MissionSelection::Named(names) => Ok(self.replica.read(|ledger| select(ledger, names, by, check))),
            MissionSelection::Where(SelectionCondition { condition }) => {
                let filter = MissionFilter::compile(condition).map_err(|problem| format!("where: {problem}"))?;
                let now_ms = self.time_ms()?;
                Ok(self.replica.read(|ledger| {
                    let meeting = ledger.active_missions().into_iter().filter(|entry| filter.matches(entry, now_ms));
                    select(ledger, &meeting.map(|entry| entry.id.clone()).collect(), by, check)
                }))
            }
        }
    }
}

/// Sorts missions into those that `by` can cancel and others. `check` returns why the person may not change a mission.
fn select(
    ledger: &Ledger,
    missions: &BTreeSet<MissionId>,
    by: &str,
    check: impl Fn(&MissionEntry) -> Result<(), String>,
) -> SelectedMissions {
    let mut selected = SelectedMissions::default();
    for mission in missions.iter().cloned() {
        let refusal = match ledger.mission_state(&mission) {
            None => Err(CommandError::NoMission { mission: mission.clone() }.to_string()),
            Some(MissionState::Pending | MissionState::Running) => ledger.mission(&mission).map_or(Ok(()), &check),
            // The request was repeated for lack of a reply.
            Some(MissionState::Canceled { by: known }) if known == by => Ok(()),
            Some(MissionState::NeedsIntervention { .. }) => {
                Err(format!("mission {mission} needs intervention: a person closes it with `consort resolve`"))
            }
            Some(state) => {
                Err(CommandError::MissionEnded { mission: mission.clone(), state: state.clone() }.to_string())
            }
        };
        if let Err(reason) = refusal {
            selected.refused.insert(mission, reason);
        } else {
            selected.accepted.insert(mission);
        }
    }
    selected
}
