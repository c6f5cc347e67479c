//! Error of a mission that would exceed its bound on energy.

use crate::ids::{RobotId, RoleId};
use crate::units::{Energy, EnergyLimit};
use std::collections::BTreeMap;

/// Error: every assignment of the roles exceeds the bound on the mission's energy.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "the mission would exceed its bound on energy, energy_max {limit:.3}: the open roles need at least {least:.3} of a full \
     battery ({}){}", robots_text(.holders), used_text(*.used)
)]
pub struct EnergyExceeded {
    /// The bound.
    pub limit: EnergyLimit,
    /// Estimated energy of the awards so far.
    pub used: Energy,
    /// Estimated energy of the assignment with the least energy.
    pub least: Energy,
    /// Robots of that assignment.
    pub holders: BTreeMap<RoleId, RobotId>,
}

fn robots_text(holders: &BTreeMap<RoleId, RobotId>) -> String {
    holders.iter().map(|(role, robot)| format!("{robot} as {role}")).collect::<Vec<_>>().join(", ")
}

fn used_text(used: Energy) -> String {
    if used == Energy::ZERO { String::new() } else { format!(", and earlier awards were estimated at {used:.3}") }
}
