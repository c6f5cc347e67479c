//! No free robot strands while a charger that it could reach is free.
//!
//! A robot in a role may strand: faults prolong its tasks beyond their estimates. So may a robot whose battery was
//! drained by a fault, and a robot whose way people have closed.

use super::reference_ledger::ReferenceLedger;
use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use consort_protocol::ids::{NodeId, PlaceId, RobotId};
use consort_protocol::knowledge::Availability;
use consort_skills::actions::RobotBackend as _;
use consort_skills::environment::Routes;
use consort_world::world::{LoggedEvent, WorldEvent as InWorld};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Time in which a free robot reaches a free charger: the robot avoids a charger for 60 s after a failed task, and drives
/// across the hospital in 10 s, or in 50 s if the world is slow.
const LIMIT: Duration = Duration::from_secs(120);

/// Interval at which the robots are examined.
const INTERVAL: Duration = Duration::from_secs(1);

/// Charge above which a robot that strands has used its battery up. A fault leaves it less.
const USED_UP: f64 = 0.045;

#[derive(Default)]
pub(super) struct Charged {
    /// Robots that are free while a charger is free, and since when.
    may_charge: BTreeMap<RobotId, Duration>,
    reference: ReferenceLedger,
    /// Time of the next examination.
    due: Duration,
}

impl Charged {
    fn follow(&mut self, at: Duration, may_charge: &BTreeSet<RobotId>) {
        self.may_charge.retain(|robot, _| may_charge.contains(robot));
        for robot in may_charge {
            self.may_charge.entry(robot.clone()).or_insert(at);
        }
    }

    fn strands(&self, at: Duration, robot: &RobotId, battery: f64) -> Result<(), InvariantViolation> {
        match self.may_charge.get(robot) {
            Some(since) if battery > USED_UP && at >= *since + LIMIT => {
                let free_s = at.saturating_sub(*since).as_secs();
                Err(format!("{robot} has run out of charge, although it and a charger were free for {free_s} s").into())
            }
            _ => Ok(()),
        }
    }
}

/// Returns the robots that are free while a charger is free: no other robot stands there or claims it, and people have
/// closed neither it nor the way.
fn robots_that_may_charge(fleet: &Fleet, closed: &[(PlaceId, PlaceId)]) -> BTreeSet<RobotId> {
    let robots = fleet.world.robots();
    let routes = fleet.world.with(|world| Routes::new(&world.map().topology()).expect("the shipped map is sound"));
    let routes = routes.without_closed(closed);
    let record = |robot: &RobotId| fleet.knowledge_of(robot.as_str(), &NodeId::from(robot.clone()));
    let mut taken = BTreeMap::new();
    for robot in &robots {
        let place = fleet.world.telemetry(robot).map(|telemetry| telemetry.place);
        let charging = record(robot).and_then(|record| record.charging);
        let claim = charging.and_then(|charging| charging.claim().map(|claim| claim.charger.clone()));
        taken.insert(robot.clone(), [place, claim]);
    }
    let may_charge = |robot: &RobotId| {
        let Some(record) = record(robot) else { return false };
        let is_free = record.speed.is_some() && record.availability == Availability::Free;
        let is_left = |charger: &PlaceId| {
            let mut others = taken.iter().filter(|(other, _)| *other != robot).flat_map(|(_, places)| places);
            others.all(|place| place.as_ref() != Some(charger))
        };
        let is_reachable = |charger: &PlaceId| routes.distance(&record.place, charger).is_ok();
        is_free && fleet.chargers().any(|charger| is_left(charger) && is_reachable(charger))
    };
    robots.iter().filter(|robot| may_charge(robot)).cloned().collect()
}

impl Invariant for Charged {
    fn name(&self) -> &'static str {
        "charged"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        self.reference.observe(entry);
        Ok(())
    }

    fn observe_world(&mut self, at: Duration, entry: &LoggedEvent, fleet: &Fleet) -> Result<(), InvariantViolation> {
        let InWorld::Stranded { robot } = &entry.event else { return Ok(()) };
        let battery = fleet.world.telemetry(robot).map_or(0.0, |telemetry| telemetry.battery.get());
        self.strands(at, robot, battery)
    }

    fn check_state(&mut self, at: Duration, fleet: &Fleet) -> Result<(), InvariantViolation> {
        if at >= self.due && fleet.chargers().next().is_some() {
            self.due = at + INTERVAL;
            let closed: Vec<_> = self.reference.ledger.closures().flat_map(|closure| closure.part.pairs()).collect();
            self.follow(at, &robots_that_may_charge(fleet, &closed));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slug;

    #[test]
    fn a_robot_that_strands_beside_a_free_charger_is_found() {
        let (secs, garnet) = (Duration::from_secs, slug::<RobotId>("garnet"));
        let mut state = Charged::default();
        assert_eq!(state.strands(secs(300), &garnet, 0.05), Ok(()), "it had a role");
        let free = BTreeSet::from([garnet.clone()]);
        state.follow(secs(100), &free);
        state.follow(secs(101), &free);
        let violation = state.strands(secs(220), &garnet, 0.05).unwrap_err().0;
        assert_eq!(violation, "garnet has run out of charge, although it and a charger were free for 120 s");
        assert_eq!(state.strands(secs(219), &garnet, 0.05), Ok(()), "it drove to the charger");
        assert_eq!(state.strands(secs(220), &garnet, 0.04), Ok(()), "a fault drained it");
        state.follow(secs(219), &BTreeSet::new());
        assert_eq!(state.strands(secs(220), &garnet, 0.05), Ok(()));
    }
}
