//! Component access is limited to a system's declarations.

use super::*;
use crate::component_types;
use crate::world::location::RobotLocation;
use crate::world::preconditions::action_error;
use crate::world::samples::Custody;
use crate::world::sim_state::SimState;
use crate::world::system::System;
use crate::world::system_access::ComponentType;
use consort_skills::actions::Wait;
use hecs::Entity;

/// Declares that it reads locations, and reads custody without declaring it.
struct Nosy {
    whereabouts_are_named_as_written: bool,
    looks_at_custody: bool,
}

impl System for Nosy {
    fn name(&self) -> &'static str {
        "nosy"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![RobotLocation]
    }

    fn writes(&self) -> Vec<ComponentType> {
        if self.whereabouts_are_named_as_written { component_types![RobotLocation] } else { component_types![] }
    }

    fn check_goal_allowed(&self, state: &SimState, robot: Entity, _goal: &Goal) -> Result<(), ActionError> {
        drop(state.get::<RobotLocation>(robot));
        drop(state.get_mut::<RobotLocation>(robot));
        if self.looks_at_custody && state.find::<Custody>(robot).is_some() {
            return Err(action_error(ErrorCode::Busy, "a robot is no sample".to_owned()));
        }
        Ok(())
    }
}

fn with(system: &'static dyn System) {
    let mut world = World::new(hospital(1).robot(carrier("r1", "Dock"))).unwrap();
    world.systems.push(system);
    run_to_success(&mut world, "r1", 1, Goal::from(Wait { time: Seconds::ZERO }));
}

#[test]
fn declared_components_are_accessible() {
    with(&Nosy { whereabouts_are_named_as_written: true, looks_at_custody: false });
}

#[test]
#[should_panic(expected = "system nosy writes RobotLocation, which it does not declare")]
fn a_component_declared_as_read_is_not_writable() {
    with(&Nosy { whereabouts_are_named_as_written: false, looks_at_custody: false });
}

#[test]
#[should_panic(expected = "system nosy reads Custody, which it does not declare")]
fn an_undeclared_component_is_not_readable() {
    with(&Nosy { whereabouts_are_named_as_written: true, looks_at_custody: true });
}
