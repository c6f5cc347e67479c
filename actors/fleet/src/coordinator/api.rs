//! State-changing requests, executed by the coordinator: see [`consort_protocol::api`] for their
//! payloads.

use super::last_known_place::last_known_places;
use super::no_leader::{RETRY_AFTER_MS, busy_reply};
use super::open_replies::{OpenReplies, OpenReply};
use super::people::{PeopleHost, removals};
use super::rate_limit::RequestLimits;
use super::submission::{self, Definitions, ScheduleError, SubmitError};
use crate::events::EventPublisher;
use crate::recurrence::schedule_view;
use consort_bus::{MESSAGE_MAX, Requester};
use consort_gossip::SharedKnowledge;
use consort_protocol::api::{
    AnswerReply, AnswerRequest, AnswerWord, ErrorReply, LATER_MINUTES_MAX, MissionChangeReply, MissionChangeRequest,
    MissionSource, NodeVersions, RequestError, ScheduleAction, ScheduleReply, ScheduleRequest, SubmitReply,
    SubmitRequest, UpgradeReply, UpgradeRequest, parse_request,
};
use consort_protocol::ensemble::Ensembles;
use consort_protocol::event::{EventKind, ScheduleChange};
use consort_protocol::ids::{AlarmId, FleetId, MissionId, NodeId, RequestId, ScheduleId};
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::{
    AlarmPlan, AnswerContent, Command, CommandError, CommandOutcome, Ledger, PersonAnswer, ScheduleEntry, SchedulePause,
};
use consort_protocol::mission::{Domain, check_results};
use consort_protocol::trust::MissionNotPermitted;
use consort_protocol::versions::{UpgradeStatus, VersionRange};
use consort_raft::store::Backup;
use consort_raft::{ProposeError, Replica};
use consort_skills::missions::NamedMissions;
use serde::Serialize;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

/// Timeout for the ledger to commit a request.
const COMMIT_TIMEOUT: Duration = Duration::from_secs(2);

/// Minutes for which a request is put off by default.
const LATER_MINUTES: u32 = 10;

/// Handler of a single request, with the state it needs. It is dropped after the reply.
pub(super) struct ApiHandler {
    pub(super) fleet: FleetId,
    pub(super) node: NodeId,
    pub(super) replica: Replica<Ledger>,
    pub(super) events: EventPublisher,
    pub(super) knowledge: SharedKnowledge,
    pub(super) supported_versions: VersionRange,
    pub(super) domain: Arc<Domain>,
    pub(super) ensembles: Arc<Ensembles>,
    /// The missions that a request may name.
    pub(super) missions: Arc<NamedMissions>,
    /// The alarms that a request may raise.
    pub(super) alarms: Arc<BTreeMap<AlarmId, AlarmPlan>>,
    /// Simulated people.
    pub(super) people: PeopleHost,
    /// Prefix of generated request ids, different from the prefixes of other coordinators.
    pub(super) request_prefix: String,
    /// Time of day in milliseconds since 1970, if it is known.
    pub(super) time_ms: Option<u64>,
    pub(super) request_number: u64,
    /// Verified author of the request, in a closed fleet.
    pub(super) requester: Option<Requester>,
    /// Limits of requests and missions.
    pub(super) limits: RequestLimits,
    pub(super) open_replies: OpenReplies,
    /// The reply to a submission, before it is sent.
    pub(super) open_reply: OnceLock<OpenReply>,
}

/// Error reply.
pub(super) struct ApiError {
    pub(super) text: String,
    /// The same request may be repeated.
    pub(super) may_retry: bool,
}

impl From<String> for ApiError {
    fn from(text: String) -> ApiError {
        ApiError { text, may_retry: false }
    }
}

impl From<RequestError> for ApiError {
    fn from(error: RequestError) -> ApiError {
        error.to_string().into()
    }
}

impl From<ScheduleError> for ApiError {
    fn from(error: ScheduleError) -> ApiError {
        error.to_string().into()
    }
}

impl From<MissionNotPermitted> for ApiError {
    fn from(error: MissionNotPermitted) -> ApiError {
        error.to_string().into()
    }
}

impl From<SubmitError> for ApiError {
    fn from(error: SubmitError) -> ApiError {
        error.to_string().into()
    }
}

/// Returns the JSON of a reply.
fn json(reply: impl Serialize) -> Value {
    serde_json::to_value(reply).expect("a reply serializes to JSON")
}

