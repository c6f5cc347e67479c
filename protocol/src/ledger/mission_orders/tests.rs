use super::*;
use crate::ids::MissionId;
use crate::ledger::history::HISTORY_SINCE;
use crate::ledger::test_values::{Log, rounds};
use crate::ledger::{AuditEntry, MissionState, Priority};
use std::collections::BTreeMap;

impl Log {
    fn submit(&mut self, request: &str) -> MissionId {
        match self.apply(Command::Submit(Box::new(rounds(request)))) {
            CommandOutcome::Submitted { mission, .. } => mission,
            other => panic!("{other:?}"),
        }
    }

    fn cancel(&mut self, missions: &[&MissionId], by: &str, request: Option<&str>) -> CommandOutcome {
        let missions = missions.iter().map(|mission| (MissionId::clone(mission), BTreeMap::new())).collect();
        let request = request.map(|request| request.parse().unwrap());
        let order = OrderRequest { change: MissionCancelation { missions }, by: by.to_owned(), at_ms: 9, request };
        self.apply(Command::CancelMissions { order })
    }

    fn set_priority(&mut self, mission: &MissionId, number: i64, request: Option<&str>) -> CommandOutcome {
        let change = MissionChange::SetPriority(Priority::new(number).unwrap());
        let request = request.map(|request| request.parse().unwrap());
        let order = OrderRequest { change, by: "Nia".to_owned(), at_ms: 9, request };
        self.apply(Command::ChangeMission { mission: mission.clone(), order })
    }

    /// Returns the active missions in the order in which they are served.
    fn queue(&self) -> Vec<MissionId> {
        self.0.active_missions().into_iter().map(|entry| entry.id.clone()).collect()
    }

    fn state(&self, mission: &MissionId) -> &MissionState {
        self.0.mission_state(mission).unwrap()
    }

    /// Returns the trail as text, an entry per line.
    fn trail(&self) -> Vec<String> {
        let line = |AuditEntry { by, action, subject, .. }: &AuditEntry| format!("{by} {action} {subject}");
        self.0.audit_trail().map(line).filter(|line| !line.contains("submit")).collect()
    }
}

#[test]
fn a_cancelation_of_several_missions_is_one_entry_with_a_record_of_each() {
    let mut log = Log::new();
    let [first, ended, third, other] = ["a", "b", "c", "d"].map(|request| log.submit(request));
    log.cancel(&[&ended], "Abe", None);
    assert_eq!(log.cancel(&[&first, &ended, &third], "Nia", None), CommandOutcome::Done);
    let canceled = |by: &str| MissionState::Canceled { by: by.to_owned() };
    assert_eq!([&first, &ended, &third].map(|mission| log.state(mission).clone()), ["Nia", "Abe", "Nia"].map(canceled));
    assert_eq!(*log.state(&other), MissionState::Pending);
    assert_eq!(log.trail(), ["Abe cancel rounds-2", "Nia cancel rounds-1", "Nia cancel rounds-3"]);
}

#[test]
fn a_copy_of_a_cancelation_changes_nothing() {
    let mut log = Log::new();
    let first = log.submit("a");
    log.cancel(&[&first], "Nia", Some("cancel-7"));
    let later = log.submit("b");
    assert_eq!(log.cancel(&[&later], "Nia", Some("cancel-7")), CommandOutcome::Done);
    assert_eq!(*log.state(&later), MissionState::Pending);
    assert_eq!(log.cancel(&[&later], "Nia", Some("cancel-8")), CommandOutcome::Done);
    assert!(log.state(&later).is_final());
}

#[test]
fn a_ledger_of_an_earlier_wire_version_rejects_such_a_cancelation() {
    let mut log = Log(Ledger::default(), 1);
    let mission = log.submit("a");
    let not_yet = CommandOutcome::Refused(CommandError::NoOrdersYet { since: HISTORY_SINCE });
    assert_eq!(log.cancel(&[&mission], "Nia", None), not_yet);
    assert_eq!(*log.state(&mission), MissionState::Pending);
}

#[test]
fn missions_are_served_by_their_new_priorities() {
    let mut log = Log::new();
    let [first, second, third] = ["a", "b", "c"].map(|request| log.submit(request));
    assert_eq!(log.set_priority(&third, 5, None), CommandOutcome::Done);
    log.set_priority(&first, -5, Some("lower-7"));
    assert_eq!(log.queue(), [third.clone(), second.clone(), first.clone()]);
    log.set_priority(&first, 50, Some("lower-7"));
    assert_eq!(log.queue(), [third, second.clone(), first.clone()], "a copy of a request changes nothing");
    log.set_priority(&second, 0, None);
    let expected = ["Nia set_priority rounds-3", "Nia set_priority rounds-1"];
    assert_eq!(log.trail(), expected, "the same priority changes nothing");
    log.cancel(&[&first], "Nia", None);
    assert!(matches!(log.set_priority(&first, 1, None), CommandOutcome::Refused(CommandError::MissionEnded { .. })));
}
