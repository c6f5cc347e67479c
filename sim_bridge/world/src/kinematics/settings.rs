//! Settings of the kinematic models.

use super::pid::PidGains;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Kinematics of a robot, as a setup names it:
/// `kinematics = { kind = "differential", acceleration_mps2 = 0.8 }`. The top speed is the robot's
/// own. Omitted fields have their default values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Kinematics {
    /// Two driven wheels: turns on the spot, drives forward.
    Differential(DifferentialSettings),
    /// Mecanum or omni wheels: drives in every direction.
    Omnidirectional(OmnidirectionalSettings),
    /// A car: drives forward and steers.
    Ackermann(AckermannSettings),
    /// A drone.
    Aerial(AerialSettings),
    /// A chassis of the program itself.
    Own(OwnSettings),
}

/// Settings of a chassis of the program itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OwnSettings {
    /// Name of the chassis.
    pub name: String,
    /// Its settings, by name.
    #[serde(default)]
    pub settings: BTreeMap<String, f64>,
    /// Acceleration, in metres per second squared: for estimates of the remaining time.
    #[serde(default = "usual_acceleration")]
    pub acceleration_mps2: f64,
    /// Period of the control loop, in seconds.
    #[serde(default = "usual_period")]
    pub control_period_s: f64,
}

impl OwnSettings {
    /// Returns a chassis with the usual period and acceleration, and without settings of its own.
    pub fn named(name: &str) -> OwnSettings {
        let (acceleration_mps2, control_period_s) = (usual_acceleration(), usual_period());
        OwnSettings { name: name.to_owned(), settings: BTreeMap::new(), acceleration_mps2, control_period_s }
    }
}

fn usual_acceleration() -> f64 {
    DifferentialSettings::default().acceleration_mps2
}

fn usual_period() -> f64 {
    DifferentialSettings::default().control_period_s
}

/// Settings of a [differential](Kinematics::Differential) chassis. The defaults are those of a
/// small hospital robot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DifferentialSettings {
    /// Acceleration, in metres per second squared.
    pub acceleration_mps2: f64,
    /// Greatest turn rate, in radians per second.
    pub turn_rate_rps: f64,
    /// Turn acceleration, in radians per second squared.
    pub turn_acceleration_rps2: f64,
    /// Gains of the heading controller: from an error in radians to a turn rate.
    pub heading: PidGains,
    /// Gains of the speed controller: from an error in metres per second to an acceleration.
    pub speed: PidGains,
    /// Period of the control loop, in seconds.
    pub control_period_s: f64,
}

impl Default for DifferentialSettings {
    fn default() -> Self {
        Self {
            acceleration_mps2: 0.8,
            turn_rate_rps: 1.5,
            turn_acceleration_rps2: 3.0,
            heading: PidGains { kp: 4.0, ki: 0.05, kd: 0.05 },
            speed: PidGains { kp: 10.0, ki: 0.5, kd: 0.0 },
            control_period_s: 0.02,
        }
    }
}

/// Settings of an [`Omnidirectional`](Kinematics::Omnidirectional) chassis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct OmnidirectionalSettings {
    /// Acceleration, in metres per second squared.
    pub acceleration_mps2: f64,
    /// Greatest turn rate, in radians per second.
    pub turn_rate_rps: f64,
    /// Turn acceleration, in radians per second squared.
    pub turn_acceleration_rps2: f64,
    /// Period of the control loop, in seconds.
    pub control_period_s: f64,
}

impl Default for OmnidirectionalSettings {
    fn default() -> Self {
        Self { acceleration_mps2: 0.8, turn_rate_rps: 1.5, turn_acceleration_rps2: 3.0, control_period_s: 0.02 }
    }
}

/// Settings of an [`Ackermann`](Kinematics::Ackermann) chassis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AckermannSettings {
    /// Acceleration, in metres per second squared.
    pub acceleration_mps2: f64,
    /// Minimum turning radius, in metres.
    pub turning_radius_m: f64,
    /// Period of the control loop, in seconds.
    pub control_period_s: f64,
}

impl Default for AckermannSettings {
    fn default() -> Self {
        Self { acceleration_mps2: 0.8, turning_radius_m: 1.0, control_period_s: 0.02 }
    }
}

