//! Each occurrence of a schedule is submitted exactly once, at its time.
//!
//! No two missions are submitted for an instant, and none before its time. With the rule that missed occurrences are
//! submitted late, none is left out while the schedule is not paused.

use super::reference_ledger::ReferenceLedger;
use super::{Invariant, InvariantViolation};
use crate::chaos::dates::DATE_MS;
use crate::chaos::recurring::{INTERVAL_MS, SCHEDULE};
use crate::{Fleet, Observation, slug};
use consort_protocol::ids::MissionId;
use consort_protocol::ledger::{Command, Ledger, MissedOccurrences};
use std::collections::BTreeMap;
use std::time::Duration;

pub(super) struct Occurrences {
    reference: ReferenceLedger,
    /// Missions of the submitted occurrences, by the times at which they were due.
    missions: BTreeMap<u64, MissionId>,
    /// Time up to which the schedule is handled; `None` without a schedule, or while it is paused.
    handled_ms: Option<u64>,
}

impl Default for Occurrences {
    fn default() -> Occurrences {
        let reference = ReferenceLedger::keeping_all();
        Occurrences { reference, missions: BTreeMap::new(), handled_ms: None }
    }
}

/// Returns the largest difference between the confirmed time and the true time: clocks drift by up to 5 %, and are read
/// every 5 s.
fn tolerance(at: Duration) -> Duration {
    at / 20 + Duration::from_secs(5)
}

/// Returns the time of the first occurrence after a time.
fn next_after(after_ms: u64) -> u64 {
    (after_ms / INTERVAL_MS + 1) * INTERVAL_MS
}

/// Checks that each occurrence that is due has been submitted or left out.
pub(in crate::chaos) fn all_handled(ledger: &Ledger, at: Duration) -> bool {
    let due_ms = u64::try_from(at.saturating_sub(tolerance(at)).as_millis()).map_or(u64::MAX, |ms| DATE_MS + ms);
    ledger.schedules().all(|entry| entry.pause.is_some() || next_after(entry.handled_ms) > due_ms)
}

impl Occurrences {
    /// Checks the ledger after a command.
    fn check(&mut self, at: Duration, command: &Command) -> Result<(), InvariantViolation> {
        let ledger = &self.reference.ledger;
        if matches!(command, Command::Submit(_) | Command::SubmitOccurrence { .. }) {
            for entry in ledger.missions() {
                let request = entry.submission.request.as_str().strip_prefix(SCHEDULE);
                let due = request.and_then(|rest| rest.strip_prefix('.')?.split('.').next()?.parse::<u64>().ok());
                let Some(due_ms) = due else { continue };
                let known = self.missions.entry(due_ms).or_insert_with(|| entry.id.clone());
                if *known != entry.id {
                    return Err(
                        format!("{known} and {} were submitted for the occurrence at {due_ms}", entry.id).into()
                    );
                }
                let due_after = Duration::from_millis(due_ms.saturating_sub(DATE_MS));
                if let Some(early) = due_after.checked_sub(at + tolerance(at)) {
                    let early_s = early.as_secs_f64();
                    return Err(format!("{known} was submitted {early_s:.1} s before its time, {due_ms}").into());
                }
            }
        }
        let entry = ledger.schedule(&slug(SCHEDULE)).filter(|entry| entry.pause.is_none());
        let before = std::mem::replace(&mut self.handled_ms, entry.map(|entry| entry.handled_ms));
        let (Some(entry), Some(before)) = (entry, before) else { return Ok(()) };
        let mut passed = std::iter::successors(Some(next_after(before)), |due| Some(next_after(*due)))
            .take_while(|due| *due <= entry.handled_ms);
        match passed.find(|due| !self.missions.contains_key(due)) {
            Some(due) if entry.schedule.rule.missed == MissedOccurrences::All => {
                Err(format!("the occurrence at {due} was left out").into())
            }
            _ => Ok(()),
        }
    }

    fn apply(&mut self, at: Duration, entry: &Observation) -> Result<(), InvariantViolation> {
        let Observation::EntryApplied { at: position, commands, .. } = entry else { return Ok(()) };
        if !self.reference.is_new(*position) {
            return Ok(());
        }
        for command in commands.iter() {
            self.reference.apply_command(*position, command);
            self.check(at, command)?;
        }
        self.reference.index = position.index;
        Ok(())
    }
}

