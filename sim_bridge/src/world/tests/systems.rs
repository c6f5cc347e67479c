//! Systems are held to what they say of themselves.

use super::*;
use crate::world::location::RobotLocation;
use crate::world::preconditions::action_error;
use crate::world::samples::Custody;
use crate::world::sim_state::SimState;
use crate::world::system::{ComponentType, System, kinds};
use hecs::Entity;

/// Looks at where robots are, and says that it does; looks at who has what, and does not say so.
struct Nosy {
    whereabouts_are_named_as_written: bool,
    looks_at_custody: bool,
}

impl System for Nosy {
    fn name(&self) -> &'static str {
        "nosy"
    }

    fn reads(&self) -> Vec<ComponentType> {
        kinds![RobotLocation]
    }

    fn writes(&self) -> Vec<ComponentType> {
        if self.whereabouts_are_named_as_written { kinds![RobotLocation] } else { kinds![] }
    }

    fn check_goal_allowed(&self, floor: &SimState, robot: Entity, _goal: &Goal) -> Result<(), ActionError> {
        drop(floor.get::<RobotLocation>(robot));
        drop(floor.get_mut::<RobotLocation>(robot));
        if self.looks_at_custody && floor.find::<Custody>(robot).is_some() {
            return Err(action_error(ErrorCode::Busy, "a robot is no sample".to_owned()));
        }
        Ok(())
    }
}

fn with(system: &'static dyn System) {
    let mut world = World::new(hospital(1).robot(carrier("r1", "Dock"))).unwrap();
    world.systems.push(system);
    run_to_success(&mut world, "r1", 1, Goal::Wait { time: Seconds::ZERO });
}

#[test]
fn what_is_named_may_be_read_and_written() {
    with(&Nosy { whereabouts_are_named_as_written: true, looks_at_custody: false });
}

#[test]
#[should_panic(expected = "system nosy writes Whereabouts, which it does not name")]
fn what_is_named_as_read_alone_is_not_written() {
    with(&Nosy { whereabouts_are_named_as_written: false, looks_at_custody: false });
}

#[test]
#[should_panic(expected = "system nosy reads Custody, which it does not name")]
fn what_is_not_named_is_not_read() {
    with(&Nosy { whereabouts_are_named_as_written: true, looks_at_custody: true });
}
