//! The map file: its entries, its limits, and reading it.

use super::MapDiagnostic;
use super::check::check;
use super::drawing::Drawing;
use super::import::map_name_from_path;
use super::{Facing, Map, PlaceKind, drawio, rmf};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::Path;

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
    pub const WALL_CORNERS: usize = 100_000;
    /// Levels of a building.
    pub const LEVELS: usize = 200;
    /// Doors on a map.
    pub const DOORS: usize = 10_000;
    /// Lifts on a map.
    pub const LIFTS: usize = 1_000;
    /// Total size of the compressed pages of a drawing after inflating.
    pub const INFLATED_BYTES: usize = 32 << 20;
    /// Nodes of a page of a drawing: elements, and the texts between them. Each node takes about 50
    /// bytes.
    pub const XML_NODES: u32 = 1_000_000;
    /// Absolute value of coordinates and lengths, in metres.
    pub const EXTENT_M: f64 = 100_000.0;
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
}

/// An automatic door in a map file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DoorEntry {
    /// Its name.
    pub name: String,
    /// The lanes through the door, each given by its two ends.
    pub on: Vec<(String, String)>,
    /// Seconds from closed to open, and from open to closed.
    #[serde(default = "opening_s")]
    pub opening_s: f64,
    /// Its two posts, as (x, y) in metres; default: across the middle of each lane.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub span: Option<((f64, f64), (f64, f64))>,
}

impl Default for DoorEntry {
    fn default() -> Self {
        DoorEntry { name: String::new(), on: Vec::new(), opening_s: opening_s(), span: None }
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

/// A map could not be read. Common with files written by hand.
#[derive(Debug, thiserror::Error)]
pub enum MapError {
    /// The file cannot be read.
    #[error("map {file}: {source}")]
    Unreadable {
        /// The file as named.
        file: String,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The file is larger than [`limits::FILE_BYTES`].
    #[error("map {file}: {bytes} bytes are more than the {max} allowed", max = limits::FILE_BYTES)]
    TooLarge {
        /// The file as named.
        file: String,
        /// Its size.
        bytes: u64,
    },
    /// The text has another format.
    #[error("map {file}: {message}")]
    Syntax {
        /// The file as named.
        file: String,
        /// The message of the parser, with line and column.
        message: String,
    },
    /// The text has the right format but describes an invalid map.
    #[error("{}", join(file, diagnostics))]
    Invalid {
        /// The file as named.
        file: String,
        /// All errors, in the order of the file.
        diagnostics: Vec<MapDiagnostic>,
    },
    /// No shipped map has this name.
    #[error("no map {name:?} is shipped; there are: {known}", known = super::SHIPPED.join(", "))]
    NotShipped {
        /// The name as given.
        name: String,
    },
}

fn join(file: &str, diagnostics: &[MapDiagnostic]) -> String {
    diagnostics.iter().map(|error| format!("map {file}: {error}")).collect::<Vec<_>>().join("\n")
}

/// Reads a map from the text of a file. `file` names the file in errors; its ending gives the
/// format ([`MapFormat`]).
///
/// # Errors
/// [`MapError`] with all errors of the file.
pub fn read(text: &str, file: &str) -> Result<Map, MapError> {
    parse_drawing(text, file, &ImportOptions::default())?.map.check(file)
}

/// Format of a map file, given by the ending of its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MapFormat {
    /// The map format of this module as YAML: every other ending.
    Yaml,
    /// The map format of this module as JSON: `.json`.
    Json,
    /// A drawing of diagrams.net: `.drawio`, `.xml`.
    Drawing,
    /// A building of Open-RMF: `.building.yaml`, `.building.yml`.
    Building,
}

impl MapFormat {
    /// Returns the format of a file with this name.
    pub fn of(file: &str) -> MapFormat {
        let name = file.to_ascii_lowercase();
        let ends = |endings: &[&str]| endings.iter().any(|ending| name.ends_with(ending));
        if ends(&[".drawio", ".xml"]) {
            MapFormat::Drawing
        } else if ends(&[".building.yaml", ".building.yml"]) {
            MapFormat::Building
        } else if ends(&[".json"]) {
            MapFormat::Json
        } else {
            MapFormat::Yaml
        }
    }

    /// Checks whether the format is a drawing or an Open-RMF building.
    pub fn is_foreign(self) -> bool {
        matches!(self, MapFormat::Drawing | MapFormat::Building)
    }
}

/// Settings for content that a file does not define.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ImportOptions {
    /// Metres per unit of a drawing, or per pixel of an Open-RMF building; above 0. Default: the
    /// scale in the file, and for a drawing without scale [`drawio::METRES_PER_UNIT`].
    pub scale_m: Option<f64>,
    /// Navigation graph to read from an Open-RMF building. Default: the graph with the lowest
    /// number.
    pub graph: Option<i64>,
}

/// Reads a map and the items drawn on it from the text of a file. The map is not checked. The
/// ending of `file` gives the format, as in [`read`].
///
/// # Errors
/// [`MapError::TooLarge`] and [`MapError::Syntax`]; [`MapError::Invalid`] for errors in a drawing
/// or a building.
pub fn parse_drawing(text: &str, file: &str, options: &ImportOptions) -> Result<Drawing, MapError> {
    if text.len() > limits::FILE_BYTES {
        return Err(MapError::TooLarge { file: file.to_owned(), bytes: text.len() as u64 });
    }
    let syntax = |message: String| MapError::Syntax { file: file.to_owned(), message };
    let map: MapFile = match MapFormat::of(file) {
        MapFormat::Drawing => {
            return drawio::read(text, &map_name_from_path(file), options).map_err(|error| error.of(file));
        }
        MapFormat::Building => {
            return rmf::read(text, &map_name_from_path(file), options).map_err(|error| error.of(file));
        }
        MapFormat::Json => serde_json::from_str(text).map_err(|error| syntax(error.to_string()))?,
        MapFormat::Yaml => serde_saphyr::from_str(text).map_err(|error| syntax(error.to_string()))?,
    };
    Ok(Drawing { map, ..Drawing::default() })
}

/// Reads a map file.
///
/// # Errors
/// [`MapError`] with all errors of the file.
pub fn load(path: &Path) -> Result<Map, MapError> {
    load_drawing(path, &ImportOptions::default())?.map.check(&path.display().to_string())
}

/// Reads a map file and the items drawn on the map. The map is not checked.
///
/// # Errors
/// [`MapError::Unreadable`] and those of [`parse_drawing`].
pub fn load_drawing(path: &Path, options: &ImportOptions) -> Result<Drawing, MapError> {
    let file = path.display().to_string();
    let unreadable = |source| MapError::Unreadable { file: file.clone(), source };
    let bytes = std::fs::metadata(path).map_err(unreadable)?.len();
    if bytes > limits::FILE_BYTES as u64 {
        return Err(MapError::TooLarge { file, bytes });
    }
    parse_drawing(&std::fs::read_to_string(path).map_err(unreadable)?, &file, options)
}

impl MapFile {
    /// Checks the content of the file and builds the map. `file` names the file in errors.
    ///
    /// # Errors
    /// [`MapError::Invalid`] with all errors.
    pub fn check(&self, file: &str) -> Result<Map, MapError> {
        check(self).map_err(|diagnostics| MapError::Invalid { file: file.to_owned(), diagnostics })
    }

    /// Returns the walls of all levels.
    pub(super) fn all_walls(&self) -> impl Iterator<Item = &Vec<(f64, f64)>> {
        self.walls.iter().chain(self.levels.iter().flat_map(|level| &level.walls))
    }
}