impl Invariant for Occurrences {
    fn name(&self) -> &'static str {
        "occurrences"
    }

    fn observe(&mut self, at: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        self.apply(at, entry)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::lease::Epoch;
    use consort_protocol::ledger::{Schedule, SchedulePause, ScheduleRule, Submission};
    use consort_protocol::mission::{Mission, Role, RoleKind};
    use consort_protocol::plan::Division;

    const FIRST: u64 = (DATE_MS / INTERVAL_MS + 1) * INTERVAL_MS;

    fn submission() -> Submission {
        let mission = Mission {
            name: slug("rest"),
            roles: BTreeMap::from([(slug("r1"), Role::of(RoleKind::Managed))]),
            ensembles: vec![],
            energy_max: None,
            tasks: vec![],
            results: BTreeMap::new(),
        };
        Submission::of(slug("template"), mission, Division { plans: BTreeMap::new() })
    }

    fn submit(after_ms: u64, due_ms: u64) -> Command {
        Command::SubmitOccurrence { schedule: slug(SCHEDULE), after_ms, due_ms, at_ms: due_ms }
    }

    fn skip(after_ms: u64, until_ms: u64) -> Command {
        Command::SkipOccurrences { schedule: slug(SCHEDULE), after_ms, until_ms }
    }

    /// Applies a schedule, and the commands in an entry each, after 5 minutes.
    fn check(missed: MissedOccurrences, commands: Vec<Command>) -> Result<(), InvariantViolation> {
        let rule = ScheduleRule { cron: "* * * * *".to_owned(), zone: "UTC".to_owned(), until_ms: None, missed };
        let schedule = Schedule { id: slug(SCHEDULE), rule, submission: submission(), deadline_after_ms: None };
        let add = Command::AddSchedule { schedule: Box::new(schedule), from_ms: DATE_MS };
        let commands = [Command::first_wire_version(3), add].into_iter().chain(commands);
        let mut invariant = Occurrences::default();
        commands.zip(1..).try_for_each(|(command, index)| {
            let (at, commands) = (Epoch { term: 1, index }, [command].into());
            let entry = Observation::EntryApplied { node: slug("aster"), at, digest: None, commands };
            invariant.apply(Duration::from_secs(300), &entry)
        })
    }

    #[test]
    fn a_second_mission_for_an_instant_is_found() {
        use MissedOccurrences::All;
        let once = vec![submit(DATE_MS, FIRST), submit(DATE_MS, FIRST), submit(FIRST, FIRST + INTERVAL_MS)];
        assert_eq!(check(All, once), Ok(()));
        let forged = Submission { request: slug(&format!("{SCHEDULE}.{FIRST}.7")), ..submission() };
        let twice = vec![submit(DATE_MS, FIRST), Command::Submit(Box::new(forged))];
        let violation = check(All, twice).unwrap_err().0;
        assert!(violation.ends_with(&format!("were submitted for the occurrence at {FIRST}")), "{violation}");
    }

    #[test]
    fn an_occurrence_before_its_time_is_found() {
        let early = vec![submit(DATE_MS, FIRST + 10 * INTERVAL_MS)];
        let violation = check(MissedOccurrences::Last, early).unwrap_err().0;
        assert!(violation.contains("before its time"), "{violation}");
    }

    #[test]
    fn an_occurrence_that_is_left_out_is_found_unless_it_may_be() {
        use MissedOccurrences::{All, Last, Skip};
        let left_out = Err(InvariantViolation(format!("the occurrence at {FIRST} was left out")));
        for gap in [submit(DATE_MS, FIRST + INTERVAL_MS), skip(DATE_MS, FIRST + 1)] {
            assert_eq!(check(All, vec![gap.clone()]), left_out);
            assert_eq!(check(Last, vec![gap.clone()]), Ok(()));
            assert_eq!(check(Skip, vec![gap]), Ok(()));
        }
        let pause = SchedulePause { by: String::new(), since_ms: DATE_MS };
        let paused = Command::PauseSchedule { schedule: slug(SCHEDULE), pause };
        let resumed = Command::ResumeSchedule { schedule: slug(SCHEDULE), at_ms: FIRST + 1, by: "Nia".to_owned() };
        assert_eq!(check(All, vec![paused, resumed, submit(FIRST + 1, FIRST + INTERVAL_MS)]), Ok(()));
    }
}
