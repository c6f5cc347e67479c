//! The map file: its entries and its limits.

use super::model::{Facing, PlaceKind};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Upper limits of a map file. They are ample for a hospital; they keep a faulty file from filling
/// the memory.
pub mod limits {
    /// Bytes of a file.
    pub const FILE_BYTES: usize = 4 << 20;
    /// Places on a map.
    pub const PLACES: usize = 10_000;
    /// Lanes on a map.
    pub const LANES: usize = 40_000;
    /// Corners of all walls together.
    pub(crate) const WALL_CORNERS: usize = 100_000;
    /// Levels of a building.
    pub(crate) const LEVELS: usize = 200;
    /// Doors on a map.
    pub(crate) const DOORS: usize = 10_000;
    /// Lifts on a map.
    pub(crate) const LIFTS: usize = 1_000;
    /// Absolute value of coordinates and lengths, in metres.
    pub(crate) const EXTENT_M: f64 = 100_000.0;
}

/// The content of a map file, not yet checked. A program that creates maps fills this and calls
/// [`MapFile::check`].
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MapFile {
    /// The map's name.
    pub name: String,
    /// Levels, from the lowest; default: a single level called [`super::DEFAULT_LEVEL`].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub levels: Vec<LevelEntry>,
    /// Walls of the first level, as polylines of (x, y) in metres.
    #[serde(default)]
    pub walls: Vec<Vec<(f64, f64)>>,
    /// The places.
    pub places: Vec<PlaceEntry>,
    /// The lanes between them.
    #[serde(default)]
    pub lanes: Vec<LaneEntry>,
    /// Automatic doors across lanes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub doors: Vec<DoorEntry>,
    /// Lifts between levels.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lifts: Vec<LiftEntry>,
}

/// A level in a map file.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LevelEntry {
    /// Its name.
    pub name: String,
    /// Elevation in metres.
    #[serde(default)]
    pub elevation_m: f64,
    /// Its walls, as polylines of (x, y) in metres.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub walls: Vec<Vec<(f64, f64)>>,
}

/// A place in a map file.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PlaceEntry {
    /// Its name.
    pub name: String,
    /// Purpose of the place.
    pub kind: PlaceKind,
    /// Metres to the east.
    pub x_m: f64,
    /// Metres to the north.
    pub y_m: f64,
    /// Heading of a robot at the place, in radians.
    #[serde(default)]
    pub yaw_rad: f64,
    /// Its level; default: the first level.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub level: Option<String>,
    /// Name by which drivers know the dock or the charger here; default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dock: Option<String>,
}

/// A lane in a map file.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LaneEntry {
    /// Its two ends.
    pub between: (String, String),
    /// Driving distance in metres; default: the straight line.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub length_m: Option<f64>,
    /// True if robots may drive only from the first end to the second.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub one_way: bool,
    /// Highest allowed speed, in metres per second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed_limit_mps: Option<f64>,
    /// Required heading of a robot that drives from the first end to the second. On the way back it
    /// keeps that heading.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub facing: Option<Facing>,
    /// Navigation graphs with this lane: a robot whose file names a graph drives on its lanes only. Default:
    /// the lane belongs to all graphs.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub graphs: BTreeSet<String>,
}

/// An automatic door in a map file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DoorEntry {
    /// Its name.
    pub name: String,
    /// The lanes through the door, each given by its two ends. None for a door that is only drawn: it has a
    /// `level` and a `span`.
    pub on: Vec<(String, String)>,
    /// Seconds from closed to open, and from open to closed.
    #[serde(default = "opening_s")]
    pub opening_s: f64,
    /// Its two posts, as (x, y) in metres; default: across the middle of each lane.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub span: Option<((f64, f64), (f64, f64))>,
    /// Level of a door without lanes. A door with lanes is on their level.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub level: Option<String>,
}

impl Default for DoorEntry {
    fn default() -> Self {
        DoorEntry { name: String::new(), on: Vec::new(), opening_s: opening_s(), span: None, level: None }
    }
}

/// A lift in a map file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LiftEntry {
    /// Its name.
    pub name: String,
    /// The places at its doors, on two or more levels.
    pub stops: Vec<String>,
    /// Number of robots in the cabin at the same time.
    #[serde(default = "capacity")]
    pub capacity: u32,
    /// Seconds from closed to open of its doors, and from open to closed.
    #[serde(default = "opening_s")]
    pub opening_s: f64,
    /// Speed of the cabin, in metres per second.
    #[serde(default = "speed_mps")]
    pub speed_mps: f64,
}

impl Default for LiftEntry {
    fn default() -> Self {
        LiftEntry {
            name: String::new(),
            stops: Vec::new(),
            capacity: capacity(),
            opening_s: opening_s(),
            speed_mps: speed_mps(),
        }
    }
}

/// Estimate: sliding doors of hospitals take 2 to 4 seconds.
fn opening_s() -> f64 {
    3.0
}

/// Default: a robot rides alone.
fn capacity() -> u32 {
    1
}

/// Estimate: lifts of low buildings move at 0.6 to 1 m/s.
fn speed_mps() -> f64 {
    1.0
}

impl MapFile {
    /// Returns the walls of all levels.
    pub(super) fn all_walls(&self) -> impl Iterator<Item = &Vec<(f64, f64)>> {
        self.walls.iter().chain(self.levels.iter().flat_map(|level| &level.walls))
    }
}
