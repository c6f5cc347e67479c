//! Converts coordinates of the file to metres, in a common frame of all levels.

use super::diagnostic::{EntryError, RmfDiagnostic};
use super::raw::{Edge, Fiducial, Parameters, Vertex, parameter};
use serde_json::Value;
use std::collections::BTreeMap;

/// Equatorial radius in metres and squared eccentricity of the earth's ellipsoid (WGS 84).
const EQUATOR_M: f64 = 6_378_137.0;
const ECCENTRICITY_SQUARED: f64 = 0.006_694_379_990_14;

pub(super) type Point = (f64, f64);

/// Coordinate system of a file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum CoordinateSystem {
    /// Pixels of a floor plan, y down.
    ReferenceImage,
    /// Metres, y north.
    CartesianMeters,
    /// Degrees of longitude and latitude.
    Wgs84,
}

impl CoordinateSystem {
    pub(super) fn of(name: Option<&str>) -> Result<CoordinateSystem, EntryError> {
        match name {
            None | Some("reference_image") => Ok(CoordinateSystem::ReferenceImage),
            Some("cartesian_meters") => Ok(CoordinateSystem::CartesianMeters),
            Some("wgs84") => Ok(CoordinateSystem::Wgs84),
            Some(other) => Err(EntryError::InvalidValue {
                field: "coordinate_system".into(),
                text: format!("{other:?}"),
                allowed: "reference_image, cartesian_meters or wgs84",
            }),
        }
    }

    /// Returns a point of the file with y up.
    pub(super) fn to_y_up(self, (x, y): Point) -> Point {
        if self == CoordinateSystem::ReferenceImage { (x, -y) } else { (x, y) }
    }
}

/// Transform of the points of a level, with y up, to metres: rotation, scale in each direction,
/// translation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LevelTransform {
    scale: (f64, f64),
    turn: f64,
    shift: Point,
}

impl LevelTransform {
    pub(super) const METRES: LevelTransform = LevelTransform { scale: (1.0, 1.0), turn: 0.0, shift: (0.0, 0.0) };

    pub(super) fn scaled(scale: f64) -> LevelTransform {
        LevelTransform { scale: (scale, scale), ..LevelTransform::METRES }
    }

    pub(super) fn apply(&self, (x, y): Point) -> Point {
        let (sin, cos) = self.turn.sin_cos();
        let (x, y) = (x * self.scale.0, y * self.scale.1);
        (x * cos - y * sin + self.shift.0, x * sin + y * cos + self.shift.1)
    }

    /// Returns the transform from longitude and latitude to metres east and north of an origin, in
    /// the plane that touches the earth there. A building is small enough to neglect the curvature
    /// of the earth.
    pub(super) fn local_tangent_plane((longitude, latitude): Point) -> LevelTransform {
        let (sin, cos) = latitude.to_radians().sin_cos();
        let bend = 1.0 - ECCENTRICITY_SQUARED * sin * sin;
        let north = EQUATOR_M * (1.0 - ECCENTRICITY_SQUARED) / bend.powf(1.5);
        let east = EQUATOR_M / bend.sqrt() * cos;
        let scale = (east.to_radians(), north.to_radians());
        LevelTransform { scale, turn: 0.0, shift: (-longitude * scale.0, -latitude * scale.1) }
    }

