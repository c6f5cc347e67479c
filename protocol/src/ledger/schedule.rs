//! Schedule of a mission: its times, and the time up to which the ledger has handled it.

use super::person_request::PERSON_BYTES_MAX;
use super::submission::Submission;
use crate::bounds::limit_text;
use crate::ids::{MissionId, RequestId, ScheduleId};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Mission that is submitted at certain times.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Schedule {
    /// Name, chosen by a person.
    pub id: ScheduleId,
    /// Times.
    pub rule: ScheduleRule,
    /// Mission of each occurrence, with the person that has added the schedule. Its request, its times of
    /// submission and start, and its deadline are those of the occurrence.
    pub submission: Submission,
    /// Time from an occurrence to the deadline of its mission, in milliseconds.
    pub deadline_after_ms: Option<u64>,
}

/// Times of a schedule.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ScheduleRule {
    /// Pattern in the format of cron, such as `0 8 * * 1-5`.
    pub cron: String,
    /// Time zone of the IANA database, such as `Europe/Berlin`.
    pub zone: String,
    /// Time after which there are no occurrences, in milliseconds since 1970.
    pub until_ms: Option<u64>,
    /// What becomes of occurrences that were missed.
    pub missed: MissedOccurrences,
}

/// What becomes of the occurrences for which the fleet had no coordinator, or no room for missions.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MissedOccurrences {
    /// They are left out.
    #[default]
    Skip,
    /// The last of them is submitted late.
    Last,
    /// All of them are submitted late, one after the other.
    All,
}

impl MissedOccurrences {
    /// Returns the name.
    pub fn as_str(self) -> &'static str {
        match self {
            MissedOccurrences::Skip => "skip",
            MissedOccurrences::Last => "last",
            MissedOccurrences::All => "all",
        }
    }
}

/// Schedule in the ledger.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScheduleEntry {
    /// The schedule.
    pub schedule: Schedule,
    /// Present while it is paused: its occurrences are left out.
    pub pause: Option<SchedulePause>,
    /// Time up to which all occurrences have been submitted or left out, in milliseconds since 1970.
    pub handled_ms: u64,
    /// Number of submitted occurrences.
    pub submitted: u64,
    /// Latest submitted occurrence.
    pub last: Option<Occurrence>,
}

/// Pause of a schedule.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SchedulePause {
    /// Person that paused it.
    pub by: String,
    /// Start in milliseconds since 1970.
    pub since_ms: u64,
}

/// Submitted occurrence of a schedule.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Occurrence {
    /// Time at which it was due, in milliseconds since 1970.
    pub due_ms: u64,
    /// Its mission.
    pub mission: MissionId,
}

impl Schedule {
    /// Maximum number of schedules. Raised: a snapshot may be too large for every replica.
    pub const MAX: usize = 64;

    /// Maximum encoded size in bytes.
    pub const BYTES_MAX: usize = Submission::BYTES_MAX;

    /// Maximum number of characters of the id, which is a part of the ids of its requests.
    pub const ID_CHARS_MAX: usize = 40;
}

impl ScheduleEntry {
    /// Returns the mission of an occurrence that is submitted at `at_ms`, as request number `number`. It states the
    /// schedule beside the person.
    pub(super) fn occurrence(&self, due_ms: u64, at_ms: u64, number: u64) -> Submission {
        let Schedule { id, submission, deadline_after_ms, .. } = &self.schedule;
        let name: String = id.as_str().chars().take(Schedule::ID_CHARS_MAX).collect();
        let request = format!("{name}.{due_ms}.{number}");
        let mut by = format!("{}, schedule {id}", submission.by);
        limit_text(&mut by, PERSON_BYTES_MAX);
        Submission {
            by,
            request: RequestId::new(request).expect("a slug of 40 characters and two numbers form a slug"),
            deadline_ms: deadline_after_ms.map(|after_ms| due_ms.saturating_add(after_ms)),
            not_before_ms: None,
            at_ms,
            ..submission.clone()
        }
    }
}
