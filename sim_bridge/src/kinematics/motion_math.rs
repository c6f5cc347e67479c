//! The arithmetic that models share: coming to a stop at a point, changing speed within limits, turning.

use nalgebra::{Isometry2, SVector, Translation2, UnitComplex, Vector2};

/// Two instants of one clock closer than this, in seconds, are one instant.
pub(crate) const TIME_EPSILON_S: f64 = 1e-9;

/// The fastest speed to hold for one period from which braking by `acceleration * period` a period comes to a stop at
/// `distance` exactly, after a whole number of periods.
pub(crate) fn stopping_speed(distance: f64, acceleration: f64, period: f64) -> f64 {
    if distance <= 0.0 {
        return 0.0;
    }
    let notch = acceleration * period;
    // In n periods, each by one notch slower, it comes `notch * period * n (n + 1) / 2` far.
    let periods = ((0.25 + 2.0 * distance / (notch * period)).sqrt() - 0.5).ceil().max(1.0);
    distance / (periods * period) + notch * (periods - 1.0) / 2.0
}

/// A velocity as close to the one wanted as a change of at most `change` allows.
pub(crate) fn step_toward<const D: usize>(
    now: SVector<f64, D>,
    wanted: SVector<f64, D>,
    change: f64,
) -> SVector<f64, D> {
    let (step, length_2) = (wanted - now, (wanted - now).norm_squared());
    if length_2 <= change * change { wanted } else { now + step * (change / length_2.sqrt()) }
}

/// The same in one dimension.
pub(crate) fn step_toward_scalar(now: f64, wanted: f64, change: f64) -> f64 {
    now + (wanted - now).clamp(-change, change)
}

/// An angle as one from -π to π.
pub(crate) fn wrap_angle(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    if angle.abs() <= PI { angle } else { angle - TAU * (angle / TAU).round() }
}

/// The turn rate for the next period on the way to standing `error` radians further to the left.
pub(crate) fn next_turn_rate(now: f64, error: f64, rate: f64, acceleration: f64, period: f64) -> f64 {
    let wanted = stopping_speed(error.abs(), acceleration, period).min(rate).copysign(error);
    step_toward_scalar(now, wanted, acceleration * period)
}

/// Where a body is that has driven for `dt_s` seconds at `speed` metres per second ahead while turning at `turn` radians
/// per second: on an arc, or straight ahead. The reverse of both speeds brings it back.
pub fn drive_arc(pose: &Isometry2<f64>, speed: f64, turn: f64, dt_s: f64) -> Isometry2<f64> {
    let (length, angle) = (speed * dt_s, turn * dt_s);
    // The chord of the arc: sin(x)/x and (1 - cos x)/x, by their series where they would lose digits.
    let (ahead, aside) = if angle.abs() < 1e-4 {
        (1.0 - angle * angle / 6.0, angle / 2.0 - angle * angle * angle / 24.0)
    } else {
        let (sin, cos) = angle.sin_cos();
        (sin / angle, (1.0 - cos) / angle)
    };
    let moved = Translation2::from(Vector2::new(length * ahead, length * aside));
    pose * Isometry2::from_parts(moved, UnitComplex::new(angle))
}

/// The direction of a way, as its angle from the x axis.
pub(crate) fn bearing(to: Vector2<f64>) -> f64 {
    to.y.atan2(to.x)
}
