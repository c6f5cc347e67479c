//! What can happen on a floor, a file each.

mod arm;
mod collisions;
mod company;
pub(crate) mod docking;
pub(crate) mod doors;
mod drawer;
pub(crate) mod driving;
mod gusts;
pub(crate) mod lifts;
pub(crate) mod moods;
pub(crate) mod obstacles;
pub(crate) mod people;
pub(crate) mod power;
pub(crate) mod steering;
mod turning;
mod waiting;

use super::system::System;

/// All systems that there are, in the order in which they hear of things.
static ALL: [&dyn System; 16] = [
    &steering::Steering,
    &driving::Driving,
    &doors::Doors,
    &lifts::Lifts,
    &obstacles::Obstacles,
    &turning::Turning,
    &waiting::Waiting,
    &company::Company,
    &drawer::Drawer,
    &arm::Arm,
    &docking::Docking,
    &power::Power,
    &moods::Moods,
    &people::People,
    &collisions::Collisions,
    &gusts::Gusting,
];

/// The names of all systems that there are, in the order in which they hear of things.
pub fn system_names() -> impl Iterator<Item = &'static str> {
    ALL.iter().map(|system| system.name())
}

/// The system of a name.
pub(crate) fn of_name(name: &str) -> Option<&'static dyn System> {
    ALL.into_iter().find(|system| system.name() == name)
}