/// Settings of an [aerial](Kinematics::Aerial) robot. The defaults are those of a small quadrotor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AerialSettings {
    /// Horizontal acceleration, in metres per second squared.
    pub acceleration_mps2: f64,
    /// Greatest climb and sink rate, in metres per second.
    pub climb_mps: f64,
    /// Vertical acceleration, in metres per second squared.
    pub climb_acceleration_mps2: f64,
    /// Greatest turn rate, in radians per second.
    pub turn_rate_rps: f64,
    /// Turn acceleration, in radians per second squared.
    pub turn_acceleration_rps2: f64,
    /// Flight height, in metres above the floor.
    pub height_m: f64,
    /// Clearance to other bodies, in metres.
    pub margin_m: f64,
    /// Period of the control loop, in seconds.
    pub control_period_s: f64,
}

impl Default for AerialSettings {
    fn default() -> Self {
        Self {
            acceleration_mps2: 4.0,
            climb_mps: 2.0,
            climb_acceleration_mps2: 4.0,
            turn_rate_rps: 2.0,
            turn_acceleration_rps2: 4.0,
            height_m: 2.0,
            margin_m: 0.1,
            control_period_s: 0.05,
        }
    }
}

/// A kinematic setting is out of range.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("{field} is {value}, allowed is {allowed}")]
pub struct KinematicsError {
    /// Name of the field.
    pub field: &'static str,
    /// Value given.
    pub value: f64,
    /// Allowed range, as text.
    pub allowed: &'static str,
}

impl Kinematics {
    /// Acceleration over ground, in metres per second squared.
    pub(crate) fn acceleration_mps2(&self) -> f64 {
        match self {
            Kinematics::Differential(settings) => settings.acceleration_mps2,
            Kinematics::Omnidirectional(settings) => settings.acceleration_mps2,
            Kinematics::Ackermann(settings) => settings.acceleration_mps2,
            Kinematics::Aerial(settings) => settings.acceleration_mps2,
            Kinematics::Own(settings) => settings.acceleration_mps2,
        }
    }

    /// Checks that every number is in its range.
    ///
    /// # Errors
    /// [`KinematicsError`] for the first number out of range.
    pub(crate) fn check(&self) -> Result<(), KinematicsError> {
        let limit = |field, value| within(field, value, 0.001, 1_000.0, "a number from 0.001 to 1000");
        let gain = |field, value| within(field, value, 0.0, 1_000.0, "a number from 0 to 1000");
        let period = |value| within("control_period_s", value, 0.001, 1.0, "a number of seconds from 0.001 to 1");
        match self {
            Kinematics::Differential(settings) => {
                limit("acceleration_mps2", settings.acceleration_mps2)?;
                limit("turn_rate_rps", settings.turn_rate_rps)?;
                limit("turn_acceleration_rps2", settings.turn_acceleration_rps2)?;
                limit("heading.kp", settings.heading.kp)?;
                gain("heading.ki", settings.heading.ki)?;
                gain("heading.kd", settings.heading.kd)?;
                limit("speed.kp", settings.speed.kp)?;
                gain("speed.ki", settings.speed.ki)?;
                gain("speed.kd", settings.speed.kd)?;
                period(settings.control_period_s)
            }
            Kinematics::Omnidirectional(settings) => {
                limit("acceleration_mps2", settings.acceleration_mps2)?;
                limit("turn_rate_rps", settings.turn_rate_rps)?;
                limit("turn_acceleration_rps2", settings.turn_acceleration_rps2)?;
                period(settings.control_period_s)
            }
            Kinematics::Ackermann(settings) => {
                limit("acceleration_mps2", settings.acceleration_mps2)?;
                limit("turning_radius_m", settings.turning_radius_m)?;
                period(settings.control_period_s)
            }
            Kinematics::Aerial(settings) => {
                limit("acceleration_mps2", settings.acceleration_mps2)?;
                limit("climb_mps", settings.climb_mps)?;
                limit("climb_acceleration_mps2", settings.climb_acceleration_mps2)?;
                limit("turn_rate_rps", settings.turn_rate_rps)?;
                limit("turn_acceleration_rps2", settings.turn_acceleration_rps2)?;
                gain("height_m", settings.height_m)?;
                gain("margin_m", settings.margin_m)?;
                period(settings.control_period_s)
            }
            Kinematics::Own(settings) => {
                limit("acceleration_mps2", settings.acceleration_mps2)?;
                period(settings.control_period_s)
            }
        }
    }
}

fn within(
    field: &'static str,
    value: f64,
    least: f64,
    most: f64,
    allowed: &'static str,
) -> Result<(), KinematicsError> {
    if (least..=most).contains(&value) { Ok(()) } else { Err(KinematicsError { field, value, allowed }) }
}
