//! A drone: it flies straight to where it is to be, climbs and sinks at its own rate, makes way for others, and holds its
//! place in the air against whatever pushes it. Where others hold it up it flies over them, and comes down over its place.

use super::avoidance::{AvoidanceLimits, Neighbour, avoid_neighbours};
use super::motion_math::{next_turn_rate, step_toward, step_toward_scalar, stopping_speed, wrap_angle};
use super::settings::AerialSettings;
use nalgebra::{Isometry2, Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};

/// It has arrived when it is this close and as good as stands.
const REACHED_M: f64 = 0.02;
const REACHED_RAD: f64 = 0.02;
/// It is held up when for so long it has flown slower than this part of what it wanted.
const PATIENCE_S: f64 = 0.5;
const HELD_UP: f64 = 0.25;
/// How far above its height it flies at most to get over others.
const OVER_M: f64 = 4.0;
/// It comes down when it is so close to being above its place.
const ABOVE_M: f64 = 0.05;
/// Closer to the point that it holds than this, and slower, it lets itself be: a hair of thrust is not worth the sums.
const AT_REST_M: f64 = 1e-6;

/// A body in the air.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aerial {
    settings: AerialSettings,
    pub(super) top_mps: f64,
    radius_m: f64,
    position: Vector3<f64>,
    velocity: Vector3<f64>,
    yaw: f64,
    turn_rps: f64,
    /// Where it is to be, with its yaw; it holds it once it is there. None on the ground.
    hold: Option<(Vector3<f64>, f64)>,
    arrived: bool,
    /// How long others have held it up.
    held_up_s: f64,
    /// How much higher than its height it flies to get over them.
    over_m: f64,
}

impl Aerial {
    /// A body that stands on the floor, and is `radius_m` metres from its middle to its outermost part.
    pub fn new(settings: AerialSettings, top_mps: f64, radius_m: f64, pose: &Isometry2<f64>) -> Aerial {
        let (at, yaw) = (pose.translation.vector, pose.rotation.angle());
        Aerial {
            settings,
            top_mps,
            radius_m,
            position: Vector3::new(at.x, at.y, 0.0),
            velocity: Vector3::zeros(),
            yaw,
            turn_rps: 0.0,
            hold: None,
            arrived: true,
            held_up_s: 0.0,
            over_m: 0.0,
        }
    }

