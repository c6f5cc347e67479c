//! Occurrences of schedules that are due.

use crate::recurrence::{DueOccurrence, Recurrence};
use consort_protocol::ids::ScheduleId;
use consort_protocol::ledger::{Command, Ledger, ScheduleEntry};
use consort_protocol::units::NodeTime;
use std::collections::BTreeMap;
use std::time::Duration;

/// Delay before a command about a schedule is proposed again.
const RETRY_DELAY: Duration = Duration::from_secs(1);

/// Schedules of a leader session.
#[derive(Default)]
pub(super) struct Schedules {
    known: BTreeMap<ScheduleId, KnownSchedule>,
}

/// A schedule with its next occurrence.
struct KnownSchedule {
    entry: ScheduleEntry,
    /// `None` if this release cannot read the rule.
    recurrence: Option<Recurrence>,
    /// Next occurrence in milliseconds since 1970; `None` if there is none.
    next_ms: Option<u64>,
    /// Time of the latest proposal.
    proposed_at: Option<NodeTime>,
}

impl KnownSchedule {
    fn of(entry: &ScheduleEntry) -> KnownSchedule {
        let recurrence = Recurrence::parse(&entry.schedule.rule).ok();
        let next_ms = recurrence.as_ref().and_then(|recurrence| recurrence.next_after(entry.handled_ms));
        KnownSchedule { entry: entry.clone(), recurrence, next_ms, proposed_at: None }
    }
}

impl Schedules {
    /// Returns the commands for the occurrences that are due. `now_ms` is the time of day that a majority of the voters
    /// confirms, in milliseconds since 1970. A fleet without room for further missions submits none.
    pub(super) fn due(&mut self, ledger: &Ledger, now: NodeTime, now_ms: u64, has_room: bool) -> Vec<Command> {
        self.known.retain(|id, _| ledger.schedule(id).is_some());
        let mut commands = vec![];
        for entry in ledger.schedules() {
            let known = self.known.entry(entry.schedule.id.clone()).or_insert_with(|| KnownSchedule::of(entry));
            if known.entry != *entry {
                *known = KnownSchedule::of(entry);
            }
            let is_due = known.next_ms.is_some_and(|next| next <= now_ms) && entry.pause.is_none();
            let may_propose = known.proposed_at.is_none_or(|at| now.since(at) >= RETRY_DELAY);
            let Some(recurrence) = known.recurrence.as_ref().filter(|_| is_due && may_propose) else { continue };
            let (schedule, after_ms) = (entry.schedule.id.clone(), entry.handled_ms);
            let command = match recurrence.due(entry.schedule.rule.missed, after_ms, now_ms) {
                Some(DueOccurrence::Submit(due_ms)) if has_room => {
                    Command::SubmitOccurrence { schedule, after_ms, due_ms, at_ms: now_ms }
                }
                Some(DueOccurrence::SkipUntil(until_ms)) => Command::SkipOccurrences { schedule, after_ms, until_ms },
                Some(DueOccurrence::Submit(_)) | None => continue,
            };
            known.proposed_at = Some(now);
            commands.push(command);
        }
        commands
    }
}
