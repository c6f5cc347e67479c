//! Mission requests as submitted to the ledger: mission, recovery branch, priority, earliest start and
//! deadline.

use crate::ids::{RequestId, TaskType};
use crate::mission::{LostItem, Mission, ValueKind};
use crate::plan::{Division, StepAction};
use crate::schema::inline_schema;
use crate::units::Seconds;
use schemars::json_schema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;

/// Mission request, checked and divided.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Submission {
    /// Identifier of the request, chosen by the client: a repeated request is answered again and
    /// executed once.
    pub request: RequestId,
    /// Mission to execute.
    pub mission: Mission,
    /// Local plans of the roles; proven free of deadlock before submission.
    pub division: Division,
    /// Parameter values given by the client, for display.
    pub parameters: BTreeMap<String, String>,
    /// Branch to execute if a robot is lost that has an item.
    pub recovery: Option<RecoveryBranch>,
    /// Results that people state in their answers, by the type of the task.
    pub forms: BTreeMap<TaskType, BTreeMap<String, ValueKind>>,
    /// Person or client that asked for the mission, for display.
    pub by: String,
    /// Priority. Of two waiting missions the mission with higher priority is served first, then the mission that is due
    /// first, then the earlier mission.
    pub priority: Priority,
    /// Time before which no robot gets a role and no person is asked: milliseconds since 1970, by the
    /// clocks of a majority of the voters.
    pub not_before_ms: Option<u64>,
    /// Deadline: the earlier of the request's and the end of the mission's bound on time, in milliseconds since
    /// 1970 on the accepting coordinator's wall clock. Deadlines rely on the wall clocks of coordinators;
    /// leases never do.
    pub deadline_ms: Option<u64>,
    /// Time of submission: milliseconds on the accepting coordinator's wall clock. For display, for conditions of people,
    /// and for the order in which missions are served; it affects no other decision.
    pub at_ms: u64,
}

impl Submission {
    /// Creates a plain request: no recovery branch, default priority, no deadline, submitted at 0.
    pub fn of(request: RequestId, mission: Mission, division: Division) -> Submission {
        Submission {
            request,
            mission,
            division,
            parameters: BTreeMap::new(),
            recovery: None,
            forms: BTreeMap::new(),
            by: String::new(),
            priority: Priority::default(),
            not_before_ms: None,
            deadline_ms: None,
            at_ms: 0,
        }
    }
}

impl Submission {
    /// Checks whether the mission may start at a time in milliseconds since 1970. If the time is not known,
    /// only a mission without an earliest start may.
    pub fn may_start(&self, now_ms: Option<u64>) -> bool {
        self.not_before_ms.is_none_or(|from_ms| now_ms.is_some_and(|now_ms| from_ms <= now_ms))
    }

    /// Checks whether the mission may start within a time from now, in milliseconds since 1970, as [`may_start`](Self::may_start).
    pub fn may_start_within(&self, now_ms: Option<u64>, within: Seconds) -> bool {
        let within_ms = (within.get() * 1000.0) as u64;
        self.may_start(now_ms.map(|now_ms| now_ms.saturating_add(within_ms)))
    }
}

/// Recovery branch of a mission, divided and proven like the mission itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RecoveryBranch {
    /// Mission to execute.
    pub mission: Mission,
    /// Local plans of the roles.
    pub division: Division,
}

impl RecoveryBranch {
    /// Returns the branch with the lost item substituted; `None` if the branch uses a value that is
    /// not known.
    pub(super) fn filled(&self, lost: &LostItem) -> Option<RecoveryBranch> {
        let mut division = self.division.clone();
        for plan in division.plans.values_mut() {
            for step in &mut plan.steps {
                if let StepAction::Task { spec, .. } = &mut step.action {
                    *spec = lost.substitute(spec.clone())?;
                }
            }
            for (_, spec) in plan.alternatives.iter_mut().flat_map(|other| &mut other.tasks) {
                *spec = lost.substitute(spec.clone())?;
            }
        }
        Some(RecoveryBranch { mission: lost.substitute_mission(self.mission.clone())?, division })
    }
}

/// Priority of a mission: -100 to 100, higher first.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "i8", into = "i8")]
pub struct Priority(i8);

/// Error: a number is outside the range of priorities.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{0} is not a valid priority; allowed are -100 to 100, and higher priorities are served first")]
pub struct PriorityError(i64);

inline_schema!(Priority, json_schema!({ "type": "integer", "minimum": -100, "maximum": 100 }));

impl Priority {
    /// Creates a priority from a number.
    ///
    /// # Errors
    /// [`PriorityError`] if the number is outside -100 to 100.
    pub fn new(number: i64) -> Result<Self, PriorityError> {
        match i8::try_from(number) {
            Ok(small @ -100..=100) => Ok(Priority(small)),
            _ => Err(PriorityError(number)),
        }
    }

    /// Returns the number.
    pub fn get(self) -> i8 {
        self.0
    }
}

/// Maximum time until the earliest start or the deadline of a mission: ten years.
pub const TIME_AHEAD_MAX: Duration = Duration::from_secs(10 * 365 * 24 * 3600);

/// Error: the time until a deadline is not positive, or too long. Nothing was requested.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("the time must be more than 0 and at most {} seconds", TIME_AHEAD_MAX.as_secs())]
pub struct DeadlineError;

/// Parses the time until a deadline, in seconds from now.
///
/// # Errors
/// [`DeadlineError`] if the value is not a time, has passed, or is longer than ten years.
pub fn time_until_deadline(seconds: f64) -> Result<Duration, DeadlineError> {
    match Duration::try_from_secs_f64(seconds) {
        Ok(time) if seconds > 0.0 && time <= TIME_AHEAD_MAX => Ok(time),
        _ => Err(DeadlineError),
    }
}

impl TryFrom<i8> for Priority {
    type Error = PriorityError;
    fn try_from(number: i8) -> Result<Self, PriorityError> {
        Priority::new(number.into())
    }
}

impl From<Priority> for i8 {
    fn from(priority: Priority) -> i8 {
        priority.0
    }
}
