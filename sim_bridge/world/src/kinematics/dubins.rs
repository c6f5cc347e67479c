//! The shortest path of a car: arcs of its tightest turn, and straight lines between them.
//!
//! Dubins, *On curves of minimal length with a constraint on average curvature*, American Journal
//! of Mathematics 79 (1957): the shortest path is among six words of left turn, right turn and
//! straight. The lengths are those of Shkel and Lumelsky, *Classification of the Dubins set*,
//! Robotics and Autonomous Systems 34 (2001).

use super::motion_math::drive_arc;
use nalgebra::Isometry2;
use std::f64::consts::TAU;

/// Direction of a path segment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Turn {
    Left,
    Right,
    Straight,
}

/// A shortest forward path between two poses with a minimum turning radius.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct DubinsPath {
    start: Isometry2<f64>,
    radius_m: f64,
    /// Segments with their lengths in metres.
    stretches: [(Turn, f64); 3],
}

use Turn::{Left, Right, Straight};

impl DubinsPath {
    /// Computes the shortest path.
    ///
    /// # Panics
    /// Panics if the radius is not above 0.
    pub(crate) fn shortest(start: Isometry2<f64>, end: Isometry2<f64>, radius_m: f64) -> DubinsPath {
        assert!(radius_m > 0.0, "a turning radius is above 0: {radius_m}");
        let relative = start.inverse() * end;
        let to = relative.translation.vector / radius_m;
        let (distance, theta) = (to.norm(), to.y.atan2(to.x));
        let (alpha, beta) = (turned(-theta), turned(relative.rotation.angle() - theta));
        let words = [
            word([Left, Straight, Left], lsl(distance, alpha, beta)),
            word([Right, Straight, Right], rsr(distance, alpha, beta)),
            word([Left, Straight, Right], lsr(distance, alpha, beta)),
            word([Right, Straight, Left], rsl(distance, alpha, beta)),
            word([Right, Left, Right], rlr(distance, alpha, beta)),
            word([Left, Right, Left], lrl(distance, alpha, beta)),
        ];
        let length = |stretches: &[(Turn, f64); 3]| stretches.iter().map(|(_, length)| length).sum::<f64>();
        let shortest = words.into_iter().flatten().min_by(|a, b| length(a).total_cmp(&length(b)));
        let stretches = shortest.expect("two left or two right turns always lead there");
        DubinsPath { start, radius_m, stretches: stretches.map(|(turn, length)| (turn, length * radius_m)) }
    }

    /// Length in metres.
    pub(crate) fn length_m(&self) -> f64 {
        self.stretches.iter().map(|(_, length)| length).sum()
    }

    /// Returns the pose `distance_m` metres along the path, clamped to its start and end.
    pub(crate) fn pose_at(&self, distance_m: f64) -> Isometry2<f64> {
        let (mut pose, mut left) = (self.start, distance_m.max(0.0));
        for (turn, length) in self.stretches {
            let curvature = match turn {
                Left => self.radius_m.recip(),
                Right => -self.radius_m.recip(),
                Straight => 0.0,
            };
            let part = left.min(length);
            pose = drive_arc(&pose, 1.0, curvature, part);
            left -= part;
        }
        pose
    }
}

fn word(turns: [Turn; 3], lengths: Option<[f64; 3]>) -> Option<[(Turn, f64); 3]> {
    let [a, b, c] = lengths?;
    Some([(turns[0], a), (turns[1], b), (turns[2], c)])
}

/// Normalises an angle to 0..2π. An angle just short of a full turn becomes 0.
fn turned(angle: f64) -> f64 {
    let turned = angle.rem_euclid(TAU);
    if TAU - turned < 1e-9 { 0.0 } else { turned }
}

fn lsl(d: f64, a: f64, b: f64) -> Option<[f64; 3]> {
    let (x, y) = (b.cos() - a.cos(), d + a.sin() - b.sin());
    let angle = x.atan2(y);
    Some([turned(-a + angle), x.hypot(y), turned(b - angle)])
}

fn rsr(d: f64, a: f64, b: f64) -> Option<[f64; 3]> {
    let (x, y) = (a.cos() - b.cos(), d - a.sin() + b.sin());
    let angle = x.atan2(y);
    Some([turned(a - angle), x.hypot(y), turned(-b + angle)])
}

fn lsr(d: f64, a: f64, b: f64) -> Option<[f64; 3]> {
    let straight_2 = -2.0 + d * d + 2.0 * (a - b).cos() + 2.0 * d * (a.sin() + b.sin());
    let straight = (straight_2 >= 0.0).then(|| straight_2.sqrt())?;
    let angle = (-a.cos() - b.cos()).atan2(d + a.sin() + b.sin()) - (-2.0_f64).atan2(straight);
    Some([turned(-a + angle), straight, turned(-b + angle)])
}

fn rsl(d: f64, a: f64, b: f64) -> Option<[f64; 3]> {
    let straight_2 = -2.0 + d * d + 2.0 * (a - b).cos() - 2.0 * d * (a.sin() + b.sin());
    let straight = (straight_2 >= 0.0).then(|| straight_2.sqrt())?;
    let angle = (a.cos() + b.cos()).atan2(d - a.sin() - b.sin()) - 2.0_f64.atan2(straight);
    Some([turned(a - angle), straight, turned(b - angle)])
}

fn rlr(d: f64, a: f64, b: f64) -> Option<[f64; 3]> {
    let cos = (6.0 - d * d + 2.0 * (a - b).cos() + 2.0 * d * (a.sin() - b.sin())) / 8.0;
    let middle = (cos.abs() <= 1.0).then(|| turned(TAU - cos.acos()))?;
    let first = turned(a - (a.cos() - b.cos()).atan2(d - a.sin() + b.sin()) + middle / 2.0);
    Some([first, middle, turned(a - b - first + middle)])
}

fn lrl(d: f64, a: f64, b: f64) -> Option<[f64; 3]> {
    let cos = (6.0 - d * d + 2.0 * (a - b).cos() + 2.0 * d * (b.sin() - a.sin())) / 8.0;
    let middle = (cos.abs() <= 1.0).then(|| turned(TAU - cos.acos()))?;
    let first = turned(-a + (b.cos() - a.cos()).atan2(d + a.sin() - b.sin()) + middle / 2.0);
    Some([first, middle, turned(b - a - first + middle)])
}
