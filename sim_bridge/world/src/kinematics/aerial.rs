//! A drone. It flies straight to its target, climbs and sinks at its own rate, gives way to other
//! bodies, and holds its position against gusts. If other bodies hold it up, it flies over them and
//! descends above its target.

use super::avoidance::{AvoidanceLimits, Neighbour, avoid_neighbours};
use super::motion_math::{next_turn_rate, step_toward, step_toward_scalar, stopping_speed, wrap_angle};
use super::settings::AerialSettings;
use nalgebra::{Isometry2, Vector2, Vector3};

/// Position tolerance for arrival, in metres. The drone must also be almost at a standstill.
const REACHED_M: f64 = 0.02;
const REACHED_RAD: f64 = 0.02;
/// The drone counts as held up after flying below the fraction `HELD_UP` of its desired speed for
/// this many seconds.
const HELD_UP_TIME_S: f64 = 0.5;
const HELD_UP_FRACTION: f64 = 0.25;
/// Greatest extra height for flying over other bodies, in metres.
const EXTRA_HEIGHT_MAX_M: f64 = 4.0;
/// Horizontal distance to the target below which the drone descends, in metres.
const ABOVE_M: f64 = 0.05;
/// If the drone is closer than this to its hold point, and slower, it applies no thrust: a
/// correction that small is not worth its computation.
const AT_REST_M: f64 = 1e-6;

/// An aerial robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Aerial {
    settings: AerialSettings,
    pub(super) max_mps: f64,
    radius_m: f64,
    /// Greatest change of velocity in a control cycle, in metres per second.
    change_mps: f64,
    position: Vector3<f64>,
    velocity: Vector3<f64>,
    yaw: f64,
    turn_rps: f64,
    /// Target position and yaw. The drone holds them after arrival. `None` on the ground.
    hold: Option<(Vector3<f64>, f64)>,
    arrived: bool,
    /// Time for which other bodies have held the drone up.
    held_up_s: f64,
    /// Extra height for flying over other bodies.
    extra_height_m: f64,
}

impl Aerial {
    /// Creates a drone that stands on the floor. `radius_m` is the distance from its centre to its
    /// outermost part, in metres.
    pub(crate) fn new(settings: AerialSettings, max_mps: f64, radius_m: f64, pose: &Isometry2<f64>) -> Aerial {
        let (at, yaw) = (pose.translation.vector, pose.rotation.angle());
        let acceleration = settings.acceleration_mps2.hypot(settings.climb_acceleration_mps2);
        Aerial {
            settings,
            max_mps,
            radius_m,
            change_mps: acceleration * settings.control_period_s,
            position: Vector3::new(at.x, at.y, 0.0),
            velocity: Vector3::zeros(),
            yaw,
            turn_rps: 0.0,
            hold: None,
            arrived: true,
            held_up_s: 0.0,
            extra_height_m: 0.0,
        }
    }

    /// Current pose, projected onto the floor.
    pub(crate) fn pose_above(&self) -> Isometry2<f64> {
        Isometry2::new(self.position.xy(), self.yaw)
    }

    /// Position of the centre.
    pub(crate) fn position(&self) -> &Vector3<f64> {
        &self.position
    }

    /// Current velocity in metres per second.
    #[cfg(test)]
    pub(crate) fn velocity(&self) -> &Vector3<f64> {
        &self.velocity
    }

    /// Distance to the target in metres.
    pub(crate) fn remaining_m(&self) -> f64 {
        self.hold.filter(|_| !self.arrived).map_or(0.0, |(target, _)| (target - self.position).norm())
    }

    /// Checks whether the drone holds a position in the air that it has reached.
    pub(crate) fn is_holding(&self) -> bool {
        self.arrived && self.hold.is_some()
    }

    /// Applies a push: the velocity changes at once. A drone on the ground does not move, since no
    /// controller would bring it back.
    pub(crate) fn push(&mut self, by: Vector3<f64>) {
        if self.hold.is_some() {
            self.velocity += by;
        }
    }

    /// Returns the distance, from centre to centre, within which the drone must consider other
    /// bodies with a radius of at most `radius_m`. Bodies beyond it do not matter until the next
    /// control cycle.
    pub(crate) fn neighbour_range_m(&self, radius_m: f64) -> f64 {
        let (now, climb_mps) = (self.velocity.norm(), self.settings.climb_mps);
        let mut speed = now + self.change_mps;
        // A slow drone, as most are, stays below the top speed in any direction.
        if speed > self.max_mps.max(climb_mps) {
            speed = speed.min(self.max_mps.hypot(climb_mps).max(now));
        }
        let stops_m = self.agility().stopping_distance(speed);
        2.0 * stops_m + self.radius_m + radius_m + self.settings.margin_m
    }

    fn agility(&self) -> AvoidanceLimits {
        AvoidanceLimits {
            acceleration_mps2: self.settings.acceleration_mps2.min(self.settings.climb_acceleration_mps2),
            period_s: self.settings.control_period_s,
            radius_m: self.radius_m,
            margin_m: self.settings.margin_m,
        }
    }

