//! The course of requests to people: they are asked, answered, escalated, expired and withdrawn.

use super::apply::Ledger;
use super::branch::Branch;
use super::command::CommandOutcome;
use super::command_error::CommandError;
use super::entry::{MissionEntry, MissionState, RolePhase};
use super::person_request::{
    AnswerContent, FinalAnswer, PersonAnswer, PersonQuestion, PersonRequestEntry, PersonRequestId, PersonRequestPhase,
    Postponement, RequestEscalation, RequestSubject, TaskQuestion,
};
use crate::cause::CauseClass;
use crate::ids::{MissionId, PlaceId, RobotId, RoleId, TaskId};
use crate::lease::{Epoch, RoleHolder};
use crate::mission::{Escalation, RoleKind, TaskOutcome, TaskSpec, ValueKind};
use crate::plan::StepIndex;
use std::collections::BTreeMap;

/// Maximum number of closed requests kept with a mission, for display and for late answers.
const CLOSED_MAX: usize = 16;

/// Times of a new request.
struct RequestTimes {
    /// Time of the request in milliseconds since 1970.
    asked_ms: u64,
    /// Seconds after which it expires; `None` if it does not.
    patience_s: Option<u32>,
    /// Its escalation, if any.
    escalation: Option<Box<Escalation>>,
}

/// Consequence of an answer for its mission.
enum AfterAnswer {
    /// Nothing.
    Nothing,
    /// Its completion is to be checked.
    CheckCompletion,
    /// It fails: the task was not done.
    Fail {
        /// Cause, as text.
        cause: String,
        /// The task.
        task: TaskId,
    },
}

impl MissionEntry {
    /// Returns the requests with their ids, oldest first.
    pub fn person_requests(&self) -> impl Iterator<Item = (PersonRequestId, &PersonRequestEntry)> {
        self.person_requests.iter().map(|request| (self.request_id(request.number), request))
    }

    fn request_id(&self, number: u32) -> PersonRequestId {
        PersonRequestId { mission: self.id.clone(), number }
    }

    /// Returns a request by its number.
    pub fn person_request(&self, number: u32) -> Option<&PersonRequestEntry> {
        self.person_requests.iter().find(|request| request.number == number)
    }

    /// Returns the requested task, with the results of earlier tasks as parameters. `None` if the mission
    /// has taken another branch since.
    pub fn requested_task(&self, request: &PersonRequestEntry) -> Option<TaskSpec> {
        let step = match &request.subject {
            RequestSubject::Step(step) => *step,
            RequestSubject::Question { question, .. } => return question.task(),
        };
        let plan = self.plan(&request.role).filter(|_| request.branch == self.branch)?;
        let mut spec = plan.step_task(step)?.1.clone();
        // The coordinator has asked, so the results were known.
        let _ = spec.set_inputs(&self.outcomes_for(&request.role));
        Some(spec)
    }

    /// Returns the results that the answer to a request states.
    pub fn form_of(&self, request: &PersonRequestEntry) -> BTreeMap<String, ValueKind> {
        if let RequestSubject::Question { .. } = request.subject {
            return PersonQuestion::form();
        }
        let spec = self.requested_task(request);
        let form = spec
            .filter(|spec| self.is_of_people(spec))
            .and_then(|spec| self.submission.forms.get(&spec.task_type).cloned());
        form.unwrap_or_default()
    }

    /// Checks whether no robot takes part in a task: a robot returns the results itself.
    fn is_of_people(&self, spec: &TaskSpec) -> bool {
        spec.roles.iter().all(|role| self.roles.get(role).is_some_and(|role| role.kind == RoleKind::Unmanaged))
    }

    /// Returns the open request to the person of a role for a task of this role.
    pub fn open_request_to(&self, role: &RoleId) -> Option<&PersonRequestEntry> {
        self.person_requests.iter().find(|request| {
            request.is_open() && request.role == *role && matches!(request.subject, RequestSubject::Step(_))
        })
    }

    /// Returns the open questions, with the roles of the robots that ask.
    pub fn open_questions(&self) -> impl Iterator<Item = (&RoleId, &PersonRequestEntry)> {
        let open = self.person_requests.iter().filter(|request| request.is_open_question());
        open.filter_map(|request| Some((request.robots.keys().next()?, request)))
    }

    /// Returns the request of a question that the holder of a role has asked under this award, open or
    /// closed. A withdrawn question counts as not asked.
    pub fn question(&self, role: &RoleId, epoch: Epoch, asked: &TaskQuestion) -> Option<&PersonRequestEntry> {
        self.person_requests.iter().find(|request| {
            let is_equal = matches!(&request.subject, RequestSubject::Question { number, question, .. }
                if *number == asked.number && *question == asked.question);
            let is_withdrawn = matches!(request.phase, PersonRequestPhase::Withdrawn { .. });
            let is_by_holder = request.robots.get(role).is_some_and(|holder| holder.epoch == epoch);
            is_equal && is_by_holder && request.task == asked.task && !is_withdrawn
        })
    }