impl ApiHandler {
    /// Executes a request and returns the reply.
    pub(super) async fn handle(&self, call: ApiCall, payload: &[u8]) -> Value {
        let reply = match call {
            ApiCall::Submit => self.submit(payload).await.map(json),
            ApiCall::Cancel => self.cancel(payload).await.map(json),
            ApiCall::CancelMissions => self.cancel_missions(payload).await.map(json),
            ApiCall::Priority => self.set_priority(payload).await.map(json),
            ApiCall::Reassign => self.reassign(payload).await.map(json),
            ApiCall::Resolve => self.resolve(payload).await.map(json),
            ApiCall::Answer => self.answer(payload).await.map(json),
            ApiCall::Schedule => self.schedule(payload).await.map(json),
            ApiCall::Hold => self.hold(payload).await.map(json),
            ApiCall::Release => self.release(payload).await.map(json),
            ApiCall::Maintenance => self.maintenance(payload).await.map(json),
            ApiCall::Close => self.close(payload).await.map(json),
            ApiCall::Open => self.open(payload).await.map(json),
            ApiCall::Limit => self.limit(payload).await.map(json),
            ApiCall::Alarm => self.alarm(payload).await.map(json),
            ApiCall::Backup => self.backup().await,
            ApiCall::Upgrade => self.upgrade(payload).await.map(json),
            ApiCall::Get
            | ApiCall::List
            | ApiCall::Requests
            | ApiCall::Schedules
            | ApiCall::Audit
            | ApiCall::Explain
            | ApiCall::Help => Err(format!("{} is served by any node", call.as_str()).into()),
        };
        reply.unwrap_or_else(|ApiError { text, may_retry }| match may_retry {
            true => json(busy_reply(&text, Duration::from_millis(RETRY_AFTER_MS))),
            false => json(ErrorReply::rejected(text)),
        })
    }

    async fn submit(&self, payload: &[u8]) -> Result<SubmitReply, ApiError> {
        let mut request_fields: SubmitRequest = parse_request(ApiCall::Submit, payload)?;
        self.check_mission_right(&request_fields.mission)?;
        let by = self.responsible(request_fields.by.take());
        // A repetition of a signed request, by a link or an attacker, has the same id.
        let default_id = match &self.requester {
            Some(requester) => requester.request.clone(),
            None => format!("{}-{}", self.request_prefix, self.request_number),
        };
        let submission = submission::prepare(request_fields, self.definitions(), self.time_ms()?, default_id, by)?;
        if let Some(overload) = self.replica.read(|ledger| self.overload(ledger, &submission.request)) {
            return Err(overload);
        }
        if let Some(reply) = self.open_replies.begin(&submission.request) {
            // A handler has a single reply.
            let _ = self.open_reply.set(reply);
        }
        match self.propose(Command::Submit(Box::new(submission))).await {
            Ok(CommandOutcome::Submitted { mission, again }) => {
                let state = self.replica.read(|ledger| ledger.mission_state(&mission).cloned());
                let outcome = state.filter(|state| again && state.is_final());
                Ok(SubmitReply { mission, again, outcome })
            }
            Ok(CommandOutcome::Refused(refused)) => {
                Err(ApiError { text: refused.to_string(), may_retry: matches!(refused, CommandError::Full { .. }) })
            }
            Ok(other) => Err(format!("unexpected outcome of the ledger: {other:?}").into()),
            Err(problem) => Err(not_committed(&problem)),
        }
    }

