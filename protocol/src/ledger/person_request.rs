//! Requests to people: the tasks of unmanaged roles that a person has been asked to do, the questions of
//! robots in their tasks, and the answers.
//!
//! ```text
//!            answer: done, declined, cannot
//!  open ────────────────────────────────────▶ answered    the first answer counts
//!   │ ▲  later, escalated           patience is over
//!   │ └─────────────────┘ ────────────────────────────────▶ expired
//!   └── the mission ends, another robot is to be met, or the robot no longer asks ──▶ withdrawn
//! ```
//!
//! A request is part of the ledger, so it outlives every node, and any node can show it. The results
//! of a task that a person has done are outcomes like those of robots.

use super::branch::Branch;
use crate::bounds::{self, limit_text};
use crate::ids::{MissionId, PlaceId, RoleId, TaskId, TaskType};
use crate::lease::RoleHolder;
use crate::mission::{Escalation, TaskSpec, ValueKind};
use crate::plan::StepIndex;
use crate::scalar::Scalar;
use crate::schema::inline_schema;
use schemars::{JsonSchema, json_schema};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

/// Maximum size of the name of a person in the ledger, in bytes.
pub(super) const PERSON_BYTES_MAX: usize = 256;

/// Maximum size of the note of an answer, in bytes.
pub const NOTE_BYTES_MAX: usize = 512;

/// Id of a request to a person: the mission, and its number among the requests of the mission, as in
/// `vital-signs-1.2`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct PersonRequestId {
    /// The mission.
    pub mission: MissionId,
    /// Number among the requests of the mission, from 1.
    pub number: u32,
}

/// Error: a text is not the id of a request to a person.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a request to a person; an id is a mission, a dot and a number, as in vital-signs-1.2")]
pub struct PersonRequestIdError(String);

impl FromStr for PersonRequestId {
    type Err = PersonRequestIdError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let parts = text.rsplit_once('.').and_then(|(mission, number)| {
            let is_plain = !number.starts_with(['0', '+']);
            Some((MissionId::new(mission).ok()?, number.parse().ok().filter(|_| is_plain)?))
        });
        let (mission, number) = parts.ok_or_else(|| PersonRequestIdError(text.to_owned()))?;
        Ok(PersonRequestId { mission, number })
    }
}

impl TryFrom<String> for PersonRequestId {
    type Error = PersonRequestIdError;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

impl From<PersonRequestId> for String {
    fn from(id: PersonRequestId) -> String {
        id.to_string()
    }
}

impl fmt::Display for PersonRequestId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.mission, self.number)
    }
}

inline_schema!(PersonRequestId, json_schema!({ "type": "string", "pattern": r"^[A-Za-z0-9_.-]{1,64}\.[1-9][0-9]*$" }));

/// Request to a person.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PersonRequestEntry {
    /// Number among the requests of the mission, from 1.
    pub number: u32,
    /// Branch of the task.
    pub branch: Branch,
    /// Role of the people.
    pub role: RoleId,
    /// What they are asked for.
    pub subject: RequestSubject,
    /// Task of the person; for a question, the task in which the robot asks.
    pub task: TaskId,
    /// Robots that the person meets in the task, by role. For a question: the robot that asks.
    pub robots: BTreeMap<RoleId, RoleHolder>,
    /// Time of the request in milliseconds since 1970.
    pub asked_ms: u64,
    /// Time after which it expires, in milliseconds since 1970.
    pub expires_ms: Option<u64>,
    /// Escalation, if the task or the question states one.
    pub escalation: Option<RequestEscalation>,
    /// Phase.
    pub phase: PersonRequestPhase,
}

/// Escalation of a request to other people.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RequestEscalation {
    /// Their role.
    pub to: RoleId,
    /// Time from which they are asked, in milliseconds since 1970.
    pub due_ms: u64,
    /// Time at which the request was escalated, in milliseconds since 1970; `None` until then.
    pub escalated_ms: Option<u64>,
}

/// What a person is asked for.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum RequestSubject {
    /// The task of this step of the plan of an unmanaged role.
    Step(StepIndex),
    /// The answer to a question.
    Question {
        /// Number among the questions of the robot in its task, from 1.
        number: u32,
        /// The question.
        question: PersonQuestion,
        /// The answer, once a person has given it.
        answer: Option<String>,
    },
}

/// Question of a robot to people.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PersonQuestion {
    /// Role of the people.
    pub to: RoleId,
    /// The question.
    #[serde(deserialize_with = "bounds::text")]
    pub message: String,
    /// Place to which the question refers; without it, that of the robot.
    pub at: Option<PlaceId>,
    /// Seconds after which it expires; `None` if it does not.
    pub patience_s: Option<u32>,
    /// Escalation without an answer, as that of a task of people.
    pub escalation: Option<Box<Escalation>>,
}