    pub(super) fn set_target(&mut self, target: Option<Isometry2<f64>>) {
        self.hold = Some(match target {
            Some(target) => {
                let at = target.translation.vector;
                (Vector3::new(at.x, at.y, self.settings.height_m), target.rotation.angle())
            }
            None => (self.stopping_point(), self.yaw),
        });
        self.arrived = target.is_none();
        (self.held_up_s, self.extra_height_m) = (0.0, 0.0);
    }

    /// Returns the point at which the drone hovers if it brakes now.
    fn stopping_point(&self) -> Vector3<f64> {
        let (level, climb) = (self.velocity.xy(), self.velocity.z);
        let level_m = level * (level.norm() / (2.0 * self.settings.acceleration_mps2));
        let climb_m = climb * climb.abs() / (2.0 * self.settings.climb_acceleration_mps2);
        self.position + Vector3::new(level_m.x, level_m.y, climb_m)
    }

    pub(super) fn set_heading(&mut self, yaw: f64) {
        self.yaw = wrap_angle(yaw);
        self.hold = self.hold.map(|(at, _)| (at, self.yaw));
    }

    pub(super) fn stop_immediately(&mut self) {
        (self.velocity, self.turn_rps) = (Vector3::zeros(), 0.0);
        (self.hold, self.arrived) = (Some((self.position, self.yaw)), true);
    }

    pub(super) fn is_moving(&self) -> bool {
        !self.arrived || self.velocity != Vector3::zeros() || self.turn_rps != 0.0
    }

    /// Runs one control cycle: sets the speeds for the next period. Returns true when the drone has
    /// just arrived.
    pub(super) fn control_step(&mut self, period: f64, around: &[Neighbour]) -> bool {
        let Some((target, yaw)) = self.hold else { return false };
        let (to, error) = (target - self.position, wrap_angle(yaw - self.yaw));
        let (distance, speed) = (to.norm(), self.velocity.norm());
        if self.arrived && distance <= AT_REST_M && speed <= AT_REST_M && around.is_empty() {
            (self.velocity, self.turn_rps) = (Vector3::zeros(), 0.0);
            return false;
        }
        let just_arrived = !self.arrived
            && distance <= REACHED_M
            && error.abs() <= REACHED_RAD
            && speed <= self.settings.acceleration_mps2 * period;
        self.arrived |= just_arrived;
        let target_offset = to + Vector3::new(0.0, 0.0, self.extra_height_m);
        let desired_velocity = self.desired_velocity(target_offset, period);
        self.update_extra_height(to.xy().norm(), desired_velocity.xy().norm(), period);
        let desired_velocity = self.within_limits(desired_velocity, period);
        self.velocity = avoid_neighbours(desired_velocity, self.velocity, self.agility(), around, |v| {
            self.within_limits(v, period)
        });
        let AerialSettings { turn_rate_rps, turn_acceleration_rps2, .. } = self.settings;
        self.turn_rps = next_turn_rate(self.turn_rps, error, turn_rate_rps, turn_acceleration_rps2, period);
        just_arrived
    }

    /// Sets the extra height: it grows while the drone is held up on its way, and is 0 above the
    /// target.
    fn update_extra_height(&mut self, distance_m: f64, wanted_mps: f64, period: f64) {
        if self.arrived || distance_m < ABOVE_M {
            (self.held_up_s, self.extra_height_m) = (0.0, 0.0);
        } else if self.velocity.xy().norm() >= HELD_UP_FRACTION * wanted_mps {
            self.held_up_s = 0.0;
        } else {
            self.held_up_s += period;
            if self.held_up_s > HELD_UP_TIME_S {
                self.extra_height_m = (self.extra_height_m + self.settings.climb_mps * period).min(EXTRA_HEIGHT_MAX_M);
            }
        }
    }

    /// Returns the velocity that would reach the target soonest, regardless of the current
    /// velocity.
    fn desired_velocity(&self, to: Vector3<f64>, period: f64) -> Vector3<f64> {
        let (level, distance) = (to.xy(), to.xy().norm());
        let speed = stopping_speed(distance, self.settings.acceleration_mps2, period).min(self.max_mps);
        let level = if distance > 0.0 { level * (speed / distance) } else { Vector2::zeros() };
        let climb = stopping_speed(to.z.abs(), self.settings.climb_acceleration_mps2, period)
            .min(self.settings.climb_mps)
            .copysign(to.z);
        Vector3::new(level.x, level.y, climb)
    }

    /// Returns the velocity closest to `desired_velocity` that the drone can reach within a period.
    fn within_limits(&self, desired_velocity: Vector3<f64>, period: f64) -> Vector3<f64> {
        let level = step_toward(self.velocity.xy(), desired_velocity.xy(), self.settings.acceleration_mps2 * period);
        let climb =
            step_toward_scalar(self.velocity.z, desired_velocity.z, self.settings.climb_acceleration_mps2 * period);
        Vector3::new(level.x, level.y, climb)
    }

    /// Integrates the motion over `dt_s` seconds at constant speeds.
    pub(super) fn integrate(&mut self, dt_s: f64) {
        self.position += self.velocity * dt_s;
        if self.turn_rps != 0.0 {
            self.yaw = wrap_angle(self.yaw + self.turn_rps * dt_s);
        }
    }
}
