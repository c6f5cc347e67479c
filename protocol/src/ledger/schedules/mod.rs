//! Schedules: missions that are submitted again and again, at times of the day.
//!
//! A schedule contains a mission that was checked when the schedule was added. The coordinator computes the times,
//! since a ledger knows no time zones. It proposes each occurrence together with the time up to which the
//! ledger has handled the schedule. The ledger submits the mission and moves this time on with the
//! same command, so an occurrence is submitted once, whichever coordinators propose it.

use super::apply::Ledger;
use super::command::CommandOutcome;
use super::command_error::CommandError;
use super::history::HISTORY_SINCE;
use super::schedule::{Occurrence, Schedule, ScheduleEntry, SchedulePause};
use crate::codec;
use crate::ids::ScheduleId;
use std::sync::Arc;

impl Ledger {
    /// Returns the schedules, by id.
    pub fn schedules(&self) -> impl Iterator<Item = &ScheduleEntry> {
        self.schedule_entries().values().map(|entry| &**entry)
    }

    /// Returns a schedule.
    pub fn schedule(&self, id: &ScheduleId) -> Option<&ScheduleEntry> {
        self.schedule_entries().get(id).map(|entry| &**entry)
    }

    fn schedule_mut(&mut self, id: &ScheduleId) -> Result<&mut ScheduleEntry, CommandError> {
        let entry = self.schedule_entries_mut().get_mut(id).map(Arc::make_mut);
        entry.ok_or_else(|| CommandError::NoSchedule { schedule: id.clone() })
    }

    /// Adds a schedule, whose occurrences after `from_ms` count. The same schedule may be added again.
    pub(super) fn add_schedule(&mut self, schedule: Schedule, from_ms: u64) -> Result<CommandOutcome, CommandError> {
        if !self.keeps_history() {
            return Err(CommandError::NoSchedulesYet { since: HISTORY_SINCE });
        }
        if let Some(known) = self.schedule(&schedule.id) {
            return match known.schedule == schedule {
                true => Ok(CommandOutcome::Done),
                false => Err(CommandError::ScheduleExists { schedule: schedule.id }),
            };
        }
        let bytes = codec::encoded_size(&schedule);
        if bytes > Schedule::BYTES_MAX {
            return Err(CommandError::TooLarge { bytes: bytes as u64, max: Schedule::BYTES_MAX as u64 });
        }
        if self.schedule_entries().len() >= Schedule::MAX {
            return Err(CommandError::SchedulesFull);
        }
        let id = schedule.id.clone();
        let entry = ScheduleEntry { schedule, pause: None, handled_ms: from_ms, submitted: 0, last: None };
        self.schedule_entries_mut().insert(id, Arc::new(entry));
        Ok(CommandOutcome::Done)
    }

    pub(super) fn remove_schedule(&mut self, id: &ScheduleId) -> Result<CommandOutcome, CommandError> {
        self.schedule_mut(id)?;
        self.schedule_entries_mut().remove(id);
        Ok(CommandOutcome::Done)
    }

    /// Pauses a schedule. The first pause counts.
    pub(super) fn pause_schedule(
        &mut self,
        id: &ScheduleId,
        pause: SchedulePause,
    ) -> Result<CommandOutcome, CommandError> {
        self.schedule_mut(id)?.pause.get_or_insert(pause);
        Ok(CommandOutcome::Done)
    }

    /// Resumes a schedule. Occurrences up to this time are left out.
    pub(super) fn resume_schedule(&mut self, id: &ScheduleId, at_ms: u64) -> Result<CommandOutcome, CommandError> {
        let entry = self.schedule_mut(id)?;
        if entry.pause.take().is_some() {
            entry.handled_ms = entry.handled_ms.max(at_ms);
        }
        Ok(CommandOutcome::Done)
    }

    /// Submits the mission of an occurrence.
    pub(super) fn submit_occurrence(
        &mut self,
        id: &ScheduleId,
        after_ms: u64,
        due_ms: u64,
        at_ms: u64,
    ) -> Result<CommandOutcome, CommandError> {
        let entry = self.unhandled(id, after_ms, due_ms)?;
        // A client may have used the id of a request.
        let mut requests = (entry.submitted..).map(|number| entry.occurrence(due_ms, at_ms, number));
        let submission = requests.find(|submission| !self.remembers(&submission.request)).expect("an unused number");
        self.check_room(&submission)?;
        let mission = self.add_mission(submission);
        let entry = self.schedule_mut(id)?;
        entry.handled_ms = due_ms;
        entry.submitted += 1;
        entry.last = Some(Occurrence { due_ms, mission: mission.clone() });
        Ok(CommandOutcome::Submitted { mission, again: false })
    }

    /// Leaves out the occurrences up to a time.
    pub(super) fn skip_occurrences(
        &mut self,
        id: &ScheduleId,
        after_ms: u64,
        until_ms: u64,
    ) -> Result<CommandOutcome, CommandError> {
        self.unhandled(id, after_ms, until_ms)?;
        self.schedule_mut(id)?.handled_ms = until_ms;
        Ok(CommandOutcome::Done)
    }

    /// Returns a schedule that is handled up to `after_ms`, and not up to `until_ms`.
    fn unhandled(&self, id: &ScheduleId, after_ms: u64, until_ms: u64) -> Result<&ScheduleEntry, CommandError> {
        let entry = self.schedule(id).ok_or_else(|| CommandError::NoSchedule { schedule: id.clone() })?;
        let handled_ms = entry.handled_ms;
        match handled_ms == after_ms && until_ms > after_ms && entry.pause.is_none() {
            true => Ok(entry),
            false => Err(CommandError::OccurrenceHandled { schedule: id.clone(), handled_ms }),
        }
    }
}

#[cfg(test)]
mod tests;
