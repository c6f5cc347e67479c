//! From the coordinates of the file to metres: one frame for all levels.

use super::problem::{EntryError, RmfDiagnostic};
use super::raw::{Edge, Fiducial, Parameters, Vertex, parameter};
use serde_json::Value;
use std::collections::BTreeMap;

/// Equatorial radius and squared eccentricity of the earth's ellipsoid (WGS 84).
const EQUATOR_M: f64 = 6_378_137.0;
const ECCENTRICITY_SQUARED: f64 = 0.006_694_379_990_14;

type Point = (f64, f64);

/// What the coordinates of a file are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum System {
    /// Pixels of a floor plan, y down.
    ReferenceImage,
    /// Metres, y north.
    CartesianMeters,
    /// Degrees of longitude and latitude.
    Wgs84,
}

impl System {
    pub(super) fn of(name: Option<&str>) -> Result<System, EntryError> {
        match name {
            None | Some("reference_image") => Ok(System::ReferenceImage),
            Some("cartesian_meters") => Ok(System::CartesianMeters),
            Some("wgs84") => Ok(System::Wgs84),
            Some(other) => Err(EntryError::Value {
                field: "coordinate_system".into(),
                text: format!("{other:?}"),
                allowed: "reference_image, cartesian_meters or wgs84",
            }),
        }
    }

    /// A point of the file with y up.
    pub(super) fn upright(self, (x, y): Point) -> Point {
        if self == System::ReferenceImage { (x, -y) } else { (x, y) }
    }
}

/// How the points of a level, with y up, become metres: turned, scaled in each direction, and moved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame {
    scale: (f64, f64),
    turn: f64,
    shift: Point,
}

impl Frame {
    pub(super) const METRES: Frame = Frame { scale: (1.0, 1.0), turn: 0.0, shift: (0.0, 0.0) };

    pub(super) fn scaled(scale: f64) -> Frame {
        Frame { scale: (scale, scale), ..Frame::METRES }
    }

    pub(super) fn apply(&self, (x, y): Point) -> Point {
        let (sin, cos) = self.turn.sin_cos();
        let (x, y) = (x * self.scale.0, y * self.scale.1);
        (x * cos - y * sin + self.shift.0, x * sin + y * cos + self.shift.1)
    }

    /// Longitude and latitude to metres east and north of an origin, in the plane that touches the earth there: a building
    /// is so small that the earth is flat under it.
    pub(super) fn around((longitude, latitude): Point) -> Frame {
        let (sin, cos) = latitude.to_radians().sin_cos();
        let bend = 1.0 - ECCENTRICITY_SQUARED * sin * sin;
        let north = EQUATOR_M * (1.0 - ECCENTRICITY_SQUARED) / bend.powf(1.5);
        let east = EQUATOR_M / bend.sqrt() * cos;
        let scale = (east.to_radians(), north.to_radians());
        Frame { scale, turn: 0.0, shift: (-longitude * scale.0, -latitude * scale.1) }
    }

    /// The frame that lays a level over the reference level by the marks that both have: the mean turn, scale and shift
    /// that bring its marks to theirs. None if there are fewer than two marks, or two at one point.
    pub(super) fn over(reference: &Frame, pairs: &[(Point, Point)]) -> Option<Frame> {
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
        let turned = Frame { scale: (scale, scale), turn: turn.1.atan2(turn.0), shift: (0.0, 0.0) };
        let shifts = pairs.iter().map(|(mark, own)| {
            let (at, to) = (turned.apply(*own), reference.apply(*mark));
            (to.0 - at.0, to.1 - at.1)
        });
        let sum = shifts.fold((0.0, 0.0), |sum, shift| (sum.0 + shift.0, sum.1 + shift.1));
        let frame = Frame { shift: (sum.0 / pairs.len() as f64, sum.1 / pairs.len() as f64), ..turned };
        (scale.is_finite() && scale > 0.0 && frame.shift.0.is_finite() && frame.shift.1.is_finite()).then_some(frame)
    }
}

/// Metres per pixel of a level: the mean over its measurements.
pub(super) fn scale(
    level: &str,
    vertices: &[Vertex],
    measurements: &[Edge],
    problems: &mut Vec<RmfDiagnostic>,
) -> Option<f64> {
    let mut scales = Vec::new();
    let before = problems.len();
    for measurement in measurements {
        let [a, b] = measurement.ends.map(|end| vertices[end].at);
        let length = (a.0 - b.0).hypot(a.1 - b.1);
        let positive: fn(&Value) -> Option<f64> = |value| value.as_f64().filter(|metres| *metres > 0.0);
        let wrong = match parameter(&measurement.parameters, "distance", "a number of metres above 0", positive) {
            Ok(Some(_)) if length == 0.0 => EntryError::NoExtent,
            Ok(Some(distance)) => {
                scales.push(distance / length);
                continue;
            }
            Ok(None) => EntryError::Missing { field: "distance" },
            Err(wrong) => wrong,
        };
        let at = format!("level {level:?}, measurement {}", measurement.number);
        problems.push(RmfDiagnostic { at, wrong });
    }
    let mean = scales.iter().sum::<f64>() / scales.len() as f64;
    if scales.is_empty() && problems.len() == before {
        problems.push(RmfDiagnostic { at: format!("level {level:?}"), wrong: EntryError::NoScale });
    }
    mean.is_finite().then_some(mean)
}

/// The marks that two levels share, as points of the one and of the other, with y up.
pub(super) fn shared(system: System, reference: &[Fiducial], own: &[Fiducial]) -> Vec<(Point, Point)> {
    let named: BTreeMap<&str, Point> = own.iter().rev().map(|mark| (mark.name.as_str(), mark.at)).collect();
    let marks = reference.iter().filter(|mark| !mark.name.is_empty());
    let pairs = marks.filter_map(|mark| Some((mark.at, *named.get(mark.name.as_str())?)));
    pairs.map(|(there, here)| (system.upright(there), system.upright(here))).collect()
}

/// The origin of a building in degrees: the vertex that its parameters name, else the least longitude and latitude.
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
