//! Geometry of sensors.

use super::{BodyGrid, Disc, Ray, WallGrid};
use nalgebra::{Isometry2, Vector2, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A sensor of a robot: `sensors = [{ kind = "camera", field_of_view_rad = 1.2, reach_m = 8 }]`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Sensor {
    /// A range finder: the distance to the first wall or body along a ray.
    Range {
        /// Direction, in radians to the left of ahead.
        #[serde(default)]
        bearing_rad: f64,
        /// Range, in metres.
        reach_m: f64,
    },
    /// A camera: detects robots and people within its field of view that no wall hides.
    Camera {
        /// Direction of the centre, in radians to the left of ahead.
        #[serde(default)]
        bearing_rad: f64,
        /// Field of view from edge to edge, in radians.
        field_of_view_rad: f64,
        /// Range, in metres.
        reach_m: f64,
    },
    /// A proximity sensor: detects robots and people nearby in every direction, also through walls.
    Proximity {
        /// Range from edge to edge, in metres.
        reach_m: f64,
    },
}

impl Sensor {
    /// Range, in metres.
    pub(crate) fn reach_m(&self) -> f64 {
        match self {
            Sensor::Range { reach_m, .. } | Sensor::Camera { reach_m, .. } | Sensor::Proximity { reach_m } => *reach_m,
        }
    }

    /// Field of view, in radians: 0 for a ray, a full turn for a proximity sensor.
    pub(crate) fn field_of_view_rad(&self) -> f64 {
        match self {
            Sensor::Range { .. } => 0.0,
            Sensor::Camera { field_of_view_rad, .. } => *field_of_view_rad,
            Sensor::Proximity { .. } => std::f64::consts::TAU,
        }
    }

    /// Direction, in radians to the left of ahead. A proximity sensor points ahead.
    pub(crate) fn bearing_rad(&self) -> f64 {
        match self {
            Sensor::Range { bearing_rad, .. } | Sensor::Camera { bearing_rad, .. } => *bearing_rad,
            Sensor::Proximity { .. } => 0.0,
        }
    }

    /// Returns the ray along the centre of the field of view.
    fn axis(&self, pose: &Isometry2<f64>) -> Ray {
        Ray::at_angle(pose.translation.vector, pose.rotation.angle() + self.bearing_rad())
    }

    /// Returns the distance in metres from the centre of body `own`, with the heading of `pose`, to
    /// the first wall or body along the centre of the field of view; `None` if the path is free
    /// within the range.
    pub(crate) fn measure_range_m(
        &self,
        pose: &Isometry2<f64>,
        own: usize,
        bodies: &BodyGrid,
        walls: &WallGrid,
    ) -> Option<f64> {
        let (ray, reach_m, own_disc) = (self.axis(pose), self.reach_m(), bodies.disc(own));
        let mut first = walls.first_hit(&ray, reach_m);
        let half_way = ray.at(reach_m / 2.0);
        let around = Vector3::new(half_way.x, half_way.y, own_disc.at.z);
        // Extended by a radius beyond either end, and by as much above and below.
        let around_m = (reach_m / 2.0 + bodies.max_radius_m()).hypot(bodies.max_radius_m());
        bodies.for_each_near(&around, own_disc.level, around_m, |name, disc| {
            let level_with = (disc.at.z - own_disc.at.z).abs() <= disc.radius_m;
            let hit = ray.intersect_disc(disc.at.xy(), disc.radius_m).filter(|hit| *hit <= reach_m);
            if name != own && level_with {
                first = first.into_iter().chain(hit).min_by(f64::total_cmp);
            }
        });
        first
    }

    /// Calls `show` for each body that the camera or proximity sensor of `own` detects, with its
    /// index, its distance from centre to centre (metres) and its direction (radians to the left of
    /// ahead).
    pub(crate) fn for_each_detection(
        &self,
        pose: &Isometry2<f64>,
        own: usize,
        bodies: &BodyGrid,
        walls: &WallGrid,
        mut show: impl FnMut(usize, f64, f64),
    ) {
        let own_disc = *bodies.disc(own);
        let from = pose.translation.vector;
        let reach_m = self.reach_m() + own_disc.radius_m + bodies.max_radius_m();
        bodies.for_each_near(&own_disc.at, own_disc.level, reach_m, |name, disc| {
            if name == own {
                return;
            }
            let (to, distance_m) = (disc.at.xy() - from, (disc.at - own_disc.at).norm());
            let direction = direction(pose, to);
            let perceived = match self {
                Sensor::Proximity { reach_m } => distance_m - own_disc.radius_m - disc.radius_m <= *reach_m,
                Sensor::Range { .. } | Sensor::Camera { .. } => {
                    self.has_in_cone(direction, distance_m) && is_in_sight(from, disc, walls)
                }
            };
            if perceived {
                show(name, distance_m, direction);
            }
        });
    }

    fn has_in_cone(&self, direction: f64, distance_m: f64) -> bool {
        let aside = nalgebra::UnitComplex::new(direction - self.bearing_rad()).angle();
        distance_m <= self.reach_m() && aside.abs() <= self.field_of_view_rad() / 2.0
    }
}

/// Angle of a vector relative to the heading of a pose, in radians to the left.
fn direction(pose: &Isometry2<f64>, to: Vector2<f64>) -> f64 {
    let seen = pose.rotation.inverse() * to;
    seen.y.atan2(seen.x)
}

/// Checks whether the centre of a body, or either of its two edges, is visible.
fn is_in_sight(from: Vector2<f64>, disc: &Disc, walls: &WallGrid) -> bool {
    let middle = disc.at.xy();
    let Some((ray, _)) = Ray::towards(from, middle) else { return true };
    let edge = Vector2::new(-ray.direction.y, ray.direction.x) * disc.radius_m;
    [middle, middle + edge, middle - edge].into_iter().any(|seen| walls.is_clear(from, seen))
}
