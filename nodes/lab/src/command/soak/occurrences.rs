//! A schedule of missions, and what must hold about its occurrences.

use super::names::ROOMS;
use consort_protocol::view::{MissionSummary, MissionsView};
use consort_skills::workload::Workload;
use consort_tests::history::RecordingClient;
use consort_text::count;
use serde_json::{Value, json};

/// Name of the schedule.
const SCHEDULE: &str = "soak-rounds";

/// Person that adds the schedule.
const BY: &str = "soak schedule";

/// Interval of the occurrences: the smallest of schedules.
const INTERVAL_MS: u64 = 60_000;

/// Longest time for which an occurrence may be due at the pause: several faults in a row leave no coordinator.
const OVERDUE_MAX_MS: u64 = 120_000;

/// The occurrences of the schedule up to its pause. Times are in milliseconds since 1970.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Occurrences {
    /// Time of the first.
    first_ms: u64,
    /// Time of the last that was submitted; `None` if none was.
    last_ms: Option<u64>,
    /// Time of the pause.
    paused_ms: u64,
    /// Number of submitted occurrences, as the schedule states it.
    pub(super) submitted: u64,
}

/// Adds the schedule: a mission each minute, and missed occurrences are submitted later. Returns the time of its first
/// occurrence, in milliseconds since 1970.
///
/// # Errors
/// The reply without such a time.
pub(super) async fn add(client: &RecordingClient, workload: &Workload) -> Result<u64, String> {
    let submit = workload.request("lab-samples", workload.parameters_in("lab-samples", ROOMS[0]));
    let request = json!({
        "schedule": SCHEDULE,
        "action": "add",
        "cron": "* * * * *",
        "missed": "all",
        "submit": submit,
        "by": BY,
    });
    first_ms(&client.change_schedule(&request).await)
}

/// Pauses the schedule, whose first occurrence was due at `first_ms`, and returns its occurrences.
///
/// # Errors
/// The reply without a schedule.
pub(super) async fn pause(client: &RecordingClient, first_ms: u64) -> Result<Occurrences, String> {
    let request = json!({ "schedule": SCHEDULE, "action": "pause", "by": BY });
    Occurrences::of(&client.change_schedule(&request).await, first_ms)
}

/// Returns the time of the first occurrence of an added schedule. An attempt without a reply may have added it before.
fn first_ms(reply: &Value) -> Result<u64, String> {
    let schedule = &reply["schedule"];
    let next = schedule["next_ms"].as_u64().zip(schedule["submitted"].as_u64());
    let first = next.and_then(|(next_ms, submitted)| next_ms.checked_sub(submitted * INTERVAL_MS));
    first.ok_or_else(|| format!("the schedule was not added: {reply}"))
}

impl Occurrences {
    fn of(reply: &Value, first_ms: u64) -> Result<Occurrences, String> {
        let schedule = &reply["schedule"];
        let paused = schedule["submitted"].as_u64().zip(schedule["pause"]["since_ms"].as_u64());
        let (submitted, paused_ms) = paused.ok_or_else(|| format!("the schedule was not paused: {reply}"))?;
        Ok(Occurrences { first_ms, last_ms: schedule["last"]["due_ms"].as_u64(), paused_ms, submitted })
    }

    /// Checks that each occurrence was submitted once, and that each is a mission.
    ///
    /// # Errors
    /// Description of the difference.
    pub(super) fn check(&self, missions: &MissionsView) -> Result<(), String> {
        let due = self.last_ms.map_or(0, |last_ms| last_ms.saturating_sub(self.first_ms) / INTERVAL_MS + 1);
        let found = missions.missions.iter().filter(|mission| is_occurrence(mission)).count() as u64;
        let overdue_ms = self.paused_ms.saturating_sub(self.first_ms + due * INTERVAL_MS);
        if overdue_ms > OVERDUE_MAX_MS {
            let (submitted, overdue_s) = (count(due, "occurrence", "occurrences"), overdue_ms / 1_000);
            return Err(format!("the schedule stopped after {submitted}: the next was due for {overdue_s} s"));
        }
        match (self.submitted, found) == (due, due) {
            true => Ok(()),
            false => Err(format!(
                "{due} occurrences of the schedule were due, {} were submitted, and there are {found} missions of them",
                self.submitted
            )),
        }
    }
}

/// Checks whether a mission is an occurrence of the schedule. A closed fleet also states the person of the certificate,
/// before the schedule.
pub(super) fn is_occurrence(mission: &MissionSummary) -> bool {
    let by = &mission.brief.terms.by;
    by.starts_with(BY) && by.ends_with(&format!(", schedule {SCHEDULE}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const FIRST: u64 = 1_790_000_040_000;

    /// Returns the occurrences up to a pause that comes this number of minutes after the first.
    fn of(submitted: u64, last_ms: Option<u64>, pause_minutes: u64) -> Occurrences {
        let last = last_ms.map(|due_ms| json!({ "due_ms": due_ms, "mission": "lab-samples-1" }));
        let pause = json!({ "by": BY, "since_ms": FIRST + pause_minutes * INTERVAL_MS });
        let schedule = json!({ "submitted": submitted, "last": last, "pause": pause });
        Occurrences::of(&json!({ "schedule": schedule }), FIRST).unwrap()
    }

    #[test]
    fn an_occurrence_that_is_lost_or_submitted_twice_is_found() {
        let none = MissionsView::default();
        assert_eq!(of(0, None, 0).check(&none), Ok(()));
        let difference = |due, submitted| {
            format!(
                "{due} occurrences of the schedule were due, {submitted} were submitted, and there are 0 missions of them"
            )
        };
        for (submitted, minutes, due) in [(2, 0, 1), (2, 2, 3), (3, 2, 3)] {
            let last_ms = Some(FIRST + minutes * INTERVAL_MS);
            assert_eq!(of(submitted, last_ms, minutes).check(&none), Err(difference(due, submitted)));
        }
    }

    #[test]
    fn a_schedule_that_submits_nothing_more_is_found() {
        let none = MissionsView::default();
        assert_eq!(of(0, None, 2).check(&none), Ok(()), "there may be no coordinator");
        let stopped = "the schedule stopped after 0 occurrences: the next was due for 180 s";
        assert_eq!(of(0, None, 3).check(&none), Err(stopped.to_owned()));
        let stopped = "the schedule stopped after 1 occurrence: the next was due for 180 s";
        assert_eq!(of(1, Some(FIRST), 4).check(&none), Err(stopped.to_owned()));
    }

    #[test]
    fn the_first_occurrence_is_that_of_the_first_attempt_to_add_the_schedule() {
        let reply =
            |submitted| json!({ "schedule": { "submitted": submitted, "next_ms": FIRST + submitted * INTERVAL_MS } });
        assert_eq!([first_ms(&reply(0)), first_ms(&reply(1))], [Ok(FIRST), Ok(FIRST)]);
        let refused = json!({ "error": "no" });
        assert_eq!(first_ms(&refused), Err(format!("the schedule was not added: {refused}")));
    }
}
