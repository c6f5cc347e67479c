//! Differential drive after thesis Figure 5.2: a PID controller for the heading and another for the
//! speed.

use super::motion_math::{bearing, drive_arc, step_toward_scalar, stopping_speed, wrap_angle};
use super::pid::Pid;
use super::settings::DifferentialSettings;
use nalgebra::{Isometry2, UnitComplex};
use std::f64::consts::PI;

/// Position tolerance in metres: about the slip of a wheel.
const REACHED_M: f64 = 0.02;
/// Heading tolerance in radians.
const REACHED_RAD: f64 = 0.01;
/// Greatest speed at which the chassis may change from driving to turning.
const STILL_MPS: f64 = 0.02;
/// The chassis drives only while its target is within this angle ahead. Otherwise it first turns on
/// the spot.
const AHEAD_RAD: f64 = 0.5;
/// Fraction of the acceleration that is planned for braking. The rest compensates for the lag of
/// the controller.
const RESERVE: f64 = 0.7;

/// A differential drive and its controllers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Differential {
    settings: DifferentialSettings,
    pub(super) max_mps: f64,
    pose: Isometry2<f64>,
    speed_mps: f64,
    turn_rps: f64,
    heading: Pid,
    speed: Pid,
    set_target: Target,
    /// True for reverse driving.
    backward: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Target {
    /// Standstill.
    Rest,
    /// Drive to the position of the pose.
    Point(Isometry2<f64>),
    /// At the target position: turn to this heading.
    Heading(f64),
}

impl Differential {
    /// Creates a chassis at standstill.
    pub(crate) fn new(settings: DifferentialSettings, max_mps: f64, pose: Isometry2<f64>) -> Differential {
        let (heading, speed) = (Pid::new(settings.heading), Pid::new(settings.speed));
        Differential {
            settings,
            max_mps,
            pose,
            speed_mps: 0.0,
            turn_rps: 0.0,
            heading,
            speed,
            set_target: Target::Rest,
            backward: false,
        }
    }

    /// Current pose.
    pub(crate) fn pose(&self) -> &Isometry2<f64> {
        &self.pose
    }

    /// Forward speed (metres per second) and turn rate (radians per second, positive to the left).
    #[cfg(test)]
    pub(crate) fn speeds(&self) -> (f64, f64) {
        (self.speed_mps, self.turn_rps)
    }

    /// Straight-line distance to the target in metres.
    pub(crate) fn remaining_m(&self) -> f64 {
        match self.set_target {
            Target::Point(target) => (target.translation.vector - self.pose.translation.vector).norm(),
            Target::Rest | Target::Heading(_) => 0.0,
        }
    }

    pub(super) fn set_target(&mut self, target: Option<Isometry2<f64>>) {
        self.set_target = target.map_or(Target::Rest, Target::Point);
        self.backward = false;
        self.heading.reset();
        self.speed.reset();
    }

    pub(super) fn set_target_backward(&mut self, target: Isometry2<f64>) {
        self.set_target(Some(target));
        self.backward = true;
    }

    pub(super) fn set_heading(&mut self, yaw: f64) {
        self.pose.rotation = UnitComplex::new(yaw);
    }

    pub(super) fn stop_immediately(&mut self) {
        self.set_target(None);
        (self.speed_mps, self.turn_rps) = (0.0, 0.0);
    }

    pub(super) fn is_moving(&self) -> bool {
        self.set_target != Target::Rest || self.speed_mps != 0.0 || self.turn_rps != 0.0
    }

    /// Runs one control cycle: sets the speeds for the next period. Returns true when the chassis
    /// has just arrived.
    pub(super) fn control_step(&mut self, period: f64) -> bool {
        let yaw = self.pose.rotation.angle();
        if let Target::Point(target) = self.set_target
            && self.remaining_m() <= REACHED_M
            && self.speed_mps.abs() <= STILL_MPS
        {
            self.set_target = Target::Heading(target.rotation.angle());
            self.heading.reset();
        }
        match self.set_target {
            Target::Rest => self.set(0.0, 0.0, period),
            Target::Point(target) => {
                let to = target.translation.vector - self.pose.translation.vector;
                let (front, ahead) = if self.backward { (yaw + PI, -1.0) } else { (yaw, 1.0) };
                let error = wrap_angle(bearing(to) - front);
                let brakes = self.settings.acceleration_mps2 * RESERVE;
                let speed = if error.abs() < AHEAD_RAD {
                    // Close to the target, slower than the brakes would allow, so that the
                    // controller's lag does not matter.
                    stopping_speed(to.norm(), brakes, period).min(2.0 * to.norm()).min(self.max_mps) * error.cos()
                } else {
                    0.0
                };
                let turn = self.turn(error, period);
                self.set(ahead * speed, turn, period);
            }
            Target::Heading(wanted) => {
                let error = wrap_angle(wanted - yaw);
                if error.abs() <= REACHED_RAD
                    && self.turn_rps.abs() <= self.settings.turn_acceleration_rps2 * period
                    && self.speed_mps == 0.0
                {
                    self.stop_immediately();
                    return true;
                }
                let turn = self.turn(error, period);
                self.set(0.0, turn, period);
            }
        }
        false
    }

    /// Returns the turn rate for a heading error: never more than the chassis can brake.
    fn turn(&mut self, error: f64, period: f64) -> f64 {
        let brakes = self.settings.turn_acceleration_rps2 * RESERVE;
        let limit = stopping_speed(error.abs(), brakes, period).min(self.settings.turn_rate_rps);
        self.heading.output(error, period, limit)
    }

    fn set(&mut self, speed: f64, turn: f64, period: f64) {
        let limit = self.settings.acceleration_mps2;
        self.speed_mps = match self.set_target {
            Target::Point(_) => {
                let faster = self.speed.output(speed - self.speed_mps, period, limit) * period;
                (self.speed_mps + faster).clamp(-self.max_mps, self.max_mps)
            }
            Target::Rest | Target::Heading(_) => step_toward_scalar(self.speed_mps, speed, limit * period),
        };
        self.turn_rps = step_toward_scalar(self.turn_rps, turn, self.settings.turn_acceleration_rps2 * period);
    }

    /// Integrates the motion over `dt_s` seconds at constant speeds.
    pub(super) fn integrate(&mut self, dt_s: f64) {
        if self.speed_mps != 0.0 || self.turn_rps != 0.0 {
            self.pose = drive_arc(&self.pose, self.speed_mps, self.turn_rps, dt_s);
        }
    }
}
