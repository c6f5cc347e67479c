//! What can happen on a floor, a file each.

mod arm;
mod collisions;
mod company;
mod drawer;
mod driving;
mod gusts;
pub(crate) mod people;
pub(crate) mod power;
pub(crate) mod steering;
mod waiting;

use super::system::System;

/// All systems that there are, in the order in which they hear of things.
static ALL: [&dyn System; 10] = [
    &steering::Steering,
    &driving::Driving,
    &waiting::Waiting,
    &company::Company,
    &drawer::Drawer,
    &arm::Arm,
    &power::Power,
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
