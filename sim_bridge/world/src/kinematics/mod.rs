//! Kinematic models of robots: plain values over nalgebra's poses, in metres, seconds and radians.
//!
//! | model | motion | limits |
//! |---|---|---|
//! | [`Differential`](Kinematics::Differential) | forward and turning, by PID control of heading and speed (thesis Figure 5.2) | speed, acceleration, turn rate, turn acceleration |
//! | [`Omnidirectional`](Kinematics::Omnidirectional) | in every direction, turning at the same time | the same |
//! | [`Ackermann`](Kinematics::Ackermann) | forward or in reverse along arcs and straight lines, as a car does | speed, acceleration, turning radius |
//! | [`Aerial`](Kinematics::Aerial) | in space, climbing and sinking at its own rate | speed, acceleration, climb rate, climb acceleration, turn rate |
//! | [`Own`](Kinematics::Own) | as the [`Chassis`] of the program decides | its own |
//!
//! A `KinematicModel` is any of them with a clock. A model *decides* at the instants of its own
//! control loop, as the computer of a robot does. Between two decisions its speeds are constant and
//! its motion has a closed form. The size of the time steps therefore makes no difference: a drive
//! takes as long at 10 Hz as at 60 Hz.
//!
//! A straight run needs no control at all: `TrapezoidProfile` gives its position at any time, and
//! its end.

mod ackermann;
mod aerial;
mod avoidance;
mod chassis;
mod differential;
mod dubins;
mod kinematic_model;
mod motion_math;
mod omnidirectional;
mod pid;
mod settings;
#[cfg(test)]
mod tests;
mod trapezoid_profile;

pub(crate) use avoidance::Neighbour;
pub(crate) use chassis::build_chassis;
pub use chassis::{Chassis, ChassisBuilder, ChassisSettings, NamedChassis};
pub(crate) use kinematic_model::KinematicModel;
pub use settings::{
    AckermannSettings, AerialSettings, DifferentialSettings, Kinematics, KinematicsError, OmnidirectionalSettings,
    OwnSettings,
};
pub(crate) use trapezoid_profile::{ProfileLimits, TrapezoidProfile};
