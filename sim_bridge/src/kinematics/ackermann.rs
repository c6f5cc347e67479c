//! A car: it drives ahead or backs, never turns tighter than its wheels allow, and follows the shortest such way.

use super::dubins::DubinsPath;
use super::motion_math::{drive_arc, step_toward_scalar, stopping_speed};
use super::settings::AckermannSettings;
use nalgebra::{Isometry2, UnitComplex};
use std::f64::consts::PI;

/// It has arrived when it is this close and as good as stands.
const REACHED_M: f64 = 0.001;

/// A chassis with steered wheels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ackermann {
    settings: AckermannSettings,
    pub(super) top_mps: f64,
    pose: Isometry2<f64>,
    speed_mps: f64,
    /// The way it is on: how far along, and whether to the end of it or only until it stands.
    way: Option<Way>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Way {
    path: DubinsPath,
    length_m: f64,
    along_m: f64,
    to_the_end: bool,
    /// Whether its back is in front: the path is then that of its back.
    backward: bool,
}

/// What looks the other way.
fn turned(pose: Isometry2<f64>) -> Isometry2<f64> {
    pose * UnitComplex::new(PI)
}

impl Ackermann {
    /// A body that stands.
    pub fn new(settings: AckermannSettings, top_mps: f64, pose: Isometry2<f64>) -> Ackermann {
        Ackermann { settings, top_mps, pose, speed_mps: 0.0, way: None }
    }

    /// Where it is.
    pub fn pose(&self) -> &Isometry2<f64> {
        &self.pose
    }

    /// How fast it drives, be it ahead or back, in metres per second; never negative.
    pub fn speed_mps(&self) -> f64 {
        self.speed_mps
    }

    /// How far it still has to drive, in metres along its way.
    pub fn remaining_m(&self) -> f64 {
        self.way.filter(|way| way.to_the_end).map_or(0.0, |way| (way.length_m - way.along_m).max(0.0))
    }

    pub(super) fn aim(&mut self, target: Option<Isometry2<f64>>) {
        match target {
            Some(target) => {
                let path = DubinsPath::shortest(self.pose, target, self.settings.turning_radius_m);
                self.way =
                    Some(Way { path, length_m: path.length_m(), along_m: 0.0, to_the_end: true, backward: false });
            }
            None => {
                if let Some(way) = &mut self.way {
                    way.to_the_end = false;
                }
            }
        }
    }

    pub(super) fn back(&mut self, target: Isometry2<f64>) {
        let path = DubinsPath::shortest(turned(self.pose), turned(target), self.settings.turning_radius_m);
        self.way = Some(Way { path, length_m: path.length_m(), along_m: 0.0, to_the_end: true, backward: true });
    }

    pub(super) fn turn_to(&mut self, yaw: f64) {
        self.pose.rotation = UnitComplex::new(yaw);
    }

    pub(super) fn stop_dead(&mut self) {
        (self.way, self.speed_mps) = (None, 0.0);
    }

    pub(super) fn is_moving(&self) -> bool {
        self.way.is_some()
    }

    /// One turn of the control loop: sets the speed for the next period. True when it has just arrived.
    pub(super) fn decide(&mut self, period: f64) -> bool {
        let Some(way) = self.way else { return false };
        let (limit, left) = (self.settings.acceleration_mps2, way.length_m - way.along_m);
        let stands = self.speed_mps <= limit * period;
        if stands && (left <= REACHED_M || !way.to_the_end) {
            self.stop_dead();
            return way.to_the_end;
        }
        let wanted = if way.to_the_end { stopping_speed(left, limit, period).min(self.top_mps) } else { 0.0 };
        self.speed_mps = step_toward_scalar(self.speed_mps, wanted, limit * period);
        false
    }

    /// Lets time pass with the speed as it is. What is driven beyond the end of the way, by a body that was told to go
    /// less far than it needs to brake, is driven straight ahead.
    pub(super) fn coast(&mut self, dt_s: f64) {
        if let Some(way) = &mut self.way {
            way.along_m += self.speed_mps * dt_s;
            let beyond = (way.along_m - way.length_m).max(0.0);
            let front = drive_arc(&way.path.pose_at(way.along_m), beyond, 0.0, 1.0);
            self.pose = if way.backward { turned(front) } else { front };
        }
    }
}
