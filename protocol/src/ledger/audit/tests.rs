use super::*;
use crate::lease::Epoch;
use crate::ledger::history::HISTORY_SINCE;
use crate::ledger::test_values::rounds;
use crate::ledger::{AlarmPlan, AlarmResponse, MissedOccurrences, Schedule, ScheduleRule, Submission};
use crate::units::MetresPerSecond;

fn ledger() -> Ledger {
    let mut ledger = Ledger::default();
    apply(&mut ledger, Command::first_wire_version(HISTORY_SINCE));
    ledger
}

fn apply(ledger: &mut Ledger, command: Command) -> CommandOutcome {
    let index = ledger.orders_changed().index + 1;
    ledger.apply(Epoch { term: 1, index }, command)
}

fn submission() -> Submission {
    Submission { by: "Nia".to_owned(), at_ms: 100, ..rounds("one") }
}

fn cancel(by: &str, at_ms: u64) -> Command {
    let (mission, by, places) = ("rounds-1".parse().unwrap(), by.to_owned(), BTreeMap::new());
    Command::Cancel { mission, by, places, at_ms }
}

fn order(change: OrderChange, at_ms: u64) -> Command {
    let robots = BTreeSet::from(["ada".parse().unwrap(), "bob".parse().unwrap()]);
    Command::OrderRobots { robots, order: OrderRequest { change, by: "Nia".to_owned(), at_ms, request: None } }
}

/// Returns the trail as text, an entry per line.
fn trail(ledger: &Ledger) -> Vec<String> {
    let line = |AuditEntry { at_ms, by, action, subject, details, .. }: &AuditEntry| {
        format!("{at_ms} {by} {action} {subject} {details}").trim_end().to_owned()
    };
    ledger.audit_trail().map(line).collect()
}

#[test]
fn a_request_is_recorded_with_its_author_once() {
    let mut ledger = ledger();
    for _ in 0..2 {
        apply(&mut ledger, Command::Submit(Box::new(submission())));
    }
    for (by, at_ms) in [("Abe", 200), ("Abe", 250), ("Tom", 300)] {
        apply(&mut ledger, cancel(by, at_ms));
    }
    let resolve = Command::Resolve { mission: "rounds-1".parse().unwrap(), by: "Tom".to_owned(), at_ms: 400 };
    assert!(matches!(apply(&mut ledger, resolve), CommandOutcome::Refused(_)));
    assert_eq!(trail(&ledger), ["100 Nia submit rounds-1", "200 Abe cancel rounds-1"]);
}

#[test]
fn two_orders_in_an_entry_of_the_log_are_both_recorded() {
    let mut ledger = ledger();
    let at = Epoch { term: 1, index: 7 };
    ledger.apply(at, order(OrderChange::Hold { until_ms: 60_100, reason: String::new() }, 100));
    ledger.apply(at, order(OrderChange::Release, 200));
    assert_eq!(trail(&ledger), ["100 Nia hold ada, bob for 60 s", "200 Nia release ada, bob"]);
}

#[test]
fn orders_to_robots_are_recorded_with_their_reasons() {
    let mut ledger = ledger();
    apply(&mut ledger, order(OrderChange::Release, 50));
    apply(&mut ledger, order(OrderChange::Hold { until_ms: 60_100, reason: "a spill".to_owned() }, 100));
    apply(&mut ledger, order(OrderChange::Release, 200));
    apply(&mut ledger, order(OrderChange::Release, 300));
    apply(&mut ledger, order(OrderChange::Maintain { until_ms: None, reason: "tyres".to_owned() }, 400));
    apply(&mut ledger, order(OrderChange::Maintain { until_ms: Some(90_450), reason: "tyres".to_owned() }, 450));
    apply(&mut ledger, Command::ExpireOrders { now_ms: 500 });
    apply(&mut ledger, order(OrderChange::EndMaintenance, 600));
    let expected = [
        "100 Nia hold ada, bob for 60 s: a spill",
        "200 Nia release ada, bob",
        "400 Nia begin_maintenance ada, bob tyres",
        "450 Nia begin_maintenance ada, bob for 90 s: tyres",
        "600 Nia end_maintenance ada, bob",
    ];
    assert_eq!(trail(&ledger), expected);
}

#[test]
fn closures_are_recorded_with_their_reasons() {
    let mut ledger = ledger();
    let place = |name: &str| name.parse().unwrap();
    let parts = BTreeSet::from([MapPart::Place(place("Ward A")), MapPart::of_lane(place("Ward C"), place("Ward B"))]);
    let mut change = |change, at_ms| {
        let order = OrderRequest { change, by: "Nia".to_owned(), at_ms, request: None };
        apply(&mut ledger, Command::ChangeClosures { parts: parts.clone(), order });
    };
    change(ClosureChange::Open, 50);
    change(ClosureChange::Close { until_ms: None, reason: "a spill".to_owned() }, 100);
    change(ClosureChange::Close { until_ms: Some(60_150), reason: String::new() }, 150);
    change(ClosureChange::Open, 200);
    change(ClosureChange::Open, 300);
    let expected = [
        "100 Nia close Ward A, Ward B – Ward C a spill",
        "150 Nia close Ward A, Ward B – Ward C for 60 s",
        "200 Nia open Ward A, Ward B – Ward C",
    ];
    assert_eq!(trail(&ledger), expected);
}

