//! An Ackermann-steered vehicle. It drives forward or in reverse, never turns tighter than its
//! minimum turning radius, and follows the shortest such path.

use super::dubins::DubinsPath;
use super::motion_math::{drive_arc, step_toward_scalar, stopping_speed};
use super::settings::AckermannSettings;
use nalgebra::{Isometry2, UnitComplex};
use std::f64::consts::PI;

/// Position tolerance for arrival, in metres. The vehicle must also be almost at a standstill.
const REACHED_M: f64 = 0.001;

/// A chassis with steered wheels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Ackermann {
    settings: AckermannSettings,
    pub(super) max_mps: f64,
    pose: Isometry2<f64>,
    speed_mps: f64,
    /// The path being driven, with the distance covered, and whether the vehicle drives it to its
    /// end or only brakes on it.
    path_progress: Option<PathProgress>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct PathProgress {
    path: DubinsPath,
    length_m: f64,
    along_m: f64,
    drive_to_end: bool,
    /// True for reverse driving: the path is then that of the vehicle's rear.
    backward: bool,
}

/// Returns the pose rotated by half a turn.
fn reversed(pose: Isometry2<f64>) -> Isometry2<f64> {
    pose * UnitComplex::new(PI)
}

impl Ackermann {
    /// Creates a chassis at standstill.
    pub(crate) fn new(settings: AckermannSettings, max_mps: f64, pose: Isometry2<f64>) -> Ackermann {
        Ackermann { settings, max_mps, pose, speed_mps: 0.0, path_progress: None }
    }

    /// Current pose.
    pub(crate) fn pose(&self) -> &Isometry2<f64> {
        &self.pose
    }

    /// Current speed in metres per second, forward or in reverse; never negative.
    #[cfg(test)]
    pub(crate) fn speed_mps(&self) -> f64 {
        self.speed_mps
    }

    /// Distance left along the path, in metres.
    pub(crate) fn remaining_m(&self) -> f64 {
        self.path_progress
            .filter(|path_progress| path_progress.drive_to_end)
            .map_or(0.0, |path_progress| (path_progress.length_m - path_progress.along_m).max(0.0))
    }

    pub(super) fn set_target(&mut self, target: Option<Isometry2<f64>>) {
        match target {
            Some(target) => {
                let path = DubinsPath::shortest(self.pose, target, self.settings.turning_radius_m);
                self.path_progress = Some(PathProgress {
                    path,
                    length_m: path.length_m(),
                    along_m: 0.0,
                    drive_to_end: true,
                    backward: false,
                });
            }
            None => {
                if let Some(path_progress) = &mut self.path_progress {
                    path_progress.drive_to_end = false;
                }
            }
        }
    }

    pub(super) fn set_target_backward(&mut self, target: Isometry2<f64>) {
        let path = DubinsPath::shortest(reversed(self.pose), reversed(target), self.settings.turning_radius_m);
        self.path_progress =
            Some(PathProgress { path, length_m: path.length_m(), along_m: 0.0, drive_to_end: true, backward: true });
    }

    pub(super) fn set_heading(&mut self, yaw: f64) {
        self.pose.rotation = UnitComplex::new(yaw);
    }

    pub(super) fn stop_immediately(&mut self) {
        (self.path_progress, self.speed_mps) = (None, 0.0);
    }

    pub(super) fn is_moving(&self) -> bool {
        self.path_progress.is_some()
    }

    /// Runs one control cycle: sets the speed for the next period. Returns true when the vehicle
    /// has just arrived.
    pub(super) fn control_step(&mut self, period: f64) -> bool {
        let Some(path_progress) = self.path_progress else { return false };
        let (limit, left) = (self.settings.acceleration_mps2, path_progress.length_m - path_progress.along_m);
        let is_stopped = self.speed_mps <= limit * period;
        if is_stopped && (left <= REACHED_M || !path_progress.drive_to_end) {
            self.stop_immediately();
            return path_progress.drive_to_end;
        }
        let wanted =
            if path_progress.drive_to_end { stopping_speed(left, limit, period).min(self.max_mps) } else { 0.0 };
        self.speed_mps = step_toward_scalar(self.speed_mps, wanted, limit * period);
        false
    }

    /// Integrates the motion over `dt_s` seconds at constant speed. If the target is closer than
    /// the braking distance, the vehicle overshoots the end of the path straight ahead.
    pub(super) fn integrate(&mut self, dt_s: f64) {
        if let Some(path_progress) = &mut self.path_progress {
            path_progress.along_m += self.speed_mps * dt_s;
            let beyond = (path_progress.along_m - path_progress.length_m).max(0.0);
            let front = drive_arc(&path_progress.path.pose_at(path_progress.along_m), beyond, 0.0, 1.0);
            self.pose = if path_progress.backward { reversed(front) } else { front };
        }
    }
}
