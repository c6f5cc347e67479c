//! Systems are held to what they say of themselves.

use super::*;
use crate::world::floor::Floor;
use crate::world::reach::refused;
use crate::world::samples::Custody;
use crate::world::system::{Kind, System, kinds};
use crate::world::whereabouts::Whereabouts;
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

    fn reads(&self) -> Vec<Kind> {
        kinds![Whereabouts]
    }

    fn writes(&self) -> Vec<Kind> {
        if self.whereabouts_are_named_as_written { kinds![Whereabouts] } else { kinds![] }
    }

    fn permit(&self, floor: &Floor, robot: Entity, _goal: &Goal) -> Result<(), ActionError> {
        drop(floor.get::<Whereabouts>(robot));
        drop(floor.get_mut::<Whereabouts>(robot));
        if self.looks_at_custody && floor.find::<Custody>(robot).is_some() {
            return Err(refused(ErrorCode::Busy, "a robot is no sample".to_owned()));
        }
        Ok(())
    }
}

fn with(system: &'static dyn System) {
    let mut world = World::new(hospital(1).robot(carrier("r1", "Dock"))).unwrap();
    world.systems.push(system);
    does(&mut world, "r1", 1, Goal::Wait { time: Seconds::ZERO });
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
