//! View of the map. Positions are in metres, x to the east and y to the north.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Map of a fleet, under the names used in map files.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MapView {
    /// Its name.
    pub name: String,
    /// Smallest rectangle around places and walls.
    pub bounds_m: MapBounds,
    /// Levels, the lowest first.
    pub levels: Vec<LevelView>,
    /// Places.
    pub places: Vec<PlaceView>,
    /// Lanes between places.
    pub lanes: Vec<LaneView>,
    /// Doors.
    pub doors: Vec<DoorView>,
    /// Lifts.
    pub lifts: Vec<LiftView>,
    /// Walls.
    pub walls: Vec<WallView>,
}

/// Rectangle on a map, in metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MapBounds {
    /// Smallest x.
    pub west: f64,
    /// Smallest y.
    pub south: f64,
    /// Largest x.
    pub east: f64,
    /// Largest y.
    pub north: f64,
}

/// Level of a map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LevelView {
    /// Its name.
    pub name: String,
    /// Elevation in metres.
    pub elevation_m: f64,
}

/// Place of a map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PlaceView {
    /// Its name.
    pub name: String,
    /// Purpose: `room`, `lab`, `corridor`, `dock`, `charger` or `other`.
    pub kind: String,
    /// Metres to the east.
    pub x_m: f64,
    /// Metres to the north.
    pub y_m: f64,
    /// Heading of a robot at the place, in radians.
    pub yaw_rad: f64,
    /// Its level.
    pub level: String,
}

/// Lane of a map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LaneView {
    /// Its two ends.
    pub between: (String, String),
    /// Driving distance in metres.
    pub length_m: f64,
    /// Whether robots may drive only from the first end to the second.
    pub one_way: bool,
    /// Highest allowed speed, in metres per second.
    pub speed_limit_mps: Option<f64>,
    /// Navigation graphs with this lane; absent: all of them.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub graphs: BTreeSet<String>,
}

/// Door of a map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DoorView {
    /// Its name.
    pub name: String,
    /// The lanes through the door, each given by its two ends.
    pub on: Vec<(String, String)>,
    /// The two posts at each lane, as (x, y).
    pub posts: Vec<((f64, f64), (f64, f64))>,
    /// Seconds from closed to open, and from open to closed.
    pub opening_s: f64,
    /// Its level.
    pub level: Option<String>,
}

/// Lift of a map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LiftView {
    /// Its name.
    pub name: String,
    /// The places at its doors.
    pub stops: Vec<String>,
    /// Number of robots in the cabin at the same time.
    pub capacity: u32,
    /// Seconds from closed to open of its doors, and from open to closed.
    pub opening_s: f64,
    /// Speed of the cabin, in metres per second.
    pub speed_mps: f64,
}

/// Wall of a map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WallView {
    /// Its level.
    pub level: String,
    /// Polyline of (x, y).
    pub line: Vec<(f64, f64)>,
}
