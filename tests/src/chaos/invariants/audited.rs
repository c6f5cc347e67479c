//! Every order of a person is in the audit trail exactly once: to robots, about the map, an alarm, a change of a mission, and
//! for each mission a cancelation.
//!
//! An acknowledged order is in the log, no order is executed twice, and at the end the trail of the coordinator has an
//! entry for each order that has changed anything. Each order is given by another person, except for the cancelations of
//! single missions.

use super::reference_ledger::ReferenceLedger;
use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use consort_protocol::ids::MissionId;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{AuditAction, Command, Ledger, MissionState};
use std::collections::BTreeMap;
use std::time::Duration;

#[derive(Default)]
pub(super) struct Audited {
    reference: ReferenceLedger,
    /// How often the orders of each person have changed anything.
    changes: BTreeMap<String, usize>,
}

/// Returns the person as named in the request; the coordinator of a closed fleet adds the signer.
fn person(by: &str) -> &str {
    by.split(", according to ").next().unwrap_or(by)
}

/// The order of a person in a command.
struct Order<'a> {
    by: &'a str,
    subjects: Subjects<'a>,
    /// The person gives other orders of the kind.
    is_one_of_many: bool,
}

/// What an order may change.
enum Subjects<'a> {
    /// The orders to robots, about the map, and the alarms.
    Orders,
    /// The priority of a mission, and the orders about its roles.
    Terms(&'a MissionId),
    /// The states of missions.
    States(Vec<&'a MissionId>),
}

impl Order<'_> {
    fn of(command: &Command) -> Option<Order<'_>> {
        let (by, subjects) = match command {
            Command::OrderRobots { order, .. } => (&order.by, Subjects::Orders),
            Command::ChangeClosures { order, .. } => (&order.by, Subjects::Orders),
            Command::ChangeSpeedLimits { order, .. } => (&order.by, Subjects::Orders),
            Command::ChangeAlarms { order } => (&order.by, Subjects::Orders),
            Command::ChangeMission { mission, order } => (&order.by, Subjects::Terms(mission)),
            Command::CancelMissions { order } => (&order.by, Subjects::States(order.change.missions.keys().collect())),
            Command::Cancel { mission, by, .. } => (by, Subjects::States(vec![mission])),
            _ => return None,
        };
        Some(Order { by, subjects, is_one_of_many: matches!(command, Command::Cancel { .. }) })
    }
}

impl Subjects<'_> {
    /// Returns the states of what the order may change, as text.
    fn texts(&self, ledger: &Ledger) -> Vec<String> {
        match self {
            Subjects::Orders => {
                let (robots, closures) = (ledger.robot_orders().collect::<Vec<_>>(), ledger.closures());
                let (limits, alarms) = (ledger.speed_limits().collect::<Vec<_>>(), ledger.alarms());
                let about_map = (closures.collect::<Vec<_>>(), limits, alarms.collect::<Vec<_>>());
                vec![format!("{robots:?} {about_map:?}")]
            }
            Subjects::Terms(mission) => {
                let terms = ledger.mission(mission).map(|entry| (entry.submission.priority, entry.role_orders()));
                vec![format!("{terms:?}")]
            }
            // Only open missions are canceled. The state of another may be shortened or forgotten meanwhile.
            Subjects::States(missions) => {
                let is_open =
                    |state: Option<&MissionState>| matches!(state, Some(MissionState::Pending | MissionState::Running));
                missions.iter().map(|mission| is_open(ledger.mission_state(mission)).to_string()).collect()
            }
        }
    }
}

impl Audited {
    fn apply(&mut self, at: Epoch, commands: &[Command]) -> Result<(), InvariantViolation> {
        if !self.reference.is_new(at) {
            return Ok(());
        }
        for command in commands {
            let Some(order) = Order::of(command) else {
                self.reference.apply_command(at, command);
                continue;
            };
            let before = order.subjects.texts(&self.reference.ledger);
            self.reference.apply_command(at, command);
            let after = order.subjects.texts(&self.reference.ledger);
            let mut changed = before.iter().zip(&after).filter(|(before, after)| before != after).count();
            // An earlier ledger has no trail.
            if self.reference.ledger.history_limits().is_none() {
                changed = 0;
            }
            let changes = self.changes.entry(person(order.by).to_owned()).or_default();
            if *changes > 0 && changed > 0 && !order.is_one_of_many {
                return Err(format!("the order of {} was executed twice", order.by).into());
            }
            *changes += changed;
        }
        self.reference.index = at.index;
        Ok(())
    }

    fn acknowledge(&self, by: &str) -> Result<(), InvariantViolation> {
        match self.changes.contains_key(by) {
            true => Ok(()),
            false => Err(format!("the order of {by} was acknowledged, but no ledger contains it").into()),
        }
    }

    fn check_trail(&self, ledger: &Ledger) -> Result<(), InvariantViolation> {
        let mut entries: BTreeMap<&str, usize> = BTreeMap::new();
        for entry in ledger.audit_trail().filter(|entry| is_order(entry.action)) {
            *entries.entry(person(&entry.by)).or_default() += 1;
        }
        let all = self.changes.keys().map(String::as_str).chain(entries.keys().copied());
        for by in all {
            let (found, expected) = (entries.get(by).copied(), self.changes.get(by).copied());
            let (found, expected) = (found.unwrap_or_default(), expected.unwrap_or_default());
            if found != expected {
                let reason = format!("the audit trail has {found} entries for the order of {by}, not {expected}");
                return Err(reason.into());
            }
        }
        Ok(())
    }
}