    /// Checks whether the question of a role's holder is missing, or is open although the holder no longer
    /// asks.
    pub fn lacks_question(&self, role: &RoleId, epoch: Epoch, asked: &TaskQuestion) -> bool {
        match self.question(role, epoch, asked) {
            None => asked.is_open,
            Some(request) => request.is_open() && !asked.is_open,
        }
    }

    /// Replaces the open question of a role's holder, or withdraws it. A holder that has restarted and has
    /// not asked yet leaves it open.
    fn set_question(&mut self, role: &RoleId, asked: TaskQuestion, asked_ms: u64) {
        let Some(holder) = self.role_holders().remove(role) else { return };
        let known = self.question(role, holder.epoch, &asked).map(|request| request.number);
        let kept = known.filter(|_| asked.is_open);
        let of_holder =
            |request: &&mut PersonRequestEntry| request.is_open_question() && request.robots.contains_key(role);
        let questions = self.person_requests.iter_mut().filter(of_holder);
        for request in questions.filter(|request| Some(request.number) != kept) {
            let reason = format!("{} no longer asks", holder.robot);
            request.phase = PersonRequestPhase::Withdrawn { reason };
        }
        if asked.is_open && known.is_none() {
            let TaskQuestion { task, number, question, .. } = asked;
            let (to, patience_s, escalation) = (question.to.clone(), question.patience_s, question.escalation.clone());
            let times = RequestTimes { asked_ms, patience_s, escalation };
            let subject = RequestSubject::Question { number, question, answer: None };
            let robots = BTreeMap::from([(role.clone(), holder)]);
            self.add_request(to, subject, task, robots, times);
        }
        self.drop_old_requests();
    }

    /// Adds an open request.
    fn add_request(
        &mut self,
        role: RoleId,
        subject: RequestSubject,
        task: TaskId,
        robots: BTreeMap<RoleId, RoleHolder>,
        times: RequestTimes,
    ) {
        let RequestTimes { asked_ms, patience_s, escalation } = times;
        let after = |seconds: u32| asked_ms.saturating_add(u64::from(seconds) * 1000);
        self.person_requests.push(PersonRequestEntry {
            number: self.person_requests.last().map_or(1, |last| last.number.saturating_add(1)),
            branch: self.branch,
            role,
            subject,
            task,
            robots,
            asked_ms,
            expires_ms: patience_s.map(after),
            escalation: escalation.map(|escalation| RequestEscalation {
                due_ms: after(escalation.after_s),
                to: escalation.to,
                escalated_ms: None,
            }),
            phase: PersonRequestPhase::Open { postponed: None },
        });
    }

    /// Requests a task of a person. A repeated command has no effect; neither has a command for a role
    /// without a holder.
    fn ask(&mut self, role: &RoleId, step: StepIndex, asked_ms: u64) {
        let is_due =
            self.roles.get(role).is_some_and(|entry| entry.kind == RoleKind::Unmanaged && !entry.ended.contains(&step));
        let Some((task, spec)) = self.plan(role).and_then(|plan| plan.step_task(step)) else { return };
        let holders = self.role_holders();
        let named = self.roles.iter().filter(|(id, entry)| entry.kind == RoleKind::Managed && spec.names(id));
        let robots: Option<BTreeMap<RoleId, RoleHolder>> =
            named.map(|(id, _)| Some((id.clone(), holders.get(id)?.clone()))).collect();
        let Some(robots) = robots.filter(|_| is_due && self.open_request_to(role).is_none()) else { return };
        let times = RequestTimes { asked_ms, patience_s: spec.patience_s, escalation: spec.escalation.clone() };
        let task = task.clone();
        self.add_request(role.clone(), RequestSubject::Step(step), task, robots, times);
        self.drop_old_requests();
    }

    /// Drops the oldest closed requests beyond their maximum number.
    fn drop_old_requests(&mut self) {
        while self.person_requests.iter().filter(|request| !request.is_open()).count() > CLOSED_MAX
            && let Some(oldest) = self.person_requests.iter().position(|request| !request.is_open())
        {
            self.person_requests.remove(oldest);
        }
    }