/// Task type of a question.
const ASK_PERSON: &str = "ask_person";

/// Result of this task.
const ANSWER: &str = "answer";

impl PersonQuestion {
    /// Returns the question as a task of a person.
    pub(super) fn task(&self) -> Option<TaskSpec> {
        let mut spec = TaskSpec::of(TaskType::new(ASK_PERSON).ok()?, vec![self.to.clone()]);
        spec.parameters.insert("message".to_owned(), self.message.clone());
        spec.parameters.extend(self.at.iter().map(|at| ("at".to_owned(), at.to_string())));
        Some(spec)
    }

    /// Returns the results that the answer `done` states.
    pub(super) fn form() -> BTreeMap<String, ValueKind> {
        BTreeMap::from([(ANSWER.to_owned(), ValueKind::Text)])
    }

    /// Returns the answer in the results of the answer `done`.
    pub(super) fn answer_in(results: &BTreeMap<String, Scalar>) -> String {
        results.get(ANSWER).map(Scalar::to_string).unwrap_or_default()
    }
}

/// Question in a task of a robot, as the robot reports it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskQuestion {
    /// Task in which the robot asks.
    pub task: TaskId,
    /// Number among the questions of the robot in this task, from 1. A robot that restarts asks its
    /// questions again under the same numbers, and gets the same answers.
    pub number: u32,
    /// The question.
    pub question: PersonQuestion,
    /// False if the robot no longer asks.
    pub is_open: bool,
}

/// Phase of a request to a person.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PersonRequestPhase {
    /// Not answered yet.
    Open {
        /// The latest answer that puts it off.
        postponed: Option<Postponement>,
    },
    /// Answered.
    Answered {
        /// Person that answered.
        by: String,
        /// The answer.
        answer: FinalAnswer,
        /// Note of the person, or the cause for which the task was not done; may be empty.
        note: String,
        /// Time of the answer in milliseconds since 1970.
        at_ms: u64,
    },
    /// Not answered in time.
    Expired,
    /// No longer needed.
    Withdrawn {
        /// Reason, as text.
        reason: String,
    },
}

/// A person has put a request off.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Postponement {
    /// The person.
    pub by: String,
    /// Time until which the request is put off, in milliseconds since 1970.
    pub until_ms: u64,
}

/// Answer that closes a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FinalAnswer {
    /// The task is done.
    Done,
    /// The person does not want to do it.
    Declined,
    /// The person is not able to do it.
    Cannot,
}

impl FinalAnswer {
    /// Returns the name.
    pub fn as_str(self) -> &'static str {
        match self {
            FinalAnswer::Done => "done",
            FinalAnswer::Declined => "declined",
            FinalAnswer::Cannot => "cannot",
        }
    }
}

impl PersonRequestPhase {
    /// Checks whether the request is open.
    pub fn is_open(&self) -> bool {
        matches!(self, PersonRequestPhase::Open { .. })
    }

    /// Returns the reason for which the request was closed without the answer `done`; `None` if it
    /// is open or done.
    pub fn failure(&self) -> Option<String> {
        match self {
            PersonRequestPhase::Open { .. } | PersonRequestPhase::Answered { answer: FinalAnswer::Done, .. } => None,
            PersonRequestPhase::Answered { note, .. } if !note.is_empty() => Some(format!("{self}: {note}")),
            phase => Some(phase.to_string()),
        }
    }
}

impl fmt::Display for PersonRequestPhase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            PersonRequestPhase::Open { postponed: None } => f.write_str("open"),
            PersonRequestPhase::Open { postponed: Some(postponed) } => write!(f, "put off by {}", postponed.by),
            PersonRequestPhase::Answered { by, answer, .. } => write!(f, "answered by {by}: {}", answer.as_str()),
            PersonRequestPhase::Expired => f.write_str("expired"),
            PersonRequestPhase::Withdrawn { reason } => write!(f, "withdrawn: {reason}"),
        }
    }
}

/// Answer of a person.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PersonAnswer {
    /// Person that answers.
    pub by: String,
    /// Content of the answer.
    pub content: AnswerContent,
    /// Note of the person; may be empty.
    pub note: String,
    /// Time of the answer in milliseconds since 1970.
    pub at_ms: u64,
}

