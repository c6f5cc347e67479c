//! View of the schedules.

use super::readable;
use crate::ids::{ScheduleId, TaskId};
use crate::ledger::{MissedOccurrences, Occurrence, Priority, Schedule, ScheduleEntry, SchedulePause};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The schedules.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SchedulesView {
    /// Schedules, by name.
    #[serde(deserialize_with = "readable")]
    pub schedules: Vec<ScheduleView>,
}

/// A schedule.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ScheduleView {
    /// Its name.
    pub schedule: ScheduleId,
    /// Name of its mission.
    pub mission: TaskId,
    /// Parameters of its mission.
    #[serde(default)]
    pub parameters: BTreeMap<String, String>,
    /// Priority of its missions.
    #[serde(default)]
    pub priority: Priority,
    /// Times, in the format of cron.
    pub cron: String,
    /// Time zone.
    pub zone: String,
    /// Time after which there are no occurrences, in milliseconds since 1970; null without an end.
    #[serde(default)]
    pub until_ms: Option<u64>,
    /// What becomes of missed occurrences.
    #[serde(default)]
    pub missed: MissedOccurrences,
    /// Time from an occurrence to the deadline of its mission, in milliseconds; null without a deadline.
    #[serde(default)]
    pub deadline_after_ms: Option<u64>,
    /// Person that added it.
    #[serde(default)]
    pub by: String,
    /// Time of its next occurrence in milliseconds since 1970; null if it is paused, or has ended.
    #[serde(default)]
    pub next_ms: Option<u64>,
    /// Its pause; null if it is not paused.
    #[serde(default)]
    pub pause: Option<SchedulePause>,
    /// Number of submitted occurrences.
    #[serde(default)]
    pub submitted: u64,
    /// Latest submitted occurrence.
    #[serde(default)]
    pub last: Option<Occurrence>,
}

impl ScheduleView {
    /// Returns the view of a schedule with this next occurrence.
    pub fn of(entry: &ScheduleEntry, next_ms: Option<u64>) -> ScheduleView {
        let ScheduleEntry { schedule, pause, submitted, last, .. } = entry;
        let Schedule { id, rule, submission, deadline_after_ms } = schedule;
        ScheduleView {
            schedule: id.clone(),
            mission: submission.mission.name.clone(),
            parameters: submission.parameters.clone(),
            priority: submission.priority,
            cron: rule.cron.clone(),
            zone: rule.zone.clone(),
            until_ms: rule.until_ms,
            missed: rule.missed,
            deadline_after_ms: *deadline_after_ms,
            by: submission.by.clone(),
            next_ms: next_ms.filter(|_| pause.is_none()),
            pause: pause.clone(),
            submitted: *submitted,
            last: last.clone(),
        }
    }
}
