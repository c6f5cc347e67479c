//! The content of a drawing besides the map: items, and the paths driven by robots.

use crate::map::model::LevelIndex;
use std::collections::BTreeMap;

/// An item drawn on a level.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DrawnItem {
    /// Its identity in the file: the id of the cell, or the level and number of the vertex.
    pub id: String,
    /// Its type as written.
    pub kind: String,
    /// Its name; the id if it has no name.
    pub name: String,
    /// Name of its level; `None` on a map with a single level.
    pub level: Option<String>,
    /// Metres to the east, of its centre.
    pub x_m: f64,
    /// Metres to the north, of its centre.
    pub y_m: f64,
    /// Heading in radians counter-clockwise from east.
    pub yaw_rad: f64,
    /// Width and height of its outline before rotation, in metres.
    pub size_m: (f64, f64),
    /// Nearest place on its level; `None` if the level has no places.
    pub place: Option<String>,
    /// All other attributes as written.
    pub attributes: BTreeMap<String, String>,
}

/// The path driven by a robot.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Trail {
    /// Name of the robot.
    pub name: String,
    /// The segments in driving order, each with its level and its points as (x, y) in metres.
    pub segments: Vec<(LevelIndex, Vec<(f64, f64)>)>,
    /// Driven distance in metres; greater than the length of the segments if they were cut.
    pub length_m: f64,
}

impl Trail {
    pub(super) fn points(&self) -> impl Iterator<Item = (f64, f64)> {
        self.segments.iter().flat_map(|(_, points)| points.iter().copied())
    }
}

/// Returns the index of the trail of a robot.
pub(super) fn trail_of(item: &DrawnItem, trails: &[Trail]) -> Option<usize> {
    trails.iter().position(|trail| trail.name == item.name).filter(|_| item.kind == "robot")
}
