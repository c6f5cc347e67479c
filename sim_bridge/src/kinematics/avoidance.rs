//! Making way: each body keeps to its own half of the room between itself and every other, and can always stop within it.
//!
//! After Zhou, Wang, Bandyopadhyay and Schwager, *Fast, on-line collision avoidance for dynamic vehicles using buffered
//! Voronoi cells*, IEEE Robotics and Automation Letters 2 (2017): since both do so, none has to know what the other wants.
//! Two that are in each other's way both give way to their right.

use nalgebra::Vector3;

/// Somebody else, as seen from a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neighbour {
    /// From the body's middle to the other's, in metres.
    pub offset: Vector3<f64>,
    /// From the other's middle to its outermost part, in metres.
    pub radius_m: f64,
}

/// What a body can do to get out of the way.
#[derive(Debug, Clone, Copy)]
pub(super) struct AvoidanceLimits {
    /// How quickly it changes its velocity in any direction.
    pub(super) acceleration_mps2: f64,
    /// Until it decides again.
    pub(super) period_s: f64,
    pub(super) radius_m: f64,
    /// Room it leaves beside that.
    pub(super) margin_m: f64,
}

/// How hard two that are closer than their margins move apart: metres per second for each metre that is missing.
const APART_PER_S: f64 = 2.0;
/// The part of the margin that each of two may take up while it gets out of the way: without it, who stands as close as
/// allowed could move nowhere.
const LEEWAY: f64 = 0.25;

impl AvoidanceLimits {
    /// How far it comes until it stands if it moves at `speed` until its next decision and brakes then.
    pub(super) fn stopping_distance(&self, speed: f64) -> f64 {
        speed * self.period_s + speed * speed / (2.0 * self.acceleration_mps2)
    }

    /// The fastest approach that leaves `room` metres to stop in.
    fn approach(&self, room: f64) -> f64 {
        if room <= 0.0 {
            return room * APART_PER_S;
        }
        let (a, t) = (self.acceleration_mps2, self.period_s);
        a * ((t * t + 2.0 * room / a).sqrt() - t)
    }

    /// Direction to a neighbour and this body's part of the room between the two.
    fn room(&self, neighbour: &Neighbour) -> (Vector3<f64>, f64) {
        let distance = neighbour.offset.norm();
        let room = (distance - self.radius_m - neighbour.radius_m - self.margin_m) / 2.0;
        // Two in one point have no direction between them: any is as good.
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

/// The velocity for the next period that comes closest to what is wanted and leaves everybody their room. Both what is
/// wanted and what is answered have passed through `within_limits`: what the body can do in one period.
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
    // Giving way is no reason to go faster than one wanted to go.
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
