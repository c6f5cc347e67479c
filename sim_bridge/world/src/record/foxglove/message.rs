//! Messages in Foxglove's format. Lengths in metres, angles as quaternions, colours from 0 to 1.

use crate::map::{LevelIndex, Map};
use crate::world::MotionState;
use serde::Serialize;

/// A point in time, or a duration. In a world's recording it counts from the start of the world; in
/// a fleet's, from 1970.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Time {
    sec: u64,
    nsec: u32,
}

impl Time {
    /// Converts from seconds.
    pub(crate) fn from_seconds(seconds: f64) -> Time {
        Time::of_ns((seconds.max(0.0) * 1e9).round() as u64)
    }

    /// Converts from milliseconds.
    pub fn from_millis(ms: u64) -> Time {
        Time { sec: ms / 1000, nsec: (ms % 1000) as u32 * 1_000_000 }
    }

    fn of_ns(nanoseconds: u64) -> Time {
        Time { sec: nanoseconds / 1_000_000_000, nsec: (nanoseconds % 1_000_000_000) as u32 }
    }

    /// Converts to nanoseconds.
    pub fn nanoseconds(self) -> u64 {
        self.sec.saturating_mul(1_000_000_000).saturating_add(u64::from(self.nsec))
    }

    /// Returns the time a nanosecond later.
    pub(super) fn next(self) -> Time {
        Time::of_ns(self.nanoseconds().saturating_add(1))
    }
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub(super) struct Vector3 {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) z: f64,
}

impl Vector3 {
    pub(super) fn new(x: f64, y: f64, z: f64) -> Vector3 {
        Vector3 { x, y, z }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Pose {
    pub(super) position: Vector3,
    pub(super) orientation: Quaternion,
}

impl Pose {
    /// Returns an upright pose with a heading in radians, counter-clockwise from east.
    pub(super) fn facing(position: Vector3, yaw_rad: f64) -> Pose {
        let (z, w) = (yaw_rad / 2.0).sin_cos();
        Pose { position, orientation: Quaternion { x: 0.0, y: 0.0, z, w } }
    }

    pub(super) fn upright(position: Vector3) -> Pose {
        Pose::facing(position, 0.0)
    }

    /// Returns the pose of a robot. Its height includes the elevation of its level.
    pub(super) fn of(map: &Map, position: &MotionState) -> Pose {
        let z = elevation_m(map, position.level) + position.height_m;
        Pose::facing(Vector3::new(position.pose.x, position.pose.y, z), position.pose.yaw)
    }
}

pub(super) fn elevation_m(map: &Map, level: LevelIndex) -> f64 {
    map.level(level).elevation_m
}

#[derive(Debug, Clone, Copy, Serialize)]
pub(super) struct Colour {
    r: f64,
    g: f64,
    b: f64,
    a: f64,
}

impl Colour {
    /// Parses `#rrggbb`, with an opacity `a`.
    pub(super) fn of(hex: &str, a: f64) -> Colour {
        let channel =
            |at: usize| u8::from_str_radix(hex.get(at..at + 2).unwrap_or("00"), 16).map_or(0.0, f64::from) / 255.0;
        Colour { r: channel(1), g: channel(3), b: channel(5), a }
    }
}

#[derive(Debug, Serialize)]
pub(super) struct PoseInFrame {
    pub(super) timestamp: Time,
    pub(super) frame_id: String,
    pub(super) pose: Pose,
}

#[derive(Debug, Serialize)]
pub(super) struct FrameTransform {
    pub(super) timestamp: Time,
    pub(super) parent_frame_id: String,
    pub(super) child_frame_id: String,
    pub(super) translation: Vector3,
    pub(super) rotation: Quaternion,
}

#[derive(Debug, Serialize)]
pub(super) struct FrameTransforms {
    pub(super) transforms: Vec<FrameTransform>,
}

#[derive(Debug, Serialize)]
pub(super) struct Log {
    pub(super) timestamp: Time,
    /// See [`event_text`](super::event_text).
    pub(super) level: u8,
    pub(super) message: String,
    pub(super) name: String,
    pub(super) file: String,
    pub(super) line: u32,
}

/// State of a robot, for which Foxglove has no schema.
#[derive(Debug, Serialize)]
pub(super) struct RobotState {
    pub(super) timestamp: Time,
    pub(super) place: String,
    /// State of charge, 0 to 1.
    pub(super) battery: f64,
    pub(super) able: bool,
    pub(super) drawer_open: bool,
    pub(super) carries: Vec<String>,
}

#[derive(Debug, Default, Serialize)]
pub(super) struct SceneUpdate {
    pub(super) deletions: Vec<SceneEntityDeletion>,
    pub(super) entities: Vec<SceneEntity>,
}

impl SceneUpdate {
    pub(super) fn is_empty(&self) -> bool {
        self.deletions.is_empty() && self.entities.is_empty()
    }
}

#[derive(Debug, Serialize)]
pub(super) struct SceneEntityDeletion {
    pub(super) timestamp: Time,
    /// 0: the entity with this id; 1: all entities.
    #[serde(rename = "type")]
    pub(super) kind: u8,
    pub(super) id: String,
}

/// A drawn entity. A `lifetime` of zero is unlimited.
#[derive(Debug, Default, Serialize)]
pub(super) struct SceneEntity {
    pub(super) timestamp: Time,
    pub(super) frame_id: String,
    pub(super) id: String,
    pub(super) lifetime: Time,
    pub(super) frame_locked: bool,
    pub(super) metadata: Vec<Nothing>,
    pub(super) arrows: Vec<Arrow>,
    pub(super) cubes: Vec<Cube>,
    pub(super) spheres: Vec<Nothing>,
    pub(super) cylinders: Vec<Cylinder>,
    pub(super) lines: Vec<Line>,
    pub(super) triangles: Vec<Nothing>,
    pub(super) texts: Vec<Text>,
    pub(super) models: Vec<Nothing>,
}

/// Placeholder for parts of messages that recordings never contain.
#[derive(Debug, Serialize)]
pub(super) enum Nothing {}

#[derive(Debug, Serialize)]
pub(super) struct Arrow {
    pub(super) pose: Pose,
    pub(super) shaft_length: f64,
    pub(super) shaft_diameter: f64,
    pub(super) head_length: f64,
    pub(super) head_diameter: f64,
    pub(super) color: Colour,
}

#[derive(Debug, Serialize)]
pub(super) struct Cube {
    pub(super) pose: Pose,
    pub(super) size: Vector3,
    pub(super) color: Colour,
}

#[derive(Debug, Serialize)]
pub(super) struct Cylinder {
    pub(super) pose: Pose,
    pub(super) size: Vector3,
    pub(super) bottom_scale: f64,
    pub(super) top_scale: f64,
    pub(super) color: Colour,
}

#[derive(Debug, Serialize)]
pub(super) struct Line {
    /// 0: a line through all points; 1: a closed line; 2: a separate line for each pair of points.
    #[serde(rename = "type")]
    pub(super) kind: u8,
    pub(super) pose: Pose,
    pub(super) thickness: f64,
    pub(super) scale_invariant: bool,
    pub(super) points: Vec<Vector3>,
    pub(super) color: Colour,
    pub(super) colors: Vec<Colour>,
    pub(super) indices: Vec<u32>,
}

#[derive(Debug, Serialize)]
pub(super) struct Text {
    pub(super) pose: Pose,
    pub(super) billboard: bool,
    pub(super) font_size: f64,
    pub(super) scale_invariant: bool,
    pub(super) color: Colour,
    pub(super) text: String,
}
