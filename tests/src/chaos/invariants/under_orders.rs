//! A robot under orders gets no new role: it begins no role that was awarded while a person held it or had it in
//! maintenance, or during an alarm.

use super::reference_ledger::ReferenceLedger;
use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{NodeId, RobotId};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

#[derive(Default)]
pub(super) struct UnderOrders {
    reference: ReferenceLedger,
    /// Position in the log since which a robot is under orders. An alarm concerns all robots (`None`).
    since: BTreeMap<Option<RobotId>, u64>,
    /// Positions between which robots were under orders.
    past: Vec<(Option<RobotId>, u64, u64)>,
}

impl UnderOrders {
    fn update(&mut self) {
        let index = self.reference.index;
        let ledger = &self.reference.ledger;
        let by_alarm = ledger.has_alarm().then_some(None);
        let ordered: BTreeSet<Option<RobotId>> =
            ledger.robot_orders().map(|(robot, _)| Some(robot.clone())).chain(by_alarm).collect();
        for robot in &ordered {
            self.since.entry(robot.clone()).or_insert(index);
        }
        let ended: Vec<Option<RobotId>> =
            self.since.keys().filter(|robot| !ordered.contains(*robot)).cloned().collect();
        for robot in ended {
            if let Some(since) = self.since.remove(&robot) {
                self.past.push((robot, since, index));
            }
        }
    }

    /// Checks whether a robot was under orders at a position. An entry of the log may contain an award before an order,
    /// so the positions of changes do not count.
    fn was_under_orders(&self, robot: &RobotId, index: u64) -> bool {
        let concerns = |other: &Option<RobotId>| other.as_ref().is_none_or(|other| other == robot);
        let mut now = self.since.iter().filter(|(other, _)| concerns(other));
        let mut past = self.past.iter().filter(|(other, ..)| concerns(other));
        now.any(|(_, since)| *since < index && index <= self.reference.index)
            || past.any(|(_, since, until)| (since + 1..*until).contains(&index))
    }

    fn begins(&self, node: &NodeId, index: u64, what: &str) -> Result<(), InvariantViolation> {
        if self.was_under_orders(&RobotId::from(node.clone()), index) {
            return Err(format!("{node} begins {what}, which it got at {index} while it was under orders").into());
        }
        Ok(())
    }
}

impl Invariant for UnderOrders {
    fn name(&self) -> &'static str {
        "under_orders"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        if matches!(entry, Observation::EntryApplied { .. }) {
            self.reference.observe(entry);
            self.update();
        }
        match entry.event_kind() {
            Some(EventKind::Started { mission, role, epoch }) => {
                self.begins(entry.node(), epoch.index, &format!("{role} of {mission}"))
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slug;
    use consort_protocol::lease::Epoch;
    use consort_protocol::ledger::{AlarmChange, AlarmPlan, AlarmResponse, Command, OrderChange, OrderRequest};

    fn order(change: OrderChange) -> Command {
        let order = OrderRequest { change, by: "Nia".to_owned(), at_ms: 1, request: None };
        Command::OrderRobots { robots: BTreeSet::from([slug("garnet")]), order }
    }

    #[test]
    fn a_role_that_was_awarded_under_orders_is_found() {
        let mut state = UnderOrders::default();
        let hold = order(OrderChange::Hold { until_ms: 9, reason: String::new() });
        let maintain = order(OrderChange::Maintain { until_ms: None, reason: "tyres".to_owned() });
        let commands = [
            (1, Command::first_wire_version(3)),
            (5, hold),
            (7, maintain),
            (9, order(OrderChange::Release)),
            (11, order(OrderChange::EndMaintenance)),
            (20, order(OrderChange::Release)),
        ];
        for (index, command) in commands {
            state.reference.apply(Epoch { term: 1, index }, &[command]);
            state.update();
        }
        let garnet: NodeId = slug("garnet");
        for index in [4, 12, 21] {
            assert_eq!(state.begins(&garnet, index, "r1"), Ok(()), "{index}");
        }
        for index in [6, 8, 10] {
            let violation = state.begins(&garnet, index, "r1").unwrap_err().0;
            assert_eq!(violation, format!("garnet begins r1, which it got at {index} while it was under orders"));
            assert_eq!(state.begins(&slug("hazel"), index, "r1"), Ok(()));
        }
    }

    #[test]
    fn a_role_that_was_awarded_during_an_alarm_is_found() {
        let alarm = |change| Command::ChangeAlarms {
            order: OrderRequest { change, by: "Nia".to_owned(), at_ms: 1, request: None },
        };
        let plan = AlarmPlan { robots: AlarmResponse::Stop, places: BTreeSet::new(), closes: BTreeSet::new() };
        let raise = AlarmChange::Raise { alarm: slug("fire"), plan, reason: String::new() };
        let mut state = UnderOrders::default();
        let commands =
            [(1, Command::first_wire_version(3)), (5, alarm(raise)), (9, alarm(AlarmChange::Clear { alarm: None }))];
        for (index, command) in commands {
            state.reference.apply(Epoch { term: 1, index }, &[command]);
            state.update();
        }
        for (index, is_permitted) in [(4, true), (6, false), (8, false), (10, true)] {
            assert_eq!(state.begins(&slug("garnet"), index, "r1").is_ok(), is_permitted, "{index}");
        }
    }
}
