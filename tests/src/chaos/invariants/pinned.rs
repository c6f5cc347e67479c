//! A role goes only to a robot that the order of a person permits: a pinned role to its robot, a reassigned role to the
//! named robot, or to any but the former one.

use super::reference_ledger::ReferenceLedger;
use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use consort_protocol::auction::RobotRestriction;
use consort_protocol::ids::{MissionId, RobotId, RoleId};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Command, Ledger};
use std::time::Duration;

#[derive(Default)]
pub(super) struct Pinned {
    reference: ReferenceLedger,
}

/// A role under the order of a person.
struct RestrictedRole {
    mission: MissionId,
    role: RoleId,
    restriction: RobotRestriction,
    /// Its robot, with the epoch of the award or promise.
    robot: Option<(RobotId, Epoch)>,
}

impl RestrictedRole {
    /// Checks the robot of the role after the next command.
    fn check(&self, next: Option<(RobotId, Epoch)>) -> Result<(), InvariantViolation> {
        let RestrictedRole { mission, role, restriction, robot } = self;
        match next.filter(|next| Some(next) != robot.as_ref()) {
            Some((next, epoch)) if !restriction.permits(&next) => {
                Err(format!("{next} gets {role} of {mission} at {epoch}, although it is {restriction}").into())
            }
            _ => Ok(()),
        }
    }
}

fn robot_of(ledger: &Ledger, mission: &MissionId, role: &RoleId) -> Option<(RobotId, Epoch)> {
    let holder = ledger.mission(mission)?.roles.get(role)?.holder.as_ref()?;
    Some((holder.robot.clone(), holder.epoch))
}

/// Returns the roles under orders.
fn restricted_roles(ledger: &Ledger) -> Vec<RestrictedRole> {
    let restricted = ledger.missions().flat_map(|entry| {
        let of_role = |(role, restriction)| RestrictedRole {
            robot: robot_of(ledger, &entry.id, &role),
            mission: entry.id.clone(),
            role,
            restriction,
        };
        entry.restrictions().into_iter().map(of_role).collect::<Vec<_>>()
    });
    restricted.collect()
}

impl Pinned {
    fn apply(&mut self, at: Epoch, commands: &[Command]) -> Result<(), InvariantViolation> {
        if !self.reference.is_new(at) {
            return Ok(());
        }
        for command in commands {
            let restricted = restricted_roles(&self.reference.ledger);
            self.reference.apply_command(at, command);
            for role in restricted {
                role.check(robot_of(&self.reference.ledger, &role.mission, &role.role))?;
            }
        }
        self.reference.index = at.index;
        Ok(())
    }
}

impl Invariant for Pinned {
    fn name(&self) -> &'static str {
        "pinned"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        match entry {
            Observation::EntryApplied { at, commands, .. } => self.apply(*at, commands),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chaos::invariants::test_missions::{award_rest, submit_rest};
    use crate::slug;
    use consort_protocol::ledger::{MissionChange, OrderRequest};

    fn epoch(index: u64) -> Epoch {
        Epoch { term: 1, index }
    }

    fn role(restriction: RobotRestriction) -> RestrictedRole {
        let (mission, role) = ("rest-1".parse().unwrap(), slug("r1"));
        RestrictedRole { mission, role, restriction, robot: Some((slug("garnet"), epoch(5))) }
    }

    #[test]
    fn a_robot_that_gets_a_role_against_an_order_is_found() {
        let garnet: RobotId = slug("garnet");
        let pinned = role(RobotRestriction::Pinned(garnet.clone()));
        for next in [None, Some((garnet.clone(), epoch(5))), Some((garnet.clone(), epoch(9)))] {
            assert_eq!(pinned.check(next), Ok(()));
        }
        let violation = pinned.check(Some((slug("hazel"), epoch(9)))).unwrap_err().0;
        assert_eq!(violation, "hazel gets r1 of rest-1 at 1.9, although it is pinned to garnet");
        let reassigned = role(RobotRestriction::Except(garnet.clone()));
        assert_eq!(reassigned.check(Some((garnet.clone(), epoch(5)))), Ok(()), "it has not returned the role");
        assert!(reassigned.check(Some((garnet, epoch(9)))).is_err());
        assert_eq!(reassigned.check(Some((slug("hazel"), epoch(9)))), Ok(()));
    }

    #[test]
    fn the_orders_are_those_of_the_ledger() {
        let mut state = Pinned::default();
        let change = MissionChange::Pin { role: slug("r1"), robot: Some(slug("garnet")) };
        let order = OrderRequest { change, by: "Nia".to_owned(), at_ms: 9, request: None };
        let pin = Command::ChangeMission { mission: slug("rest-1"), order };
        let commands = [Command::first_wire_version(3), submit_rest("a"), pin];
        assert_eq!(state.apply(epoch(1), &commands), Ok(()));
        let restricted = restricted_roles(&state.reference.ledger);
        let restrictions: Vec<_> = restricted.iter().map(|role| (&role.restriction, &role.robot)).collect();
        assert_eq!(restrictions, [(&RobotRestriction::Pinned(slug("garnet")), &None)]);
        assert_eq!(state.apply(epoch(2), &[award_rest(1, "garnet")]), Ok(()));
        let robot = robot_of(&state.reference.ledger, &slug("rest-1"), &slug("r1"));
        assert_eq!(robot, Some((slug("garnet"), epoch(2))));
    }
}
