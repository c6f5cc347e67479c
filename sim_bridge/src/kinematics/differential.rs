//! Two driven wheels, after thesis Figure 5.2: one PID controller steers the heading, another the speed.

use super::motion_math::{bearing, drive_arc, step_toward_scalar, stopping_speed, wrap_angle};
use super::pid::Pid;
use super::settings::DifferentialSettings;
use nalgebra::{Isometry2, UnitComplex};
use std::f64::consts::PI;

/// It has reached a point when it is this close: what a wheel slips.
const REACHED_M: f64 = 0.02;
/// It has reached a heading when it is this close.
const REACHED_RAD: f64 = 0.01;
/// Slower than this it may go over from driving to turning.
const STILL_MPS: f64 = 0.02;
/// It drives ahead only while its target is within this angle ahead; otherwise it first turns on the spot.
const AHEAD_RAD: f64 = 0.5;
/// The part of its acceleration that it plans to brake with: the rest is for the controller to make up for its lag.
const RESERVE: f64 = 0.7;

/// A differential drive and its controllers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Differential {
    settings: DifferentialSettings,
    pub(super) top_mps: f64,
    pose: Isometry2<f64>,
    speed_mps: f64,
    turn_rps: f64,
    heading: Pid,
    speed: Pid,
    aim: Aim,
    /// Whether its back is in front.
    backward: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Aim {
    /// To stand.
    Rest,
    /// To be at the point of the pose.
    Point(Isometry2<f64>),
    /// At the point: to look where the pose looks.
    Heading(f64),
}

impl Differential {
    /// A body that stands.
    pub fn new(settings: DifferentialSettings, top_mps: f64, pose: Isometry2<f64>) -> Differential {
        let (heading, speed) = (Pid::new(settings.heading), Pid::new(settings.speed));
        Differential {
            settings,
            top_mps,
            pose,
            speed_mps: 0.0,
            turn_rps: 0.0,
            heading,
            speed,
            aim: Aim::Rest,
            backward: false,
        }
    }

    /// Where it is.
    pub fn pose(&self) -> &Isometry2<f64> {
        &self.pose
    }

    /// How fast it drives ahead (metres per second) and turns to the left (radians per second).
    pub fn speeds(&self) -> (f64, f64) {
        (self.speed_mps, self.turn_rps)
    }

    /// How far it is to its target as the crow flies, in metres.
    pub fn remaining_m(&self) -> f64 {
        match self.aim {
            Aim::Point(target) => (target.translation.vector - self.pose.translation.vector).norm(),
            Aim::Rest | Aim::Heading(_) => 0.0,
        }
    }

    pub(super) fn aim(&mut self, target: Option<Isometry2<f64>>) {
        self.aim = target.map_or(Aim::Rest, Aim::Point);
        self.backward = false;
        self.heading.reset();
        self.speed.reset();
    }

    pub(super) fn back(&mut self, target: Isometry2<f64>) {
        self.aim(Some(target));
        self.backward = true;
    }

    pub(super) fn turn_to(&mut self, yaw: f64) {
        self.pose.rotation = UnitComplex::new(yaw);
    }

    pub(super) fn stop_dead(&mut self) {
        self.aim(None);
        (self.speed_mps, self.turn_rps) = (0.0, 0.0);
    }

    pub(super) fn is_moving(&self) -> bool {
        self.aim != Aim::Rest || self.speed_mps != 0.0 || self.turn_rps != 0.0
    }

    /// One turn of the control loop: sets the speeds for the next period. True when it has just arrived.
    pub(super) fn decide(&mut self, period: f64) -> bool {
        let yaw = self.pose.rotation.angle();
        if let Aim::Point(target) = self.aim
            && self.remaining_m() <= REACHED_M
            && self.speed_mps.abs() <= STILL_MPS
        {
            self.aim = Aim::Heading(target.rotation.angle());
            self.heading.reset();
        }
        match self.aim {
            Aim::Rest => self.set(0.0, 0.0, period),
            Aim::Point(target) => {
                let to = target.translation.vector - self.pose.translation.vector;
                let (front, ahead) = if self.backward { (yaw + PI, -1.0) } else { (yaw, 1.0) };
                let error = wrap_angle(bearing(to) - front);
                let brakes = self.settings.acceleration_mps2 * RESERVE;
                let speed = if error.abs() < AHEAD_RAD {
                    // Where it is close, slower than brakes would allow, so that the lag of the controller is no matter.
                    stopping_speed(to.norm(), brakes, period).min(2.0 * to.norm()).min(self.top_mps) * error.cos()
                } else {
                    0.0
                };
                let turn = self.turn(error, period);
                self.set(ahead * speed, turn, period);
            }
            Aim::Heading(wanted) => {
                let error = wrap_angle(wanted - yaw);
                if error.abs() <= REACHED_RAD
                    && self.turn_rps.abs() <= self.settings.turn_acceleration_rps2 * period
                    && self.speed_mps == 0.0
                {
                    self.stop_dead();
                    return true;
                }
                let turn = self.turn(error, period);
                self.set(0.0, turn, period);
            }
        }
        false
    }

    /// The turn rate to have for an error of heading: never more than it can brake.
    fn turn(&mut self, error: f64, period: f64) -> f64 {
        let brakes = self.settings.turn_acceleration_rps2 * RESERVE;
        let limit = stopping_speed(error.abs(), brakes, period).min(self.settings.turn_rate_rps);
        self.heading.output(error, period, limit)
    }

    fn set(&mut self, speed: f64, turn: f64, period: f64) {
        let limit = self.settings.acceleration_mps2;
        self.speed_mps = match self.aim {
            Aim::Point(_) => {
                let faster = self.speed.output(speed - self.speed_mps, period, limit) * period;
                (self.speed_mps + faster).clamp(-self.top_mps, self.top_mps)
            }
            Aim::Rest | Aim::Heading(_) => step_toward_scalar(self.speed_mps, speed, limit * period),
        };
        self.turn_rps = step_toward_scalar(self.turn_rps, turn, self.settings.turn_acceleration_rps2 * period);
    }

    /// Lets time pass with the speeds as they are.
    pub(super) fn coast(&mut self, dt_s: f64) {
        if self.speed_mps != 0.0 || self.turn_rps != 0.0 {
            self.pose = drive_arc(&self.pose, self.speed_mps, self.turn_rps, dt_s);
        }
    }
}
