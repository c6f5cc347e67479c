//! Rays and their intersections.

use nalgebra::Vector2;

/// A half-line from a point in a direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Ray {
    /// Start, in metres.
    pub from: Vector2<f64>,
    /// Direction, of length 1.
    pub direction: Vector2<f64>,
}

/// A straight wall segment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Segment {
    /// First end, in metres.
    pub a: Vector2<f64>,
    /// Second end, in metres.
    pub b: Vector2<f64>,
}

impl Ray {
    /// Creates a ray at an angle, in radians counter-clockwise from the x axis.
    pub(crate) fn at_angle(from: Vector2<f64>, angle: f64) -> Ray {
        let (sin, cos) = angle.sin_cos();
        Ray { from, direction: Vector2::new(cos, sin) }
    }

    /// Creates the ray from a point towards another, with their distance; `None` for equal points.
    pub(crate) fn towards(from: Vector2<f64>, to: Vector2<f64>) -> Option<(Ray, f64)> {
        let length = (to - from).norm();
        (length > 0.0).then(|| (Ray { from, direction: (to - from) / length }, length))
    }

    /// Returns the point `distance_m` metres along the ray.
    pub(crate) fn at(&self, distance_m: f64) -> Vector2<f64> {
        self.from + self.direction * distance_m
    }

    /// Returns the distance to the intersection with a wall; `None` if there is none, or the ray is
    /// parallel.
    pub(crate) fn intersect_wall(&self, wall: &Segment) -> Option<f64> {
        let along = wall.b - wall.a;
        let across = self.direction.perp(&along);
        if across == 0.0 {
            return None;
        }
        let to = wall.a - self.from;
        let (distance, share) = (to.perp(&along) / across, to.perp(&self.direction) / across);
        (distance >= 0.0 && (0.0..=1.0).contains(&share)).then_some(distance)
    }

    /// Returns the distance at which the ray enters a disc: 0 if it starts inside, `None` if it
    /// misses.
    pub(crate) fn intersect_disc(&self, middle: Vector2<f64>, radius_m: f64) -> Option<f64> {
        let to = middle - self.from;
        if to.norm_squared() <= radius_m * radius_m {
            return Some(0.0);
        }
        let (ahead, aside) = (to.dot(&self.direction), to.perp(&self.direction));
        let depth_2 = radius_m * radius_m - aside * aside;
        (ahead > 0.0 && depth_2 >= 0.0).then(|| ahead - depth_2.sqrt())
    }
}

impl Segment {
    /// Returns the point of the segment that is closest to a point.
    pub(crate) fn closest_point(&self, to: Vector2<f64>) -> Vector2<f64> {
        let along = self.b - self.a;
        let length_2 = along.norm_squared();
        if length_2 == 0.0 {
            return self.a;
        }
        self.a + along * ((to - self.a).dot(&along) / length_2).clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wall(ax: f64, ay: f64, bx: f64, by: f64) -> Segment {
        Segment { a: Vector2::new(ax, ay), b: Vector2::new(bx, by) }
    }

    #[test]
    fn a_ray_intersects_only_objects_ahead() {
        let east = Ray::at_angle(Vector2::new(1.0, 1.0), 0.0);
        assert_eq!(east.intersect_wall(&wall(3.0, 0.0, 3.0, 2.0)), Some(2.0));
        assert_eq!(east.intersect_wall(&wall(3.0, 2.0, 3.0, 3.0)), None);
        assert_eq!(east.intersect_wall(&wall(0.0, 0.0, 0.0, 2.0)), None);
        assert_eq!(east.intersect_wall(&wall(2.0, 1.0, 5.0, 1.0)), None, "along the wall");
        assert_eq!(east.intersect_disc(Vector2::new(4.0, 1.0), 0.5), Some(2.5));
        assert_eq!(east.intersect_disc(Vector2::new(4.0, 1.6), 0.5), None);
        assert_eq!(east.intersect_disc(Vector2::new(-4.0, 1.0), 0.5), None);
        assert_eq!(east.intersect_disc(Vector2::new(1.2, 1.0), 0.5), Some(0.0));
    }

    #[test]
    fn the_closest_point_of_a_wall_is_on_the_wall() {
        let wall = wall(0.0, 0.0, 4.0, 0.0);
        let closest = |x, y| wall.closest_point(Vector2::new(x, y));
        assert_eq!(closest(1.0, 3.0), Vector2::new(1.0, 0.0));
        assert_eq!(closest(-1.0, 3.0), Vector2::new(0.0, 0.0));
        assert_eq!(closest(9.0, -1.0), Vector2::new(4.0, 0.0));
    }
}