fn is_order(action: AuditAction) -> bool {
    matches!(
        action,
        AuditAction::Hold
            | AuditAction::Release
            | AuditAction::BeginMaintenance
            | AuditAction::EndMaintenance
            | AuditAction::Close
            | AuditAction::Open
            | AuditAction::LimitSpeed
            | AuditAction::ClearSpeedLimit
            | AuditAction::RaiseAlarm
            | AuditAction::ClearAlarm
            | AuditAction::SetPriority
            | AuditAction::Reassign
            | AuditAction::Pin
            | AuditAction::Unpin
            | AuditAction::Cancel
    )
}

impl Invariant for Audited {
    fn name(&self) -> &'static str {
        "audited"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        match entry {
            Observation::EntryApplied { at, commands, .. } => self.apply(*at, commands),
            Observation::OrderAcknowledged { by, .. } => self.acknowledge(by),
            _ => Ok(()),
        }
    }

    fn check_end(&mut self, fleet: &Fleet) -> Result<(), InvariantViolation> {
        fleet.ledger(|ledger| self.check_trail(ledger)).unwrap_or(Ok(()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chaos::invariants::test_missions::{cancel, submit_rest};
    use crate::slug;
    use consort_protocol::ledger::{
        AlarmChange, ClosureChange, MapPart, MissionChange, OrderChange, OrderRequest, Priority,
    };
    use std::collections::BTreeSet;

    fn order(by: &str, at_ms: u64, change: OrderChange) -> Command {
        let order = OrderRequest { change, by: by.to_owned(), at_ms, request: None };
        Command::OrderRobots { robots: BTreeSet::from([slug("garnet")]), order }
    }

    fn hold(by: &str, at_ms: u64) -> Command {
        order(by, at_ms, OrderChange::Hold { until_ms: at_ms + 60_000, reason: String::new() })
    }

    fn close(by: &str, at_ms: u64) -> Command {
        let change = ClosureChange::Close { until_ms: None, reason: String::new() };
        let order = OrderRequest { change, by: by.to_owned(), at_ms, request: None };
        Command::ChangeClosures { parts: BTreeSet::from([MapPart::Place(slug("Ward"))]), order }
    }

    fn applied(commands: Vec<Command>) -> Result<Audited, InvariantViolation> {
        let mut state = Audited::default();
        let commands = [Command::first_wire_version(3)].into_iter().chain(commands);
        for (command, index) in commands.zip(1..) {
            state.apply(Epoch { term: 1, index }, &[command])?;
        }
        Ok(state)
    }

    #[test]
    fn an_order_that_is_lost_or_executed_twice_is_found() {
        let release = order("Abe, according to the dashboard", 3, OrderChange::Release);
        let useless = order("Eve", 4, OrderChange::Release);
        let state = applied(vec![hold("Nia", 1), release, useless, close("Bea", 5)]);
        let state = state.unwrap_or_else(|found| panic!("{found:?}"));
        for by in ["Nia", "Abe", "Eve", "Bea"] {
            assert_eq!(state.acknowledge(by), Ok(()), "{by}");
        }
        let violation = state.acknowledge("Ida").unwrap_err().0;
        assert_eq!(violation, "the order of Ida was acknowledged, but no ledger contains it");
        assert_eq!(state.check_trail(&state.reference.ledger), Ok(()));
        let violation = state.check_trail(&Ledger::default()).unwrap_err().0;
        assert_eq!(violation, "the audit trail has 0 entries for the order of Abe, not 1");
        let violation = applied(vec![hold("Nia", 1), hold("Nia", 2)]).map(|_| ()).unwrap_err().0;
        assert_eq!(violation, "the order of Nia was executed twice");
        let violation = applied(vec![close("Bea", 1), close("Bea", 2)]).map(|_| ()).unwrap_err().0;
        assert_eq!(violation, "the order of Bea was executed twice");
    }

    fn prioritize(by: &str, priority: i64) -> Command {
        let change = MissionChange::SetPriority(Priority::new(priority).unwrap());
        let order = OrderRequest { change, by: by.to_owned(), at_ms: 9, request: None };
        Command::ChangeMission { mission: slug("rest-1"), order }
    }

    #[test]
    fn changes_of_missions_and_alarms_are_orders() {
        let clear =
            OrderRequest { change: AlarmChange::Clear { alarm: None }, by: "Eve".to_owned(), at_ms: 9, request: None };
        let cancel_one = |mission: &str| {
            let (mission, by) = (slug(mission), "Ida".to_owned());
            Command::Cancel { mission, by, places: BTreeMap::new(), at_ms: 9 }
        };
        let state = applied(vec![
            submit_rest("a"),
            submit_rest("b"),
            submit_rest("c"),
            submit_rest("d"),
            prioritize("Nia", 7),
            Command::ChangeAlarms { order: clear },
            cancel("Abe", &["rest-1", "rest-2"]),
            cancel_one("rest-3"),
            cancel_one("rest-4"),
        ]);
        let state = state.unwrap_or_else(|found| panic!("{found:?}"));
        let changes = ["Nia", "Eve", "Abe", "Ida"].map(|by| state.changes[by]);
        assert_eq!(changes, [1, 0, 2, 2]);
        assert_eq!(state.check_trail(&state.reference.ledger), Ok(()));
        let twice = applied(vec![submit_rest("a"), prioritize("Nia", 7), prioritize("Nia", 8)]);
        assert_eq!(twice.map(|_| ()).unwrap_err().0, "the order of Nia was executed twice");
    }
}