    fn definitions(&self) -> Definitions<'_> {
        Definitions { missions: &self.missions, domain: &self.domain, limits: self.limits }
    }

    /// Checks whether the signer may submit a mission, in a closed fleet. A request that names the mission contains
    /// nothing else of it: the mission is executed as this node defines it.
    fn check_mission_right(&self, mission: &MissionSource) -> Result<(), ApiError> {
        let Some(Requester { author, .. }) = &self.requester else { return Ok(()) };
        let name = match mission {
            MissionSource::Named(name) => Some(name.as_str()),
            MissionSource::File(_) => None,
        };
        Ok(author.missions.check(&author.name, name)?)
    }

    /// Checks whether the signer may resume a schedule, which submits missions again. The name of its mission counts:
    /// the person that added the schedule had the right to its plan. The ledger rejects an unknown schedule.
    fn check_resume_right(&self, schedule: &ScheduleId) -> Result<(), ApiError> {
        let Some(Requester { author, .. }) = &self.requester else { return Ok(()) };
        let name =
            |ledger: &Ledger| ledger.schedule(schedule).map(|entry| entry.schedule.submission.mission.name.clone());
        match self.replica.read(name) {
            Some(name) => Ok(author.missions.check(&author.name, Some(name.as_str()))?),
            None => Ok(()),
        }
    }

    pub(super) fn time_ms(&self) -> Result<u64, ApiError> {
        let text = "the coordinator does not know the time of day of the voters yet".to_owned();
        self.time_ms.ok_or(ApiError { text, may_retry: true })
    }

    /// Returns the time of day for the audit trail; 0, the time of its latest entry, if it is unknown. Nobody waits
    /// for a clock to cancel a mission.
    pub(super) fn audit_ms(&self) -> u64 {
        self.time_ms.unwrap_or_default()
    }

    /// Returns an error if the fleet accepts no new missions. A repeated request for an accepted
    /// mission still gets its reply.
    fn overload(&self, ledger: &Ledger, request: &RequestId) -> Option<ApiError> {
        let missions_max = self.limits.missions_max;
        let is_full = missions_max > 0 && ledger.has_active(missions_max);
        (is_full && !ledger.remembers(request)).then(|| ApiError {
            text: format!("{missions_max} missions are active, the maximum of this fleet"),
            may_retry: true,
        })
    }

    async fn cancel(&self, payload: &[u8]) -> Result<MissionChangeReply, ApiError> {
        let MissionChangeRequest { mission, by } = parse_request(ApiCall::Cancel, payload)?;
        let by = self.responsible(by);
        let places = self.replica.read(|ledger| {
            let entry = ledger.mission(&mission);
            entry.map_or(Ok(()), |entry| self.check_change_right(entry))?;
            Ok::<_, String>(last_known_places(&self.knowledge, entry))
        })?;
        self.change(mission.clone(), Command::Cancel { mission, by, places, at_ms: self.audit_ms() }).await
    }

    /// Closes a mission after a person has taken the items off its robots. In a simulated world a simulated person does it
    /// now, before the ledger gives the robots other roles.
    async fn resolve(&self, payload: &[u8]) -> Result<MissionChangeReply, ApiError> {
        let MissionChangeRequest { mission, by } = parse_request(ApiCall::Resolve, payload)?;
        let by = self.responsible(by);
        self.people.send_all(self.replica.read(|ledger| removals(ledger, &mission))).await;
        self.change(mission.clone(), Command::Resolve { mission, by, at_ms: self.audit_ms() }).await
    }

    /// Records the answer of a person.
    async fn answer(&self, payload: &[u8]) -> Result<AnswerReply, ApiError> {
        let AnswerRequest { request, answer, results, note, minutes, by } = parse_request(ApiCall::Answer, payload)?;
        let at_ms = self.time_ms()?;
        if let Some(minutes) = minutes {
            if answer != AnswerWord::Later {
                return Err("`minutes` belongs to the answer `later`".to_owned().into());
            }
            if !(1..=LATER_MINUTES_MAX).contains(&minutes) {
                return Err(format!("minutes is {minutes}; allowed are 1 to {LATER_MINUTES_MAX}").into());
            }
        }
        if answer != AnswerWord::Done && !results.is_empty() {
            return Err("`results` belong to the answer `done`".to_owned().into());
        }
        let content = match answer {
            // The ledger refuses the answer to an unknown request.
            AnswerWord::Done => AnswerContent::Done(match self.replica.read(|ledger| ledger.form_of(&request)) {
                Some(form) => check_results(&form, &results)?,
                None => results,
            }),
            AnswerWord::Declined => AnswerContent::Declined,
            AnswerWord::Cannot => AnswerContent::Cannot,
            AnswerWord::Later => {
                let delay_ms = u64::from(minutes.unwrap_or(LATER_MINUTES)) * 60_000;
                AnswerContent::Later(at_ms.saturating_add(delay_ms))
            }
        };
        let answer = PersonAnswer { by: self.person(by), content, note, at_ms };
        let places = self.replica.read(|ledger| last_known_places(&self.knowledge, ledger.mission(&request.mission)));
        let command = Command::AnswerPerson { request: request.clone(), answer, places };
        match self.propose(command).await {
            Ok(CommandOutcome::Refused(refused)) => Err(refused.to_string().into()),
            Ok(_) => {
                let phase = self.replica.read(|ledger| {
                    let entry = ledger.mission(&request.mission)?;
                    Some(entry.person_request(request.number)?.phase.clone())
                });
                Ok(AnswerReply { request, phase })
            }
            Err(problem) => Err(not_committed(&problem)),
        }
    }

    /// Adds or changes a schedule.
    async fn schedule(&self, payload: &[u8]) -> Result<ScheduleReply, ApiError> {
        let mut request: ScheduleRequest = parse_request(ApiCall::Schedule, payload)?;
        if let Some(submit) = &request.submit {
            self.check_mission_right(&submit.mission)?;
        }
        if request.action == ScheduleAction::Resume {
            self.check_resume_right(&request.schedule)?;
        }
        let (id, action, by, at_ms) =
            (request.schedule.clone(), request.action, self.responsible(request.by.take()), self.time_ms()?);
        let command = match action {
            ScheduleAction::Add => {
                let schedule = Box::new(submission::prepare_schedule(request, self.definitions(), by.clone())?);
                Command::AddSchedule { schedule, from_ms: at_ms }
            }
            _ if request.has_content() => {
                let text = "`cron`, `zone`, `until`, `missed` and `submit` belong to the action `add`";
                return Err(text.to_owned().into());
            }
            ScheduleAction::Pause => {
                let pause = SchedulePause { by: by.clone(), since_ms: at_ms };
                Command::PauseSchedule { schedule: id.clone(), pause }
            }
            ScheduleAction::Resume => Command::ResumeSchedule { schedule: id.clone(), at_ms, by: by.clone() },
            ScheduleAction::Remove => Command::RemoveSchedule { schedule: id.clone(), by: by.clone(), at_ms },
        };
        let change = self.replica.read(|ledger| schedule_change(action, ledger.schedule(&id)));
        match self.propose(command).await {
            Ok(CommandOutcome::Refused(refused)) => {
                // A new ledger gets its version right after its creation.
                let may_retry = self.replica.read(Ledger::wire).is_none();
                Err(ApiError { text: refused.to_string(), may_retry })
            }
            Ok(_) => {
                if let Some(change) = change {
                    self.events.publish(EventKind::ScheduleChanged { schedule: id.clone(), change, by });
                }
                Ok(ScheduleReply { schedule: self.replica.read(|ledger| ledger.schedule(&id).map(schedule_view)) })
            }
            Err(problem) => Err(not_committed(&problem)),
        }
    }

    /// Returns the person that is responsible for a change, for display: the signer, in a closed
    /// fleet.
    pub(super) fn responsible(&self, by: Option<String>) -> String {
        let by = by.filter(|by| !by.trim().is_empty());
        let author = self.requester.as_ref().map(|requester| &requester.author);
        match (author, by) {
            (Some(author), Some(by)) if by != author.name.as_str() => format!("{by}, according to {author}"),
            (Some(author), _) => author.to_string(),
            (None, by) => by.unwrap_or_else(|| "a client".to_owned()),
        }
    }

    /// Returns the person that answers. The node of a dashboard is left out: another one may repeat the
    /// answer.
    fn person(&self, by: Option<String>) -> String {
        match self.requester.as_ref().map(|requester| &requester.author.name) {
            None => self.responsible(by),
            Some(name) => match by.filter(|by| !by.trim().is_empty() && by != name.as_str()) {
                Some(by) => format!("{by}, according to {name}"),
                None => name.to_string(),
            },
        }
    }

    /// Confirms with a majority that this node still leads: its ledger contains everything that was
    /// acknowledged. A reply that follows no commit needs it, since a leader that is lost to a majority
    /// may count itself leader while another is elected.
    pub(super) async fn confirm_leadership(&self) -> Result<(), ApiError> {
        self.replica.ensure_leader(COMMIT_TIMEOUT).await.map_err(|problem| not_committed(&problem))
    }

    /// Returns a copy of the ledger, with everything that was acknowledged.
    async fn backup(&self) -> Result<Value, ApiError> {
        self.confirm_leadership().await?;
        let (last, ledger) = self.replica.copy();
        let last = last.ok_or_else(|| "the ledger is empty".to_owned())?;
        let backup = Backup::new(&ledger, last, self.fleet.clone(), self.node.clone(), self.time_ms()?)
            .map_err(|problem| problem.to_string())?;
        let copy = json(backup);
        match copy.to_string().len() {
            size if size > MESSAGE_MAX => Err(format!(
                "the copy takes {size} bytes; a message is limited to {MESSAGE_MAX}. Stop a voter and copy its data \
                 directory"
            )
            .into()),
            _ => Ok(copy),
        }
    }

    /// Returns the wire versions that each node reads and, on request, raises the version that the
    /// fleet writes.
    async fn upgrade(&self, payload: &[u8]) -> Result<UpgradeReply, ApiError> {
        let UpgradeRequest { finish } = parse_request(ApiCall::Upgrade, payload)?;
        let wire = self.replica.read(Ledger::wire).unwrap_or(self.supported_versions.oldest);
        let required_readers = self.required_readers();
        let step = self.knowledge.read(|base| {
            UpgradeStatus::of(wire, self.supported_versions, required_readers.clone(), base.supported_versions())
        });
        match (finish, step) {
            (false, _) => Ok(self.upgrade_reply(wire, &required_readers)),
            (true, UpgradeStatus::Newest) => Err(format!(
                "the fleet writes wire version {wire}, and the coordinator {} reads no later version: upgrade \
                 the nodes first",
                self.node
            )
            .into()),
            (true, UpgradeStatus::Blocked { next, behind }) => {
                let alive = |node: &NodeId| if self.knowledge.is_alive(node) { "" } else { ", is down" };
                let describe = |(node, reads): (&NodeId, &Option<VersionRange>)| match reads {
                    Some(reads) => format!("{node} (reads {reads}{})", alive(node)),
                    None => format!("{node} (no record of it)"),
                };
                Err(format!(
                    "not yet: wire version {next} is not read by {}; upgrade these nodes first",
                    behind.iter().map(describe).collect::<Vec<_>>().join(", ")
                )
                .into())
            }
            (true, UpgradeStatus::Ready { next }) => {
                let (by, at_ms) = (self.responsible(None), self.audit_ms());
                let raised = self.propose(Command::RaiseWireVersion { wire: next, by, at_ms }).await;
                raised.map_err(|problem| not_committed(&problem))?;
                Ok(self.upgrade_reply(next, &required_readers))
            }
        }
    }

    /// Returns the nodes that must read what the fleet writes, with or without a record here:
    /// voters of the ledger and holders of roles.
    fn required_readers(&self) -> BTreeSet<NodeId> {
        let voters: Vec<NodeId> = self.replica.leadership().borrow().voters.values().cloned().collect();
        let holders = self.replica.read(|ledger| {
            let holders = ledger.active_missions().into_iter().flat_map(|entry| entry.holders().into_values());
            holders.map(NodeId::from).collect::<Vec<_>>()
        });
        voters.into_iter().chain(holders).collect()
    }

    fn upgrade_reply(&self, wire: u8, required_readers: &BTreeSet<NodeId>) -> UpgradeReply {
        let next = wire.checked_add(1).filter(|next| self.supported_versions.contains(*next));
        let reads: BTreeMap<NodeId, Option<VersionRange>> = self.knowledge.read(|base| {
            let known =
                base.iter().map(|(node, stored)| (node.clone(), Some(stored.record.knowledge.supported_versions)));
            required_readers.iter().map(|node| (node.clone(), None)).chain(known).collect()
        });
        let versions = |(node, reads): (NodeId, Option<VersionRange>)| NodeVersions {
            alive: node == self.node || self.knowledge.is_alive(&node),
            oldest: reads.map(|reads| reads.oldest),
            newest: reads.map(|reads| reads.newest),
            ready: next.map(|next| reads.is_some_and(|reads| reads.contains(next))),
            node,
        };
        UpgradeReply { wire, next, nodes: reads.into_iter().map(versions).collect() }
    }

    async fn change(&self, mission: MissionId, command: Command) -> Result<MissionChangeReply, ApiError> {
        match self.propose(command).await {
            Ok(CommandOutcome::Refused(refused)) => Err(refused.to_string().into()),
            Ok(_) => {
                let state = self.replica.read(|ledger| ledger.mission_state(&mission).cloned());
                Ok(MissionChangeReply { mission, state })
            }
            Err(problem) => Err(not_committed(&problem)),
        }
    }

    /// Proposes a command with the texts of the client shortened.
    pub(super) async fn propose(&self, command: Command) -> Result<CommandOutcome, ProposeError> {
        self.replica.propose(command.limited(), COMMIT_TIMEOUT).await
    }
}

pub(super) fn not_committed(problem: &ProposeError) -> ApiError {
    match problem {
        ProposeError::TooLarge { .. } | ProposeError::Unencodable { .. } => problem.to_string().into(),
        _ => ApiError { text: format!("{problem}; the same request may be sent again"), may_retry: true },
    }
}

/// Returns what a request changes about a schedule; `None` if it is repeated.
fn schedule_change(action: ScheduleAction, known: Option<&ScheduleEntry>) -> Option<ScheduleChange> {
    let is_paused = known.map(|entry| entry.pause.is_some());
    match (action, is_paused) {
        (ScheduleAction::Add, None) => Some(ScheduleChange::Added),
        (ScheduleAction::Pause, Some(false)) => Some(ScheduleChange::Paused),
        (ScheduleAction::Resume, Some(true)) => Some(ScheduleChange::Resumed),
        (ScheduleAction::Remove, Some(_)) => Some(ScheduleChange::Removed),
        _ => None,
    }
}
