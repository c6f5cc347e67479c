//! A charger has a single robot: no robot connects to a charger at which another is connected, or to which another comes
//! with the lease in the ledger.
//!
//! Robots exclude each other by the claims in their records, which contain their leases. If they did not receive each
//! other's records, as in a partition, they may meet at a charger.

use super::reference_ledger::ReferenceLedger;
use super::{Invariant, InvariantViolation};
use crate::order_bounds::CHARGER_CONTACT;
use crate::{Fleet, Observation, slug};
use consort_protocol::ids::{NodeId, PlaceId, RobotId};
use consort_protocol::ledger::ResourceLease;
use consort_skills::actions::{Dock, Goal};
use consort_world::world::{LoggedEvent, WorldEvent as InWorld};
use std::collections::BTreeMap;
use std::time::Duration;

/// Interval at which the contact of the robots is examined.
const INTERVAL: Duration = Duration::from_secs(1);

#[derive(Default)]
pub(super) struct OnePerCharger {
    /// Charger of the latest goal of each robot to connect.
    docks: BTreeMap<RobotId, PlaceId>,
    connected: BTreeMap<RobotId, PlaceId>,
    /// Robots whose own records claim a charger with its lease in the ledger, and since when.
    leased: BTreeMap<PlaceId, (RobotId, Duration)>,
    reference: ReferenceLedger,
    /// Robots with nodes that count each other alive, and since when.
    contact: BTreeMap<[RobotId; 2], Duration>,
    /// Time of the next examination.
    due: Duration,
}

/// Returns two robots in the order of their names.
fn pair(one: &RobotId, other: &RobotId) -> [RobotId; 2] {
    if one < other { [one.clone(), other.clone()] } else { [other.clone(), one.clone()] }
}

impl OnePerCharger {
    fn begins_goal(&mut self, robot: &RobotId, goal: &Goal) {
        if let Some(Ok(Dock { charger: Some(charger) })) = goal.read::<Dock>() {
            self.docks.insert(robot.clone(), charger);
        }
    }

    fn connects(&mut self, at: Duration, robot: &RobotId) -> Result<(), InvariantViolation> {
        let Some(charger) = self.docks.get(robot).cloned() else { return Ok(()) };
        let in_contact =
            |other: &RobotId| self.contact.get(&pair(robot, other)).is_some_and(|since| at >= *since + CHARGER_CONTACT);
        let mut connected = self.connected.iter().filter(|(_, place)| **place == charger);
        if let Some((other, _)) = connected.find(|(other, _)| in_contact(other)) {
            return Err(format!("{robot} connects to the charger {charger} while {other} is connected to it").into());
        }
        let leased =
            self.leased.get(&charger).filter(|(other, since)| other != robot && at >= *since + CHARGER_CONTACT);
        if let Some((other, _)) = leased.filter(|(other, _)| in_contact(other)) {
            return Err(format!("{robot} connects to the charger {charger}, which {other} has leased").into());
        }
        self.connected.insert(robot.clone(), charger);
        Ok(())
    }

    /// Adopts the leases that the robots have claimed.
    fn follow_leases(&mut self, at: Duration, claimed: BTreeMap<PlaceId, RobotId>) {
        self.leased.retain(|charger, (robot, _)| claimed.get(charger) == Some(&*robot));
        for (charger, robot) in claimed {
            self.leased.entry(charger).or_insert((robot, at));
        }
    }

    /// Adopts which of the robots are in contact now.
    fn follow_contact(&mut self, at: Duration, in_contact: &[[RobotId; 2]]) {
        self.contact.retain(|pair, _| in_contact.contains(pair));
        for pair in in_contact {
            self.contact.entry(pair.clone()).or_insert(at);
        }
    }
}

