//! Collision avoidance: each body stays within its own half of the space between itself and every
//! other body, and can always stop within it.
//!
//! After Zhou, Wang, Bandyopadhyay and Schwager, *Fast, on-line collision avoidance for dynamic
//! vehicles using buffered Voronoi cells*, IEEE Robotics and Automation Letters 2 (2017). Both
//! bodies apply the rule, so neither has to know the other's target. Two bodies that block each
//! other both give way to their right.

use nalgebra::Vector3;

/// Another body, relative to the body that avoids it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Neighbour {
    /// Vector from the body's centre to the other body's centre, in metres.
    pub offset: Vector3<f64>,
    /// Distance from the other body's centre to its outermost part, in metres.
    pub radius_m: f64,
}

/// Limits of a body's ability to avoid others.
#[derive(Debug, Clone, Copy)]
pub(super) struct AvoidanceLimits {
    /// Greatest change of velocity per second, in any direction.
    pub(super) acceleration_mps2: f64,
    /// Time until the next control cycle.
    pub(super) period_s: f64,
    pub(super) radius_m: f64,
    /// Clearance beyond the radius.
    pub(super) margin_m: f64,
}

/// Separation speed of two bodies that are closer than their margins, in metres per second for each
/// missing metre.
const APART_PER_S: f64 = 2.0;
/// Fraction of the margin that each of two bodies may use while it gives way. Without it, a body at
/// the minimum allowed distance could not move at all.
const LEEWAY: f64 = 0.25;

impl AvoidanceLimits {
    /// Returns the distance covered until standstill if the body moves at `speed` until its next
    /// control cycle and then brakes.
    pub(super) fn stopping_distance(&self, speed: f64) -> f64 {
        speed * self.period_s + speed * speed / (2.0 * self.acceleration_mps2)
    }

    /// Returns the fastest approach speed that leaves `room` metres to stop in.
    fn approach(&self, room: f64) -> f64 {
        if room <= 0.0 {
            return room * APART_PER_S;
        }
        let (a, t) = (self.acceleration_mps2, self.period_s);
        a * ((t * t + 2.0 * room / a).sqrt() - t)
    }

    /// Returns the direction to a neighbour, and this body's half of the free space between the
    /// two.
    fn room(&self, neighbour: &Neighbour) -> (Vector3<f64>, f64) {
        let distance = neighbour.offset.norm();
        let room = (distance - self.radius_m - neighbour.radius_m - self.margin_m) / 2.0;
        // Two bodies at the same point have no direction between them: any direction will do.
        let direction = if distance > 0.0 { neighbour.offset / distance } else { Vector3::x() };
        (direction, room)
    }

    fn is_safe(&self, velocity: Vector3<f64>, around: &[Neighbour]) -> bool {
        let stops_s = self.period_s + velocity.norm() / (2.0 * self.acceleration_mps2);
        let leeway_m = self.margin_m * LEEWAY;
        around.iter().all(|neighbour| {
            let (direction, room) = self.room(neighbour);
            let approach = velocity.dot(&direction);
            approach <= 0.0 || approach * stops_s <= room + leeway_m
        })
    }
}

/// Returns the velocity for the next period that is closest to the wanted velocity and leaves every
/// neighbour its space. Both the wanted and the returned velocity have passed through
/// `within_limits`, which limits a velocity to what is reachable in a period.
pub(super) fn avoid_neighbours(
    wanted: Vector3<f64>,
    now: Vector3<f64>,
    agility: AvoidanceLimits,
    around: &[Neighbour],
    within_limits: impl Fn(Vector3<f64>) -> Vector3<f64>,
) -> Vector3<f64> {
    if around.is_empty() {
        return wanted;
    }
    let top_2 = wanted.norm_squared().max(now.norm_squared());
    let mut velocity = wanted;
    for _ in 0..2 {
        for neighbour in around {
            let (direction, room) = agility.room(neighbour);
            let too_fast = velocity.dot(&direction) - agility.approach(room);
            if too_fast > 0.0 {
                let right = Vector3::new(direction.y, -direction.x, 0.0);
                velocity += (right - direction) * too_fast;
            }
        }
    }
    // Giving way must not make the body faster than it wanted to be.
    let speed_2 = velocity.norm_squared();
    if speed_2 > top_2 {
        velocity *= (top_2 / speed_2).sqrt();
    }
    let (way, stop) = (within_limits(velocity), within_limits(Vector3::zeros()));
    for share in [1.0, 0.5, 0.25] {
        let velocity = stop + (way - stop) * share;
        if agility.is_safe(velocity, around) {
            return velocity;
        }
    }
    stop
}
