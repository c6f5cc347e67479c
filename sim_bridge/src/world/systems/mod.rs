//! What can happen on a floor, a file each.

mod arm;
mod co_presence;
mod collisions;
pub(crate) mod docking;
pub(crate) mod doors;
mod drawer;
pub(crate) mod driving;
pub(crate) mod lifts;
pub(crate) mod obstacles;
pub(crate) mod people;
pub(crate) mod power;
pub(crate) mod spontaneous_actions;
pub(crate) mod steering;
mod turning;
mod waiting;
mod wind;

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
    &co_presence::CoPresenceSystem,
    &drawer::Drawer,
    &arm::Arm,
    &docking::Docking,
    &power::Power,
    &spontaneous_actions::SpontaneousActions,
    &people::People,
    &collisions::Collisions,
    &wind::WindSystem,
];

/// The names of all systems that there are, in the order in which they hear of things.
pub fn system_names() -> impl Iterator<Item = &'static str> {
    ALL.iter().map(|system| system.name())
}

/// The system of a name.
pub(crate) fn by_name(name: &str) -> Option<&'static dyn System> {
    ALL.into_iter().find(|system| system.name() == name)
}
