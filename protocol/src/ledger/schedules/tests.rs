use super::*;
use crate::lease::Epoch;
use crate::ledger::{Command, MissedOccurrences, MissionState, ScheduleRule, Submission, test_values};
use std::collections::BTreeMap;

fn id(name: &str) -> ScheduleId {
    ScheduleId::new(name).unwrap()
}

fn rounds() -> Schedule {
    let submission = test_values::rounds("template");
    let rule = ScheduleRule {
        cron: "0 8 * * *".to_owned(),
        zone: "Europe/Berlin".to_owned(),
        until_ms: None,
        missed: MissedOccurrences::Skip,
    };
    Schedule { id: id("rounds"), rule, submission, deadline_after_ms: Some(50) }
}

/// Returns a ledger with the schedule, which is handled up to 100.
fn ledger() -> Ledger {
    let mut ledger = Ledger::default();
    apply(&mut ledger, Command::first_wire_version(3));
    assert_eq!(apply(&mut ledger, add(rounds())), CommandOutcome::Done);
    ledger
}

fn add(schedule: Schedule) -> Command {
    Command::AddSchedule { schedule: Box::new(schedule), from_ms: 100 }
}

fn apply(ledger: &mut Ledger, command: Command) -> CommandOutcome {
    ledger.apply(Epoch { term: 1, index: 1 }, command)
}

fn submit(ledger: &mut Ledger, after_ms: u64, due_ms: u64) -> CommandOutcome {
    apply(ledger, Command::SubmitOccurrence { schedule: id("rounds"), after_ms, due_ms, at_ms: due_ms + 5 })
}

fn handled(handled_ms: u64) -> CommandOutcome {
    CommandOutcome::Refused(CommandError::OccurrenceHandled { schedule: id("rounds"), handled_ms })
}

#[test]
fn an_occurrence_is_submitted_once() {
    let mut ledger = ledger();
    let CommandOutcome::Submitted { mission, again: false } = submit(&mut ledger, 100, 200) else { panic!() };
    assert_eq!(submit(&mut ledger, 100, 200), handled(200), "by the next coordinator");
    assert_eq!(submit(&mut ledger, 100, 150), handled(200));
    assert_eq!(submit(&mut ledger, 200, 200), handled(200));
    let entry = ledger.mission(&mission).unwrap();
    assert_eq!(
        (entry.submission.at_ms, entry.submission.deadline_ms, &entry.state),
        (205, Some(250), &MissionState::Pending)
    );
    assert_eq!(ledger.schedule(&id("rounds")).unwrap().last, Some(Occurrence { due_ms: 200, mission }));
    assert!(matches!(submit(&mut ledger, 200, 300), CommandOutcome::Submitted { .. }));
    assert_eq!(ledger.missions().count(), 2);
}

#[test]
fn the_mission_of_an_occurrence_names_the_person_and_the_schedule() {
    let mut ledger = Ledger::default();
    apply(&mut ledger, Command::first_wire_version(3));
    let submission = Submission { by: "Nia".to_owned(), ..rounds().submission };
    apply(&mut ledger, add(Schedule { submission, ..rounds() }));
    let CommandOutcome::Submitted { mission, .. } = submit(&mut ledger, 100, 200) else { panic!() };
    assert_eq!(ledger.mission(&mission).unwrap().submission.by, "Nia, schedule rounds");
    assert_eq!(ledger.schedule(&id("rounds")).unwrap().schedule.submission.by, "Nia");
}

#[test]
fn a_client_that_uses_the_request_id_of_an_occurrence_does_not_prevent_it() {
    let mut ledger = ledger();
    let forged = Submission { request: "rounds.200.0".parse().unwrap(), ..rounds().submission };
    apply(&mut ledger, Command::Submit(Box::new(forged)));
    assert!(matches!(submit(&mut ledger, 100, 200), CommandOutcome::Submitted { again: false, .. }));
    assert_eq!(ledger.missions().count(), 2);
}