    /// Records an answer. The first answer counts; the same person may repeat it.
    fn answer(&mut self, number: u32, mut answer: PersonAnswer) -> Result<AfterAnswer, CommandError> {
        answer.limit();
        let PersonAnswer { by, content, note, at_ms } = answer;
        let Some(request) = self.person_request(number) else {
            return Err(CommandError::NoPersonRequest { request: self.request_id(number) });
        };
        if let PersonRequestPhase::Answered { by: first, answer: given, .. } = &request.phase
            && *first == by
            && self.is_repetition(request, *given, &content)
        {
            return Ok(AfterAnswer::Nothing);
        }
        let (is_open, phase) = (request.is_open(), request.phase.to_string());
        let (role, task) = (request.role.clone(), request.task.clone());
        if !is_open {
            return Err(CommandError::PersonRequestClosed { request: self.request_id(number), phase });
        }
        let mut found = self.person_requests.iter_mut().filter(|request| request.number == number);
        let Some(request) = found.next() else { return Ok(AfterAnswer::Nothing) };
        let person = if by == role.as_str() { by.clone() } else { format!("{by} as {role}") };
        let because = if note.is_empty() { String::new() } else { format!(": {note}") };
        let (closing, after) = match content {
            AnswerContent::Later(until_ms) => {
                request.postpone(Postponement { by, until_ms }, at_ms);
                return Ok(AfterAnswer::Nothing);
            }
            AnswerContent::Done(results) => {
                request.phase = PersonRequestPhase::Answered { by, answer: FinalAnswer::Done, note, at_ms };
                let step = match &mut request.subject {
                    RequestSubject::Step(step) => *step,
                    RequestSubject::Question { answer, .. } => {
                        *answer = Some(PersonQuestion::answer_in(&results));
                        return Ok(AfterAnswer::Nothing);
                    }
                };
                self.end_steps(&role, [step]);
                if !results.is_empty() {
                    self.add_outcomes(&role, BTreeMap::from([(task, TaskOutcome::Done(results))]));
                }
                return Ok(AfterAnswer::CheckCompletion);
            }
            AnswerContent::Declined => (FinalAnswer::Declined, format!("{person} declined to do {task}{because}")),
            AnswerContent::Cannot => (FinalAnswer::Cannot, format!("{person} could not do {task}{because}")),
        };
        request.phase = PersonRequestPhase::Answered { by, answer: closing, note, at_ms };
        Ok(match request.subject {
            RequestSubject::Step(_) => AfterAnswer::Fail { cause: after, task },
            // The robot decides how to go on.
            RequestSubject::Question { .. } => AfterAnswer::Nothing,
        })
    }

    /// Checks whether an answer repeats the answer that was given.
    fn is_repetition(&self, request: &PersonRequestEntry, given: FinalAnswer, content: &AnswerContent) -> bool {
        match content {
            AnswerContent::Done(results) if given == FinalAnswer::Done => match &request.subject {
                RequestSubject::Step(_) => {
                    let known = self.outcomes.get(&request.task).and_then(TaskOutcome::results);
                    known.map_or(results.is_empty(), |known| known == results)
                }
                RequestSubject::Question { answer, .. } => *answer == Some(PersonQuestion::answer_in(results)),
            },
            AnswerContent::Done(_) => false,
            AnswerContent::Declined => given == FinalAnswer::Declined,
            AnswerContent::Cannot => given == FinalAnswer::Cannot,
            AnswerContent::Later(_) => false,
        }
    }

    /// Marks an open request as escalated when its time has come. Repeated, it has no effect.
    fn escalate_request(&mut self, number: u32, now_ms: u64) {
        let due =
            |request: &&mut PersonRequestEntry| request.number == number && request.is_escalation_due(Some(now_ms));
        let request = self.person_requests.iter_mut().find(due);
        if let Some(escalation) = request.and_then(|request| request.escalation.as_mut()) {
            escalation.escalated_ms = Some(now_ms);
        }
    }

    /// Closes an open request without an answer in time. Returns the cause for which the mission
    /// fails; `None` if the request is closed or was put off, and for a question: the robot decides how to
    /// go on.
    fn expire_request(&mut self, number: u32, now_ms: u64) -> Option<String> {
        let due = |request: &&mut PersonRequestEntry| {
            request.number == number && request.is_open() && request.expires_ms.is_some_and(|at| at <= now_ms)
        };
        let request = self.person_requests.iter_mut().find(due)?;
        let waited_s = now_ms.saturating_sub(request.asked_ms) / 1000;
        let cause = format!("nobody answered {} within {waited_s} s as {}", request.task, request.role);
        request.phase = PersonRequestPhase::Expired;
        matches!(request.subject, RequestSubject::Step(_)).then_some(cause)
    }

