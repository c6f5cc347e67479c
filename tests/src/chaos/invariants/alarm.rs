//! During an alarm robots stand still, or drive only, if every alarm lets them assemble.
//!
//! The bounds are those of a hold: a robot in a role has received the alarm, or has stopped, once the lease that it may
//! have had at that time is over; a robot without a role, once its own record states the alarm. The check does not know
//! where a drive ends, so a robot that assembles may drive anywhere. Robots get no roles meanwhile, as
//! [`under_orders`](super::under_orders) checks, and what an alarm closes is [`closed`](super::closed).

use super::InvariantViolation;
use super::active_goals::ActiveGoals;
use super::informed::{Informed, stated_problem};
use super::obeyed::Obeyed;
use super::reference_ledger::ReferenceLedger;
use crate::Fleet;
use crate::order_bounds::stops_within;
use consort_protocol::ids::RobotId;
use consort_protocol::ledger::{Alarm, AlarmResponse};
use consort_skills::actions::RobotBackend as _;
use std::time::Duration;

pub(super) struct UnderAlarm {
    lease: Duration,
    reference: ReferenceLedger,
    /// Alarms in the ledger.
    alarms: Vec<Alarm>,
    /// Time of their latest change.
    changed: Duration,
    /// Robots that state these alarms in their record.
    informed: Informed,
    active: ActiveGoals,
}

impl UnderAlarm {
    pub(super) fn new(lease: Duration) -> UnderAlarm {
        UnderAlarm {
            lease,
            reference: ReferenceLedger::default(),
            alarms: vec![],
            changed: Duration::ZERO,
            informed: Informed::default(),
            active: ActiveGoals::default(),
        }
    }

    /// Returns the alarms as robots state them.
    fn text(&self) -> String {
        self.alarms.iter().map(Alarm::text).collect::<Vec<_>>().join("; ")
    }

    fn check(&self, at: Duration) -> Result<(), InvariantViolation> {
        if self.alarms.is_empty() {
            return Ok(());
        }
        let may_drive = self.alarms.iter().all(|alarm| alarm.plan.robots == AlarmResponse::Assemble);
        let is_over = |since: Duration| at > self.active.stopped_from(since) + stops_within(self.lease);
        for ((robot, id), goal) in &self.active.goals {
            let must_obey = match goal.in_role {
                true => is_over(self.changed),
                false => self.informed.since(robot).is_some_and(is_over),
            };
            if must_obey && !(may_drive && goal.drives_to.is_some()) {
                let after_s = at.saturating_sub(self.changed).as_secs_f64();
                return Err(format!("{robot} pursues goal {id}, {after_s:.1} s after it was {}", self.text()).into());
            }
        }
        Ok(())
    }
}

impl Obeyed for UnderAlarm {
    const NAME: &'static str = "alarm";

    fn followed(&mut self) -> (&mut ReferenceLedger, &mut ActiveGoals) {
        (&mut self.reference, &mut self.active)
    }

    /// Adopts the alarms of the ledger.
    fn update(&mut self, at: Duration) {
        if self.reference.ledger.alarms().ne(&self.alarms) {
            self.alarms = self.reference.ledger.alarms().cloned().collect();
            self.changed = at;
        }
    }

    fn check_goals(&mut self, at: Duration, fleet: &Fleet) -> Result<(), InvariantViolation> {
        if self.alarms.is_empty() {
            self.informed.clear();
            return Ok(());
        }
        let text = self.text();
        let states_alarm = |robot: &RobotId| stated_problem(fleet, robot).is_some_and(|problem| problem == text);
        self.informed.follow(at, fleet.world.robots().into_iter().filter(states_alarm).collect());
        self.check(at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chaos::dates::DATE_MS;
    use crate::slug;
    use consort_protocol::lease::Epoch;
    use consort_protocol::ledger::{AlarmChange, AlarmPlan, Command, OrderRequest};
    use consort_protocol::pose::Pose;
    use consort_skills::actions::{Dock, Goal, NavigateToPose};
    use std::collections::BTreeSet;

    fn secs(seconds: u64) -> Duration {
        Duration::from_secs(seconds)
    }

    /// Raises an alarm with this response.
    fn raise(state: &mut UnderAlarm, at: Duration, index: u64, alarm: &str, robots: AlarmResponse) {
        let plan = AlarmPlan { robots, places: BTreeSet::new(), closes: BTreeSet::new() };
        let change = AlarmChange::Raise { alarm: slug(alarm), plan, reason: String::new() };
        let order = OrderRequest { change, by: "Nia".to_owned(), at_ms: DATE_MS, request: None };
        let commands = [Command::first_wire_version(3), Command::ChangeAlarms { order }];
        state.reference.apply(Epoch { term: 1, index }, &commands);
        state.update(at);
    }

    fn drive() -> Goal {
        NavigateToPose::to(Pose::new(0.0, 0.0, 0.0), Some(slug("Dock"))).into()
    }

    /// Returns the state in which garnet pursues a goal in a role.
    fn pursuing(goal: &Goal) -> UnderAlarm {
        let mut state = UnderAlarm::new(secs(4));
        state.active.roles.insert((slug("garnet"), "lab-samples-1".parse().unwrap(), slug("r1")));
        state.active.begin(&slug("garnet"), 7, goal);
        state
    }

    #[test]
    fn a_robot_that_goes_on_during_an_alarm_is_found() {
        let mut state = pursuing(&drive());
        assert_eq!(state.check(secs(200)), Ok(()), "there is no alarm");
        raise(&mut state, secs(100), 1, "freeze", AlarmResponse::Stop);
        assert_eq!(state.check(secs(107)), Ok(()), "its lease");
        let violation = state.check(secs(108)).unwrap_err().0;
        assert_eq!(violation, "garnet pursues goal 7, 8.0 s after it was under alarm freeze by Nia");
        state.active.server_changed = secs(105);
        assert_eq!(state.check(secs(108)), Ok(()), "the driver server permits it");
    }

    #[test]
    fn a_robot_that_assembles_only_drives_until_another_alarm_stops_it() {
        let mut state = pursuing(&drive());
        raise(&mut state, secs(100), 1, "fire", AlarmResponse::Assemble);
        assert_eq!(state.check(secs(120)), Ok(()));
        raise(&mut state, secs(120), 2, "freeze", AlarmResponse::Stop);
        assert_eq!(state.check(secs(127)), Ok(()), "its lease");
        assert!(state.check(secs(128)).is_err());
        let mut state = pursuing(&Dock { charger: None }.into());
        raise(&mut state, secs(100), 1, "fire", AlarmResponse::Assemble);
        assert!(state.check(secs(108)).is_err(), "it goes on with its task");
    }

    #[test]
    fn a_robot_without_a_role_may_go_on_until_it_states_the_alarm() {
        let mut state = UnderAlarm::new(secs(4));
        state.active.begin(&slug("garnet"), 7, &drive());
        raise(&mut state, secs(100), 1, "freeze", AlarmResponse::Stop);
        assert_eq!(state.check(secs(130)), Ok(()), "it has not received the alarm");
        state.informed.follow(secs(120), [slug("garnet")].into());
        assert_eq!(state.check(secs(127)), Ok(()));
        assert!(state.check(secs(128)).is_err());
    }
}
