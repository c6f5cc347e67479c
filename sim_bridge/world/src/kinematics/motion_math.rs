//! Arithmetic that the models share: stopping at a point, changing speed within limits, turning.

use nalgebra::{Isometry2, SVector, Translation2, UnitComplex, Vector2};

/// Two instants of a clock closer than this, in seconds, count as the same instant.
pub(crate) const TIME_EPSILON_S: f64 = 1e-9;

/// Returns the fastest speed for the next period from which braking by `acceleration * period` in
/// each period stops exactly at `distance`, after a whole number of periods.
pub(crate) fn stopping_speed(distance: f64, acceleration: f64, period: f64) -> f64 {
    if distance <= 0.0 {
        return 0.0;
    }
    let notch = acceleration * period;
    // In n periods, each slower by a notch, the distance covered is
    // `notch * period * n (n + 1) / 2`.
    let periods = ((0.25 + 2.0 * distance / (notch * period)).sqrt() - 0.5).ceil().max(1.0);
    distance / (periods * period) + notch * (periods - 1.0) / 2.0
}

/// Returns the velocity closest to `wanted` that differs from `now` by at most `change`.
pub(crate) fn step_toward<const D: usize>(
    now: SVector<f64, D>,
    wanted: SVector<f64, D>,
    change: f64,
) -> SVector<f64, D> {
    let (step, length_2) = (wanted - now, (wanted - now).norm_squared());
    if length_2 <= change * change { wanted } else { now + step * (change / length_2.sqrt()) }
}

/// The same as [`step_toward`] for scalars.
pub(crate) fn step_toward_scalar(now: f64, wanted: f64, change: f64) -> f64 {
    now + (wanted - now).clamp(-change, change)
}

/// Normalises an angle to -π..π.
pub(crate) fn wrap_angle(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    if angle.abs() <= PI { angle } else { angle - TAU * (angle / TAU).round() }
}

/// Returns the turn rate for the next period on the way to a heading `error` radians further to the
/// left.
pub(crate) fn next_turn_rate(now: f64, error: f64, rate: f64, acceleration: f64, period: f64) -> f64 {
    let wanted = stopping_speed(error.abs(), acceleration, period).min(rate).copysign(error);
    step_toward_scalar(now, wanted, acceleration * period)
}

/// Returns the pose after driving for `dt_s` seconds at `speed` metres per second while turning at
/// `turn` radians per second: on an arc, or straight ahead. Reversing both speeds leads back.
pub(crate) fn drive_arc(pose: &Isometry2<f64>, speed: f64, turn: f64, dt_s: f64) -> Isometry2<f64> {
    let (length, angle) = (speed * dt_s, turn * dt_s);
    // The chord of the arc: sin(x)/x and (1 - cos x)/x, by their series where the direct formulas
    // would lose digits.
    let (ahead, aside) = if angle.abs() < 1e-4 {
        (1.0 - angle * angle / 6.0, angle / 2.0 - angle * angle * angle / 24.0)
    } else {
        let (sin, cos) = angle.sin_cos();
        (sin / angle, (1.0 - cos) / angle)
    };
    let moved = Translation2::from(Vector2::new(length * ahead, length * aside));
    pose * Isometry2::from_parts(moved, UnitComplex::new(angle))
}

/// Angle of a vector from the x axis.
pub(crate) fn bearing(to: Vector2<f64>) -> f64 {
    to.y.atan2(to.x)
}