    /// Withdraws the open requests that are no longer needed.
    pub(super) fn withdraw_needless_requests(&mut self) {
        let (holders, branch) = (self.role_holders(), self.branch);
        let ended = match &self.state {
            MissionState::Pending | MissionState::Running => None,
            state => Some(format!("the state of the mission is {}", state.as_str().replace('_', " "))),
        };
        self.drop_old_requests();
        let asked_before: Vec<u32> = {
            let ended = self.open_questions().filter(|(_, request)| self.has_ended(&request.task));
            ended.map(|(_, request)| request.number).collect()
        };
        for request in self.person_requests.iter_mut().filter(|request| request.is_open()) {
            let lost = request.robots.iter().find(|(role, robot)| holders.get(*role) != Some(robot));
            let reason = match (&ended, lost) {
                (Some(reason), _) => reason.clone(),
                (None, _) if asked_before.contains(&request.number) => format!("{} has ended", request.task),
                (None, _) if request.branch != branch => "the mission executes its recovery branch".to_owned(),
                (None, Some((role, robot))) => format!("{} is no longer {role}", robot.robot),
                (None, None) => continue,
            };
            request.phase = PersonRequestPhase::Withdrawn { reason };
        }
    }

    /// Marks steps of a role as ended.
    pub(super) fn end_steps(&mut self, role: &RoleId, ended: impl IntoIterator<Item = StepIndex>) {
        let steps = self.plan(role).map_or(0, |plan| plan.steps.len());
        let Some(role) = self.roles.get_mut(role) else { return };
        role.ended.extend(ended.into_iter().filter(|step| (*step as usize) < steps));
        if role.ended.len() == steps {
            role.phase = RolePhase::Ended;
        }
    }
}

impl Ledger {
    pub(super) fn set_question(
        &mut self,
        mission: &MissionId,
        role: &RoleId,
        epoch: Epoch,
        asked: TaskQuestion,
        asked_ms: u64,
    ) -> Result<CommandOutcome, CommandError> {
        self.held_role(mission, role, epoch)?;
        self.active_mission(mission)?.set_question(role, asked, asked_ms);
        Ok(CommandOutcome::Done)
    }

    pub(super) fn ask_person(
        &mut self,
        mission: &MissionId,
        branch: Branch,
        role: &RoleId,
        step: StepIndex,
        asked_ms: u64,
    ) -> Result<CommandOutcome, CommandError> {
        self.in_branch(mission, branch)?.ask(role, step, asked_ms);
        Ok(CommandOutcome::Done)
    }

    pub(super) fn answer_person(
        &mut self,
        request: &PersonRequestId,
        answer: PersonAnswer,
        places: &BTreeMap<RobotId, PlaceId>,
    ) -> Result<CommandOutcome, CommandError> {
        let PersonRequestId { mission, number } = request;
        let Some(entry) = self.missions.get_mut(mission) else { return Err(self.no_mission(mission)) };
        match entry.answer(*number, answer)? {
            AfterAnswer::Nothing => Ok(CommandOutcome::Done),
            AfterAnswer::CheckCompletion => self.complete_if_done(mission),
            AfterAnswer::Fail { cause, task } => {
                let failed = MissionState::Failed { cause, class: CauseClass::Task };
                // A person who did not do the task has moved nothing.
                self.end(mission, failed, places, &|item_move| item_move.task == task)
            }
        }
    }

    pub(super) fn escalate_person_request(
        &mut self,
        request: &PersonRequestId,
        now_ms: u64,
    ) -> Result<CommandOutcome, CommandError> {
        self.active_mission(&request.mission)?.escalate_request(request.number, now_ms);
        Ok(CommandOutcome::Done)
    }

    pub(super) fn expire_person_request(
        &mut self,
        request: &PersonRequestId,
        now_ms: u64,
        places: &BTreeMap<RobotId, PlaceId>,
    ) -> Result<CommandOutcome, CommandError> {
        match self.active_mission(&request.mission)?.expire_request(request.number, now_ms) {
            Some(cause) => {
                let failed = MissionState::Failed { cause, class: CauseClass::Transient };
                self.end(&request.mission, failed, places, &|_| false)
            }
            None => Ok(CommandOutcome::Done),
        }
    }

    /// Returns the results that the answer to a request states; `None` if there is no such request.
    pub fn form_of(&self, request: &PersonRequestId) -> Option<BTreeMap<String, ValueKind>> {
        let entry = self.mission(&request.mission)?;
        Some(entry.form_of(entry.person_request(request.number)?))
    }

    /// Returns the open requests to people, with their missions, in the order in which missions are
    /// served.
    pub fn open_person_requests(&self) -> Vec<(&MissionEntry, &PersonRequestEntry)> {
        let open = |entry| {
            let requests = MissionEntry::person_requests(entry).map(|(_, request)| request);
            requests.filter(|request| request.is_open()).map(move |request| (entry, request))
        };
        self.missions_with_people().into_iter().flat_map(open).collect()
    }
}

#[cfg(test)]
mod tests;