    /// Returns the transform that aligns a level with the reference level by their common
    /// fiducials: the mean rotation, scale and translation between the two sets. `None` for fewer
    /// than two fiducials, or two at the same point.
    pub(super) fn fit_to_reference(reference: &LevelTransform, pairs: &[(Point, Point)]) -> Option<LevelTransform> {
        let mut turn = (0.0, 0.0);
        let (mut scale, mut count) = (0.0, 0.0);
        for (i, (mark_a, own_a)) in pairs.iter().enumerate() {
            for (mark_b, own_b) in &pairs[i + 1..] {
                let (there, here) =
                    ((mark_b.0 - mark_a.0, mark_b.1 - mark_a.1), (own_b.0 - own_a.0, own_b.1 - own_a.1));
                let apart = there.1.atan2(there.0) - here.1.atan2(here.0);
                turn = (turn.0 + apart.cos(), turn.1 + apart.sin());
                scale += here.0.hypot(here.1) / there.0.hypot(there.1);
                count += 1.0;
            }
        }
        let scale = reference.scale.0 / (scale / count);
        let turned = LevelTransform { scale: (scale, scale), turn: turn.1.atan2(turn.0), shift: (0.0, 0.0) };
        let shifts = pairs.iter().map(|(mark, own)| {
            let (at, to) = (turned.apply(*own), reference.apply(*mark));
            (to.0 - at.0, to.1 - at.1)
        });
        let sum = shifts.fold((0.0, 0.0), |sum, shift| (sum.0 + shift.0, sum.1 + shift.1));
        let frame = LevelTransform { shift: (sum.0 / pairs.len() as f64, sum.1 / pairs.len() as f64), ..turned };
        (scale.is_finite() && scale > 0.0 && frame.shift.0.is_finite() && frame.shift.1.is_finite()).then_some(frame)
    }
}

/// Returns the metres per pixel of a level: the mean over its measurements.
pub(super) fn metres_per_pixel(
    level: &str,
    vertices: &[Vertex],
    measurements: &[Edge],
    diagnostics: &mut Vec<RmfDiagnostic>,
) -> Option<f64> {
    let mut scales = Vec::new();
    let before = diagnostics.len();
    for measurement in measurements {
        let [a, b] = measurement.ends.map(|end| vertices[end].at);
        let length = (a.0 - b.0).hypot(a.1 - b.1);
        let positive: fn(&Value) -> Option<f64> = |value| value.as_f64().filter(|metres| *metres > 0.0);
        let error = match parameter(&measurement.parameters, "distance", "a number of metres above 0", positive) {
            Ok(Some(_)) if length == 0.0 => EntryError::ZeroLength,
            Ok(Some(distance)) => {
                scales.push(distance / length);
                continue;
            }
            Ok(None) => EntryError::Missing { field: "distance" },
            Err(error) => error,
        };
        let at = format!("level {level:?}, measurement {}", measurement.number);
        diagnostics.push(RmfDiagnostic { at, error });
    }
    let mean = scales.iter().sum::<f64>() / scales.len() as f64;
    if scales.is_empty() && diagnostics.len() == before {
        diagnostics.push(RmfDiagnostic { at: format!("level {level:?}"), error: EntryError::NoMeasurements });
    }
    mean.is_finite().then_some(mean)
}

/// Returns the common fiducials of two levels, each as its points on the reference level and on the
/// own level, with y up.
pub(super) fn shared_fiducials(
    system: CoordinateSystem,
    reference: &[Fiducial],
    own: &[Fiducial],
) -> Vec<(Point, Point)> {
    let named: BTreeMap<&str, Point> = own.iter().rev().map(|mark| (mark.name.as_str(), mark.at)).collect();
    let marks = reference.iter().filter(|mark| !mark.name.is_empty());
    let pairs = marks.filter_map(|mark| Some((mark.at, *named.get(mark.name.as_str())?)));
    pairs.map(|(there, here)| (system.to_y_up(there), system.to_y_up(here))).collect()
}

/// Returns the origin of a building in degrees: the vertex named by its parameters, else the least
/// longitude and latitude.
pub(super) fn origin<'a>(parameters: &Parameters, vertices: impl Iterator<Item = &'a Vertex> + Clone) -> Point {
    let named = parameters.get("generate_origin_vertex").and_then(Value::as_str);
    let found = named.and_then(|name| vertices.clone().find(|vertex| vertex.name == name));
    found.map_or_else(
        || {
            let least = |(x, y): Point, vertex: &Vertex| (x.min(vertex.at.0), y.min(vertex.at.1));
            vertices.fold((f64::INFINITY, f64::INFINITY), least)
        },
        |vertex| vertex.at,
    )
}
