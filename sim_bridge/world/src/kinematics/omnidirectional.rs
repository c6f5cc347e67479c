//! A chassis with omnidirectional wheels. It drives straight to its target and turns at the same
//! time.

use super::motion_math::{next_turn_rate, step_toward, stopping_speed, wrap_angle};
use super::settings::OmnidirectionalSettings;
use nalgebra::{Isometry2, UnitComplex, Vector2};

/// Position tolerance for arrival, in metres. The chassis must also be almost at a standstill.
const REACHED_M: f64 = 0.001;
const REACHED_RAD: f64 = 0.001;

/// An omnidirectional chassis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Omnidirectional {
    settings: OmnidirectionalSettings,
    pub(super) max_mps: f64,
    pose: Isometry2<f64>,
    velocity: Vector2<f64>,
    turn_rps: f64,
    target: Option<Isometry2<f64>>,
}

impl Omnidirectional {
    /// Creates a chassis at standstill.
    pub(crate) fn new(settings: OmnidirectionalSettings, max_mps: f64, pose: Isometry2<f64>) -> Omnidirectional {
        Omnidirectional { settings, max_mps, pose, velocity: Vector2::zeros(), turn_rps: 0.0, target: None }
    }

    /// Current pose.
    pub(crate) fn pose(&self) -> &Isometry2<f64> {
        &self.pose
    }

    /// Velocity over the floor (metres per second) and turn rate (radians per second, positive to
    /// the left).
    #[cfg(test)]
    pub(crate) fn velocity(&self) -> (Vector2<f64>, f64) {
        (self.velocity, self.turn_rps)
    }

    /// Distance to the target in metres.
    pub(crate) fn remaining_m(&self) -> f64 {
        self.target.map_or(0.0, |target| (target.translation.vector - self.pose.translation.vector).norm())
    }

    pub(super) fn set_target(&mut self, target: Option<Isometry2<f64>>) {
        self.target = target;
    }

    pub(super) fn set_heading(&mut self, yaw: f64) {
        self.pose.rotation = UnitComplex::new(yaw);
    }

    pub(super) fn stop_immediately(&mut self) {
        (self.target, self.velocity, self.turn_rps) = (None, Vector2::zeros(), 0.0);
    }

    pub(super) fn is_moving(&self) -> bool {
        self.target.is_some() || self.velocity != Vector2::zeros() || self.turn_rps != 0.0
    }

    /// Runs one control cycle: sets the speeds for the next period. Returns true when the chassis
    /// has just arrived.
    pub(super) fn control_step(&mut self, period: f64) -> bool {
        let OmnidirectionalSettings { acceleration_mps2, turn_rate_rps, turn_acceleration_rps2, .. } = self.settings;
        let (notch, turn_notch) = (acceleration_mps2 * period, turn_acceleration_rps2 * period);
        let (to, error) = match self.target {
            Some(target) => {
                let to = target.translation.vector - self.pose.translation.vector;
                (to, wrap_angle(target.rotation.angle() - self.pose.rotation.angle()))
            }
            None => (Vector2::zeros(), 0.0),
        };
        let distance = to.norm();
        let stands = self.velocity.norm() <= notch && self.turn_rps.abs() <= turn_notch;
        if self.target.is_some() && distance <= REACHED_M && error.abs() <= REACHED_RAD && stands {
            self.stop_immediately();
            return true;
        }
        let speed = stopping_speed(distance, acceleration_mps2, period).min(self.max_mps);
        let wanted = if distance > 0.0 { to * (speed / distance) } else { Vector2::zeros() };
        self.velocity = step_toward(self.velocity, wanted, notch);
        self.turn_rps = next_turn_rate(self.turn_rps, error, turn_rate_rps, turn_acceleration_rps2, period);
        false
    }

    /// Integrates the motion over `dt_s` seconds at constant speeds.
    pub(super) fn integrate(&mut self, dt_s: f64) {
        self.pose.translation.vector += self.velocity * dt_s;
        if self.turn_rps != 0.0 {
            self.pose.rotation *= UnitComplex::new(self.turn_rps * dt_s);
        }
    }
}
