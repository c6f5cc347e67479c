//! Chassis that a program adds.

use nalgebra::Isometry2;
use std::collections::BTreeMap;
use std::fmt::Debug;

/// A chassis of the program itself. It decides at the instants of its control loop, and between two of them
/// it moves in a way that it computes ahead, like the shipped kinematic models.
pub trait Chassis: Debug + Send + Sync {
    /// Sets the pose to drive to, replacing the previous one; `None` brakes to a standstill.
    fn set_target(&mut self, target: Option<Isometry2<f64>>);

    /// Limits the speed from now on, in metres per second.
    fn set_max_speed(&mut self, max_mps: f64);

    /// Sets the heading at standstill, in radians.
    fn set_heading(&mut self, yaw_rad: f64);

    /// Stops at once, after a collision.
    fn stop_immediately(&mut self);

    /// Runs a control cycle: decides on the speeds for the next `period_s` seconds. Returns true when the
    /// robot has just arrived.
    fn control_step(&mut self, period_s: f64) -> bool;

    /// Moves for `dt_s` seconds, with the speeds of the latest control cycle.
    fn integrate(&mut self, dt_s: f64);

    /// Checks whether the robot moves or is about to. If not, time has no effect.
    fn is_moving(&self) -> bool;

    /// Returns the pose on the floor.
    fn pose(&self) -> Isometry2<f64>;

    /// Returns the distance to the target in metres; 0 without a target.
    fn remaining_m(&self) -> f64;
}

/// Settings with which a chassis is built.
#[derive(Debug, Clone, PartialEq)]
pub struct ChassisSettings {
    /// Settings of the robot's setup, by name.
    pub numbers: BTreeMap<String, f64>,
    /// Top speed, in metres per second.
    pub max_mps: f64,
    /// Distance from the centre to the outermost part, in metres.
    pub radius_m: f64,
    /// Pose at the start.
    pub pose: Isometry2<f64>,
}

/// A built chassis.
#[derive(Debug)]
pub(crate) struct OwnChassis(pub(crate) Box<dyn Chassis>);

/// Builds a chassis at standstill, or returns the reason why its settings are invalid.
pub type ChassisBuilder = fn(&ChassisSettings) -> Result<Box<dyn Chassis>, String>;

/// A chassis with its name in setups.
pub type NamedChassis = (&'static str, ChassisBuilder);

/// Builds the chassis of this name; `None` for an unknown name.
pub(crate) fn build_chassis(
    known: &[NamedChassis],
    name: &str,
    settings: &ChassisSettings,
) -> Option<Result<OwnChassis, String>> {
    let (_, build) = known.iter().find(|(known, _)| *known == name)?;
    Some(build(settings).map(OwnChassis))
}