impl Invariant for OnePerCharger {
    fn name(&self) -> &'static str {
        "one_per_charger"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        self.reference.observe(entry);
        Ok(())
    }

    fn observe_world(&mut self, at: Duration, entry: &LoggedEvent, fleet: &Fleet) -> Result<(), InvariantViolation> {
        if fleet.chargers().next().is_none() {
            return Ok(());
        }
        match &entry.event {
            InWorld::GoalStarted { robot, goal, .. } => self.begins_goal(robot, goal),
            InWorld::Docked { robot, docked: true } => return self.connects(at, robot),
            InWorld::Docked { robot, docked: false } => {
                self.connected.remove(robot);
            }
            _ => {}
        }
        Ok(())
    }

    fn check_state(&mut self, at: Duration, fleet: &Fleet) -> Result<(), InvariantViolation> {
        if at < self.due || fleet.chargers().next().is_none() {
            return Ok(());
        }
        self.due = at + INTERVAL;
        let robots: Vec<(NodeId, _)> = fleet.nodes.iter().map(|(name, node)| (slug::<NodeId>(name), node)).collect();
        let robots: Vec<_> = robots.into_iter().filter(|(name, _)| fleet.is_robot(name)).collect();
        let mut in_contact = vec![];
        for (number, (one, node)) in robots.iter().enumerate() {
            for (other, other_node) in &robots[number + 1..] {
                if node.knowledge.is_alive(other) && other_node.knowledge.is_alive(one) {
                    in_contact.push(pair(&RobotId::from(one.clone()), &RobotId::from(other.clone())));
                }
            }
        }
        self.follow_contact(at, &in_contact);
        let is_claimed = |(charger, lease): &(&PlaceId, &ResourceLease)| {
            let record = fleet.knowledge_of(lease.robot.as_str(), &NodeId::from(lease.robot.clone()));
            let charging = record.and_then(|record| record.charging);
            let claim = charging.as_ref().and_then(|charging| charging.claim());
            claim.is_some_and(|claim| claim.charger == **charger && claim.lease == Some(lease.epoch.index))
        };
        let leases = self.reference.ledger.charger_leases();
        let leases = leases.iter().filter(is_claimed);
        let claimed = leases.map(|(charger, lease)| (charger.clone(), lease.robot.clone())).collect();
        self.follow_leases(at, claimed);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_robot_at_a_charger_is_found_if_the_robots_were_in_contact() {
        let secs = Duration::from_secs;
        let (garnet, hazel): (RobotId, RobotId) = (slug("garnet"), slug("hazel"));
        let meet = |contact_s: u64, place: &str| {
            let docks = BTreeMap::from([(garnet.clone(), slug("Dock")), (hazel.clone(), slug(place))]);
            let mut state = OnePerCharger { docks, ..OnePerCharger::default() };
            state.follow_contact(secs(0), &[]);
            state.follow_contact(secs(100 - contact_s), &[pair(&hazel, &garnet)]);
            assert_eq!(state.connects(secs(99), &garnet), Ok(()));
            state.connects(secs(100), &hazel)
        };
        let violation = meet(10, "Dock").unwrap_err().0;
        assert_eq!(violation, "hazel connects to the charger Dock while garnet is connected to it");
        assert_eq!(meet(9, "Dock"), Ok(()), "the claim may not have arrived");
        assert_eq!(meet(10, "PC Room 8"), Ok(()));
    }

    #[test]
    fn a_robot_at_a_charger_that_another_has_leased_is_found() {
        let secs = Duration::from_secs;
        let (garnet, hazel): (RobotId, RobotId) = (slug("garnet"), slug("hazel"));
        let connects = |contact_s: u64, leased_s: u64, holder: &RobotId| {
            let docks = BTreeMap::from([(hazel.clone(), slug("Dock"))]);
            let mut state = OnePerCharger { docks, ..OnePerCharger::default() };
            state.follow_contact(secs(100 - contact_s), &[pair(&hazel, &garnet)]);
            let claimed = || BTreeMap::from([(slug("Dock"), holder.clone())]);
            state.follow_leases(secs(100 - leased_s), claimed());
            state.follow_leases(secs(100), claimed());
            state.connects(secs(100), &hazel)
        };
        let violation = connects(10, 10, &garnet).unwrap_err().0;
        assert_eq!(violation, "hazel connects to the charger Dock, which garnet has leased");
        assert_eq!(connects(10, 9, &garnet), Ok(()), "the claim may not have arrived");
        assert_eq!(connects(9, 10, &garnet), Ok(()), "nor without contact");
        assert_eq!(connects(10, 10, &hazel), Ok(()));
    }
}