#[test]
fn speed_limits_are_recorded_with_their_speeds() {
    let mut ledger = ledger();
    let parts = BTreeSet::from([MapPart::Place("Ward A".parse().unwrap())]);
    let mut change = |change, at_ms| {
        let order = OrderRequest { change, by: "Nia".to_owned(), at_ms, request: None };
        apply(&mut ledger, Command::ChangeSpeedLimits { parts: parts.clone(), order });
    };
    let set = |until_ms, reason: &str| SpeedLimitChange::Set {
        speed: MetresPerSecond::new(0.3).unwrap(),
        until_ms,
        reason: reason.to_owned(),
    };
    change(SpeedLimitChange::Clear, 50);
    change(set(None, ""), 100);
    change(set(Some(60_150), "a spill"), 150);
    change(SpeedLimitChange::Clear, 200);
    let expected = [
        "100 Nia limit_speed Ward A 0.3 m/s",
        "150 Nia limit_speed Ward A 0.3 m/s: for 60 s: a spill",
        "200 Nia clear_speed_limit Ward A",
    ];
    assert_eq!(trail(&ledger), expected);
}

#[test]
fn alarms_are_recorded_with_their_reasons() {
    let mut ledger = ledger();
    let mut change = |change, at_ms| {
        let order = OrderRequest { change, by: "Nia".to_owned(), at_ms, request: None };
        apply(&mut ledger, Command::ChangeAlarms { order });
    };
    let raise = |alarm: &str| AlarmChange::Raise {
        alarm: alarm.parse().unwrap(),
        plan: AlarmPlan { robots: AlarmResponse::Stop, places: BTreeSet::new(), closes: BTreeSet::new() },
        reason: "smoke".to_owned(),
    };
    change(AlarmChange::Clear { alarm: None }, 50);
    change(raise("fire"), 100);
    change(raise("flood"), 150);
    change(AlarmChange::Clear { alarm: Some("fire".parse().unwrap()) }, 200);
    change(AlarmChange::Clear { alarm: None }, 250);
    change(AlarmChange::Clear { alarm: None }, 300);
    let expected = [
        "100 Nia raise_alarm fire smoke",
        "150 Nia raise_alarm flood smoke",
        "200 Nia clear_alarm fire",
        "250 Nia clear_alarm all",
    ];
    assert_eq!(trail(&ledger), expected);
}

#[test]
fn changes_of_schedules_are_recorded() {
    let mut ledger = ledger();
    let rule = ScheduleRule {
        cron: "0 8 * * *".to_owned(),
        zone: "Europe/Berlin".to_owned(),
        until_ms: None,
        missed: MissedOccurrences::Skip,
    };
    let id: ScheduleId = "morning".parse().unwrap();
    let schedule = Box::new(Schedule { id: id.clone(), rule, submission: submission(), deadline_after_ms: None });
    let pause = |since_ms| SchedulePause { by: "Abe".to_owned(), since_ms };
    for command in [
        Command::AddSchedule { schedule: schedule.clone(), from_ms: 100 },
        Command::AddSchedule { schedule, from_ms: 150 },
        Command::PauseSchedule { schedule: id.clone(), pause: pause(200) },
        Command::PauseSchedule { schedule: id.clone(), pause: pause(250) },
        Command::ResumeSchedule { schedule: id.clone(), at_ms: 300, by: "Tom".to_owned() },
        Command::SubmitOccurrence { schedule: id.clone(), after_ms: 300, due_ms: 400, at_ms: 400 },
        Command::RemoveSchedule { schedule: id.clone(), by: "Tom".to_owned(), at_ms: 500 },
        Command::RemoveSchedule { schedule: id, by: "Tom".to_owned(), at_ms: 550 },
    ] {
        apply(&mut ledger, command);
    }
    let expected = [
        "100 Nia add_schedule morning",
        "200 Abe pause_schedule morning",
        "300 Tom resume_schedule morning",
        "500 Tom remove_schedule morning",
    ];
    assert_eq!(trail(&ledger), expected);
    let numbers: Vec<u64> = ledger.audit_trail().map(|entry| entry.number).collect();
    assert_eq!(numbers, [1, 2, 3, 4]);
}

#[test]
fn a_person_that_raises_the_wire_version_is_recorded() {
    let mut ledger = Ledger::default();
    let raise = |wire, at_ms| Command::RaiseWireVersion { wire, by: "Nia".to_owned(), at_ms };
    for (wire, at_ms) in [(HISTORY_SINCE - 1, 100), (HISTORY_SINCE, 200), (HISTORY_SINCE, 300)] {
        apply(&mut ledger, raise(wire, at_ms));
    }
    apply(&mut ledger, raise(HISTORY_SINCE + 1, 400));
    let expected = ["200 Nia raise_wire_version wire version 3", "400 Nia raise_wire_version wire version 4"];
    assert_eq!(trail(&ledger), expected);
}

#[test]
fn a_ledger_of_an_earlier_wire_version_has_no_trail() {
    let mut ledger = Ledger::default();
    apply(&mut ledger, Command::Submit(Box::new(submission())));
    apply(&mut ledger, cancel("Nia", 200));
    assert_eq!(trail(&ledger), [] as [&str; 0]);
}
