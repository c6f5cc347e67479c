//! What sensors perceive: geometry alone.

use super::{BodyGrid, Disc, Ray, WallGrid};
use nalgebra::{Isometry2, Vector2, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Something that a robot perceives with: `sensors = [{ kind = "camera", opening_rad = 1.2, reach_m = 8 }]`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Sensor {
    /// A ray: how far it is to the first wall or body.
    Range {
        /// Where it points, in radians to the left of ahead.
        #[serde(default)]
        bearing_rad: f64,
        /// How far it reaches, in metres.
        reach_m: f64,
    },
    /// A camera: who is within its cone, with no wall between.
    Camera {
        /// Where its middle points, in radians to the left of ahead.
        #[serde(default)]
        bearing_rad: f64,
        /// How wide it sees, in radians from edge to edge.
        opening_rad: f64,
        /// How far it sees, in metres.
        reach_m: f64,
    },
    /// A feeler all around: who is near, whatever stands between.
    Proximity {
        /// How near, in metres from edge to edge.
        reach_m: f64,
    },
}

impl Sensor {
    /// How far it reaches, in metres.
    pub fn reach_m(&self) -> f64 {
        match self {
            Sensor::Range { reach_m, .. } | Sensor::Camera { reach_m, .. } | Sensor::Proximity { reach_m } => *reach_m,
        }
    }

    /// How wide it perceives, in radians: 0 along a ray, a full turn all around.
    pub fn opening_rad(&self) -> f64 {
        match self {
            Sensor::Range { .. } => 0.0,
            Sensor::Camera { opening_rad, .. } => *opening_rad,
            Sensor::Proximity { .. } => std::f64::consts::TAU,
        }
    }

    /// Where it points, in radians to the left of ahead; one that perceives all around points ahead.
    pub fn bearing_rad(&self) -> f64 {
        match self {
            Sensor::Range { bearing_rad, .. } | Sensor::Camera { bearing_rad, .. } => *bearing_rad,
            Sensor::Proximity { .. } => 0.0,
        }
    }

    /// The ray along the middle of what it perceives.
    fn axis(&self, pose: &Isometry2<f64>) -> Ray {
        Ray::at_angle(pose.translation.vector, pose.rotation.angle() + self.bearing_rad())
    }

    /// The distance from the middle of `own`, which looks where `pose` does, to the first wall or body along the middle of
    /// what it perceives, in metres; none if that is free for as far as it reaches.
    pub fn measure_range_m(
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
        // Beyond either end by a radius, and above or below by as much.
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

    /// Shows each body that a camera or feeler of `own` perceives: its name, how far it is from middle to middle (metres)
    /// and in which direction (radians to the left of ahead).
    pub fn for_each_detection(
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
        distance_m <= self.reach_m() && aside.abs() <= self.opening_rad() / 2.0
    }
}

/// Radians to the left of where a pose looks.
fn direction(pose: &Isometry2<f64>, to: Vector2<f64>) -> f64 {
    let seen = pose.rotation.inverse() * to;
    seen.y.atan2(seen.x)
}

/// Whether any of a body's middle and its two edges can be seen.
fn is_in_sight(from: Vector2<f64>, disc: &Disc, walls: &WallGrid) -> bool {
    let middle = disc.at.xy();
    let Some((ray, _)) = Ray::towards(from, middle) else { return true };
    let edge = Vector2::new(-ray.direction.y, ray.direction.x) * disc.radius_m;
    [middle, middle + edge, middle - edge].into_iter().any(|seen| walls.is_clear(from, seen))
}
