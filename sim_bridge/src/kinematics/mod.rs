//! How bodies move: models of chassis, as plain values over nalgebra's poses, in metres, seconds and radians.
//!
//! | model | moves | limits |
//! |---|---|---|
//! | [`Differential`] | forward and turning, by PID control of heading and speed (thesis Figure 5.2) | speed, acceleration, turn rate, turn acceleration |
//! | [`Omnidirectional`] | in every direction, turning as it goes | the same |
//! | [`Ackermann`] | ahead or back along arcs and straights, as a car does | speed, acceleration, turning radius |
//! | [`Aerial`] | in space, climbing and sinking at its own rate | speed, acceleration, climb rate, climb acceleration, turn rate |
//!
//! A [`Mover`] is any of them with a clock. A model *decides* at the instants of its own control loop, as the computer on a
//! robot does; between two decisions its speeds hold, and its motion has a closed form. So it makes no difference in which
//! steps time is let pass: a course takes as long at 10 Hz as at 60.
//!
//! A straight run needs no control at all: [`StraightRun`] says where it is at any time, and when it ends.

mod ackermann;
mod aerial;
mod avoidance;
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

pub use ackermann::Ackermann;
pub use aerial::Aerial;
pub use avoidance::Neighbour;
pub use differential::Differential;
pub use dubins::DubinsPath;
pub use kinematic_model::KinematicModel;
pub use motion_math::drive_arc;
pub use omnidirectional::Omnidirectional;
pub use pid::{Pid, PidGains};
pub use settings::{
    AckermannSettings, AerialSettings, DifferentialSettings, Kinematics, KinematicsError, OmnidirectionalSettings,
};
pub use trapezoid_profile::{ProfileLimits, StopPoint, TrapezoidProfile};