/// Content of an answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum AnswerContent {
    /// The task is done, with these results.
    Done(BTreeMap<String, Scalar>),
    /// The person does not want to do it.
    Declined,
    /// The person is not able to do it.
    Cannot,
    /// The person puts it off until this time, in milliseconds since 1970. The request stays open, and
    /// expires and escalates so much later.
    Later(u64),
}

impl PersonAnswer {
    /// Shortens the texts to their limits.
    pub(super) fn limit(&mut self) {
        limit_text(&mut self.by, PERSON_BYTES_MAX);
        limit_text(&mut self.note, NOTE_BYTES_MAX);
    }
}

impl PersonRequestEntry {
    /// Checks whether the request is open.
    pub fn is_open(&self) -> bool {
        self.phase.is_open()
    }

    /// Checks whether the request is the open question of a robot.
    pub(super) fn is_open_question(&self) -> bool {
        self.is_open() && matches!(self.subject, RequestSubject::Question { .. })
    }

    /// Checks whether it has expired at a time in milliseconds since 1970, if the time is known.
    pub fn is_due(&self, now_ms: Option<u64>) -> bool {
        self.expires_ms.zip(now_ms).is_some_and(|(at_ms, now_ms)| at_ms <= now_ms)
    }

    /// Checks whether it is to be escalated at a time in milliseconds since 1970, if the time is known.
    pub fn is_escalation_due(&self, now_ms: Option<u64>) -> bool {
        let pending = self.escalation.as_ref().filter(|escalation| escalation.escalated_ms.is_none());
        self.is_open() && pending.zip(now_ms).is_some_and(|(escalation, now_ms)| escalation.due_ms <= now_ms)
    }

    /// Returns the role to which the request was escalated; `None` before the escalation.
    pub fn escalated_to(&self) -> Option<&RoleId> {
        let escalation = self.escalation.as_ref().filter(|escalation| escalation.escalated_ms.is_some());
        escalation.map(|escalation| &escalation.to)
    }

    /// Returns the roles of the people that are asked.
    pub fn asked_roles(&self) -> impl Iterator<Item = &RoleId> {
        [&self.role].into_iter().chain(self.escalated_to())
    }

    /// Postpones the request. It expires and escalates later by the added time.
    pub(super) fn postpone(&mut self, postponement: Postponement, at_ms: u64) {
        let PersonRequestPhase::Open { postponed } = &mut self.phase else { return };
        let since_ms = postponed.as_ref().map_or(at_ms, |former| former.until_ms.max(at_ms));
        let delay_ms = postponement.until_ms.saturating_sub(since_ms);
        self.expires_ms = self.expires_ms.map(|expires_ms| expires_ms.saturating_add(delay_ms));
        if let Some(escalation) = self.escalation.as_mut().filter(|escalation| escalation.escalated_ms.is_none()) {
            escalation.due_ms = escalation.due_ms.saturating_add(delay_ms);
        }
        *postponed = Some(postponement);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_that_is_put_off_again_expires_and_escalates_as_much_later() {
        let mut request = PersonRequestEntry {
            number: 1,
            branch: Branch::Main,
            role: RoleId::new("clerk").unwrap(),
            subject: RequestSubject::Step(0),
            task: TaskId::new("deposit").unwrap(),
            robots: BTreeMap::new(),
            asked_ms: 0,
            expires_ms: Some(10_000),
            escalation: Some(RequestEscalation { to: RoleId::new("head").unwrap(), due_ms: 5_000, escalated_ms: None }),
            phase: PersonRequestPhase::Open { postponed: None },
        };
        for (at_ms, until_ms, expires_ms) in [(0, 60_000, 70_000), (1_000, 61_000, 71_000), (99_000, 100_000, 72_000)] {
            request.postpone(Postponement { by: "Nia".to_owned(), until_ms }, at_ms);
            assert_eq!(request.expires_ms, Some(expires_ms));
            assert_eq!(request.escalation.as_ref().map(|escalation| escalation.due_ms), Some(expires_ms - 5_000));
        }
    }

    #[test]
    fn an_id_is_a_mission_and_a_number() {
        let id: PersonRequestId = "vital-signs-1.2".parse().unwrap();
        assert_eq!(
            (id.mission.as_str(), id.number, id.to_string()),
            ("vital-signs-1", 2, "vital-signs-1.2".to_owned())
        );
        for wrong in ["vital-signs-1", "vital-signs-1.", ".1", "a.0", "a.01", "a.+1", "a.4294967296", "a b.1"] {
            let problem = wrong.parse::<PersonRequestId>().unwrap_err().to_string();
            assert!(problem.contains("an id is a mission, a dot and a number"), "{problem}");
        }
    }
}