    /// Where it is in space.
    pub fn pose(&self) -> Isometry3<f64> {
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.yaw);
        Isometry3::from_parts(Translation3::from(self.position), yaw)
    }

    /// The same, seen from above.
    pub fn pose_above(&self) -> Isometry2<f64> {
        Isometry2::new(self.position.xy(), self.yaw)
    }

    /// Where its middle is.
    pub fn position(&self) -> &Vector3<f64> {
        &self.position
    }

    /// How it moves, in metres per second.
    pub fn velocity(&self) -> &Vector3<f64> {
        &self.velocity
    }

    /// How far it is to its target, in metres.
    pub fn remaining_m(&self) -> f64 {
        self.hold.filter(|_| !self.arrived).map_or(0.0, |(target, _)| (target - self.position).norm())
    }

    /// Whether it holds a place in the air that it has reached.
    pub fn is_holding(&self) -> bool {
        self.arrived && self.hold.is_some()
    }

    /// Something pushes it: its velocity changes at once. On the ground, where nothing would bring it back, it stays.
    pub fn push(&mut self, by: Vector3<f64>) {
        if self.hold.is_some() {
            self.velocity += by;
        }
    }

    /// How far around itself, from middle to middle, it has to look for others of a size of at most `radius_m`: as far as
    /// matters until its next decision.
    pub fn looks_m(&self, radius_m: f64) -> f64 {
        let AerialSettings { acceleration_mps2, climb_acceleration_mps2, climb_mps, control_period_s, .. } =
            self.settings;
        let (now, notch) = (self.velocity.norm(), acceleration_mps2.hypot(climb_acceleration_mps2) * control_period_s);
        let speed = (now + notch).min(self.top_mps.hypot(climb_mps).max(now));
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

    pub(super) fn aim(&mut self, target: Option<Isometry2<f64>>) {
        self.hold = Some(match target {
            Some(target) => {
                let at = target.translation.vector;
                (Vector3::new(at.x, at.y, self.settings.height_m), target.rotation.angle())
            }
            None => (self.stopping_point(), self.yaw),
        });
        self.arrived = target.is_none();
        (self.held_up_s, self.over_m) = (0.0, 0.0);
    }

    /// Where it comes to hover if it brakes now.
    fn stopping_point(&self) -> Vector3<f64> {
        let (level, climb) = (self.velocity.xy(), self.velocity.z);
        let level_m = level * (level.norm() / (2.0 * self.settings.acceleration_mps2));
        let climb_m = climb * climb.abs() / (2.0 * self.settings.climb_acceleration_mps2);
        self.position + Vector3::new(level_m.x, level_m.y, climb_m)
    }

    pub(super) fn turn_to(&mut self, yaw: f64) {
        self.yaw = wrap_angle(yaw);
        self.hold = self.hold.map(|(at, _)| (at, self.yaw));
    }

    pub(super) fn stop_dead(&mut self) {
        (self.velocity, self.turn_rps) = (Vector3::zeros(), 0.0);
        (self.hold, self.arrived) = (Some((self.position, self.yaw)), true);
    }

    pub(super) fn is_moving(&self) -> bool {
        !self.arrived || self.velocity != Vector3::zeros() || self.turn_rps != 0.0
    }

    /// One turn of the control loop: sets the speeds for the next period. True when it has just arrived.
    pub(super) fn decide(&mut self, period: f64, around: &[Neighbour]) -> bool {
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
        let over = to + Vector3::new(0.0, 0.0, self.over_m);
        let wanted = self.wanted(over, period);
        self.get_over(to.xy().norm(), wanted.xy().norm(), period);
        let wanted = self.within_limits(wanted, period);
        self.velocity =
            avoid_neighbours(wanted, self.velocity, self.agility(), around, |v| self.within_limits(v, period));
        let AerialSettings { turn_rate_rps, turn_acceleration_rps2, .. } = self.settings;
        self.turn_rps = next_turn_rate(self.turn_rps, error, turn_rate_rps, turn_acceleration_rps2, period);
        just_arrived
    }

    /// Decides how high to fly: higher while it is held up on its way, and no higher once it is above its place.
    fn get_over(&mut self, distance_m: f64, wanted_mps: f64, period: f64) {
        if self.arrived || distance_m < ABOVE_M {
            (self.held_up_s, self.over_m) = (0.0, 0.0);
        } else if self.velocity.xy().norm() >= HELD_UP * wanted_mps {
            self.held_up_s = 0.0;
        } else {
            self.held_up_s += period;
            if self.held_up_s > PATIENCE_S {
                self.over_m = (self.over_m + self.settings.climb_mps * period).min(OVER_M);
            }
        }
    }

    /// The velocity that brings it there soonest, were it not for what it has now.
    fn wanted(&self, to: Vector3<f64>, period: f64) -> Vector3<f64> {
        let (level, distance) = (to.xy(), to.xy().norm());
        let speed = stopping_speed(distance, self.settings.acceleration_mps2, period).min(self.top_mps);
        let level = if distance > 0.0 { level * (speed / distance) } else { Vector2::zeros() };
        let climb = stopping_speed(to.z.abs(), self.settings.climb_acceleration_mps2, period)
            .min(self.settings.climb_mps)
            .copysign(to.z);
        Vector3::new(level.x, level.y, climb)
    }

    /// The closest to a velocity that it can have after one period.
    fn within_limits(&self, wanted: Vector3<f64>, period: f64) -> Vector3<f64> {
        let level = step_toward(self.velocity.xy(), wanted.xy(), self.settings.acceleration_mps2 * period);
        let climb = step_toward_scalar(self.velocity.z, wanted.z, self.settings.climb_acceleration_mps2 * period);
        Vector3::new(level.x, level.y, climb)
    }

    /// Lets time pass with the speeds as they are.
    pub(super) fn coast(&mut self, dt_s: f64) {
        self.position += self.velocity * dt_s;
        if self.turn_rps != 0.0 {
            self.yaw = wrap_angle(self.yaw + self.turn_rps * dt_s);
        }
    }
}