#[test]
fn a_full_ledger_leaves_the_occurrence_for_later() {
    let mut ledger = ledger();
    for number in 0..super::super::limits::UNENDED_MAX {
        let request = format!("request-{number}").parse().unwrap();
        apply(&mut ledger, Command::Submit(Box::new(Submission { request, ..rounds().submission })));
    }
    assert!(matches!(submit(&mut ledger, 100, 200), CommandOutcome::Refused(CommandError::Full { .. })));
    let mission = ledger.missions().next().unwrap().id.clone();
    apply(&mut ledger, Command::Cancel { mission, by: "Nia".to_owned(), places: BTreeMap::new(), at_ms: 7 });
    assert!(matches!(submit(&mut ledger, 100, 200), CommandOutcome::Submitted { .. }));
}

#[test]
fn occurrences_of_a_paused_schedule_are_left_out() {
    let mut ledger = ledger();
    let resume = |ledger: &mut Ledger, at_ms| {
        let resume = Command::ResumeSchedule { schedule: id("rounds"), at_ms, by: "Nia".to_owned() };
        assert_eq!(apply(ledger, resume), CommandOutcome::Done);
    };
    let pause = SchedulePause { by: "Nia".to_owned(), since_ms: 150 };
    let outcome = apply(&mut ledger, Command::PauseSchedule { schedule: id("rounds"), pause });
    assert_eq!(outcome, CommandOutcome::Done);
    assert_eq!(submit(&mut ledger, 100, 200), handled(100));
    resume(&mut ledger, 250);
    assert_eq!(submit(&mut ledger, 100, 200), handled(250));
    resume(&mut ledger, 400);
    assert!(matches!(submit(&mut ledger, 250, 300), CommandOutcome::Submitted { .. }), "it was not paused at 400");
}

#[test]
fn missed_occurrences_are_left_out() {
    let mut ledger = ledger();
    let skip = |ledger: &mut Ledger, after_ms, until_ms| {
        apply(ledger, Command::SkipOccurrences { schedule: id("rounds"), after_ms, until_ms })
    };
    assert_eq!(skip(&mut ledger, 100, 300), CommandOutcome::Done);
    assert_eq!(skip(&mut ledger, 100, 400), handled(300));
    assert_eq!(submit(&mut ledger, 100, 200), handled(300));
}

#[test]
fn a_schedule_is_added_once_and_can_be_replaced_after_its_removal() {
    let mut ledger = ledger();
    assert_eq!(apply(&mut ledger, add(rounds())), CommandOutcome::Done, "the same again");
    let other = Schedule { deadline_after_ms: None, ..rounds() };
    let exists = CommandOutcome::Refused(CommandError::ScheduleExists { schedule: id("rounds") });
    assert_eq!(apply(&mut ledger, add(other.clone())), exists);
    let remove = || Command::RemoveSchedule { schedule: id("rounds"), by: "Nia".to_owned(), at_ms: 300 };
    assert_eq!(apply(&mut ledger, remove()), CommandOutcome::Done);
    let none = CommandOutcome::Refused(CommandError::NoSchedule { schedule: id("rounds") });
    assert_eq!(apply(&mut ledger, remove()), none);
    assert_eq!(submit(&mut ledger, 100, 200), none);
    assert_eq!(apply(&mut ledger, add(other)), CommandOutcome::Done);
}

#[test]
fn the_number_and_the_size_of_schedules_are_limited() {
    let mut ledger = ledger();
    for number in 1..=Schedule::MAX {
        let outcome = apply(&mut ledger, add(Schedule { id: id(&format!("rounds-{number}")), ..rounds() }));
        let expected = match number < Schedule::MAX {
            true => CommandOutcome::Done,
            false => CommandOutcome::Refused(CommandError::SchedulesFull),
        };
        assert_eq!(outcome, expected, "{number}");
    }
    let mut large = rounds();
    large.id = id("large");
    large.submission.parameters.insert("text".to_owned(), "x".repeat(Schedule::BYTES_MAX));
    assert!(matches!(apply(&mut ledger, add(large)), CommandOutcome::Refused(CommandError::TooLarge { .. })));
    let mut before = Ledger::default();
    let not_yet = CommandOutcome::Refused(CommandError::NoSchedulesYet { since: 3 });
    assert_eq!(apply(&mut before, add(rounds())), not_yet);
}
