//! All systems, each in its own file.

mod arm;
mod co_presence;
mod collisions;
pub(super) mod declared_actions;
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

/// All systems, in the order in which they receive events.
static ALL: [&dyn System; 17] = [
    &steering::Steering,
    &driving::Driving,
    &doors::Doors,
    &lifts::Lifts,
    &obstacles::Obstacles,
    &turning::Turning,
    &waiting::Waiting,
    &declared_actions::DeclaredActions,
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

/// Names of all systems, in the order in which they receive events.
pub fn system_names() -> impl Iterator<Item = &'static str> {
    ALL.iter().map(|system| system.name())
}

/// Returns the system with this name.
pub(crate) fn by_name(name: &str) -> Option<&'static dyn System> {
    ALL.into_iter().find(|system| system.name() == name)
}
