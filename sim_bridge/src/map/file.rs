//! The file a map is read from.

use super::MapDiagnostic;
use super::check::check;
use super::drawing::Drawing;
use super::import::map_name_from_path;
use super::{Facing, Map, PlaceKind, drawio, rmf};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The most that a map file may hold. Ample for a hospital; they keep a wrong file from filling the memory.
pub mod limits {
    /// Bytes in a file.
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
    /// Bytes that the compressed pages of a drawing may come to, all together.
    pub const INFLATED_BYTES: usize = 32 << 20;
    /// Nodes of a page of a drawing: elements, and texts between them. Each takes some fifty bytes.
    pub const XML_NODES: u32 = 1_000_000;
    /// Coordinates and lengths, in metres either way.
    pub const EXTENT_M: f64 = 100_000.0;
}

/// A map as written, not yet checked. A program that makes maps of its own fills this and calls [`MapFile::check`].
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MapFile {
    /// The map's name.
    pub name: String,
    /// Levels, from the lowest; one called [`super::GROUND`] if none are given.
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

/// A level as written.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LevelEntry {
    /// Its name.
    pub name: String,
    /// How high it lies, in metres.
    #[serde(default)]
    pub elevation_m: f64,
    /// Its walls, as polylines of (x, y) in metres.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub walls: Vec<Vec<(f64, f64)>>,
}

/// A place as written.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PlaceEntry {
    /// Its name.
    pub name: String,
    /// What it is for.
    pub kind: PlaceKind,
    /// Metres to the east.
    pub x_m: f64,
    /// Metres to the north.
    pub y_m: f64,
    /// The heading a robot takes there, in radians.
    #[serde(default)]
    pub yaw_rad: f64,
    /// Its level; the first if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub level: Option<String>,
}

/// A lane as written.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LaneEntry {
    /// Its two ends.
    pub between: (String, String),
    /// How far it is to drive; the straight line if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub length_m: Option<f64>,
    /// Whether it may only be driven from the first end to the second.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub one_way: bool,
    /// The fastest that is allowed there, in metres per second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed_limit_mps: Option<f64>,
    /// Which way a robot must face while it drives from the first end to the second; back, it keeps that heading.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub facing: Option<Facing>,
}

/// An automatic door as written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DoorEntry {
    /// Its name.
    pub name: String,
    /// The lanes through it, each by its two ends.
    pub on: Vec<(String, String)>,
    /// Seconds from closed to open, and from open to closed.
    #[serde(default = "opening_s")]
    pub opening_s: f64,
    /// Its two posts, as (x, y) in metres; across the middle of each lane if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub span: Option<((f64, f64), (f64, f64))>,
}

impl Default for DoorEntry {
    fn default() -> Self {
        DoorEntry { name: String::new(), on: Vec::new(), opening_s: opening_s(), span: None }
    }
}

/// A lift as written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LiftEntry {
    /// Its name.
    pub name: String,
    /// The places where one steps in and out, on two levels or more.
    pub stops: Vec<String>,
    /// How many robots fit in.
    #[serde(default = "capacity")]
    pub capacity: u32,
    /// Seconds from closed to open of its doors, and from open to closed.
    #[serde(default = "opening_s")]
    pub opening_s: f64,
    /// How fast the cabin moves, in metres per second.
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

/// A guess: sliding doors of hospitals take two to four seconds.
fn opening_s() -> f64 {
    3.0
}

/// A robot rides alone unless told otherwise.
fn capacity() -> u32 {
    1
}

/// A guess: lifts of low buildings go at 0.6 to 1 m/s.
fn speed_mps() -> f64 {
    1.0
}

/// Why there is no map. Ordinary with hand-written files.
#[derive(Debug, thiserror::Error)]
pub enum MapError {
    /// The file cannot be read.
    #[error("map {file}: {source}")]
    Unreadable {
        /// The file as named.
        file: String,
        /// What the system says.
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
    /// The text is not of the map format.
    #[error("map {file}: {message}")]
    Syntax {
        /// The file as named.
        file: String,
        /// What the parser says, with line and column.
        message: String,
    },
    /// The text is of the format, and describes no sound map.
    #[error("{}", join(file, problems))]
    Invalid {
        /// The file as named.
        file: String,
        /// All that is wrong, in the order of the file.
        problems: Vec<MapDiagnostic>,
    },
    /// There is no map of this name in the program.
    #[error("no map {name:?} is shipped; there are: {known}", known = super::SHIPPED.join(", "))]
    NotShipped {
        /// The name as given.
        name: String,
    },
}

fn join(file: &str, problems: &[MapDiagnostic]) -> String {
    problems.iter().map(|problem| format!("map {file}: {problem}")).collect::<Vec<_>>().join("\n")
}

/// Reads a map from the text of a file; `file` names it in errors, and tells by its ending what it is ([`MapForm`]).
///
/// # Errors
/// [`MapError`] with all that is wrong.
pub fn read(text: &str, file: &str) -> Result<Map, MapError> {
    parse_drawing(text, file, &ImportOptions::default())?.map.check(file)
}

/// What a map file is, told by the ending of its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MapFormat {
    /// Our own form as YAML: whatever has no other ending.
    Yaml,
    /// Our own form as JSON: `.json`.
    Json,
    /// A drawing of diagrams.net: `.drawio`, `.xml`.
    Drawing,
    /// A building of Open-RMF: `.building.yaml`, `.building.yml`.
    Building,
}

impl MapFormat {
    /// The form of a file of this name.
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

    /// Whether it is none of our own forms.
    pub fn is_foreign(self) -> bool {
        matches!(self, MapFormat::Drawing | MapFormat::Building)
    }
}

/// How to read what a file leaves open.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ImportOptions {
    /// How many metres a unit of a drawing stands for, or a pixel of an Open-RMF building: a number above 0. Else the file
    /// says, or for a drawing it is [`drawio::METRES_PER_UNIT`].
    pub scale_m: Option<f64>,
    /// Which of the navigation graphs of an Open-RMF building is meant; else the one of the lowest number.
    pub graph: Option<i64>,
}

/// Reads a map, not yet checked, and what is drawn beside it; by the same endings as [`read`].
///
/// # Errors
/// [`MapError::TooLarge`] and [`MapError::Syntax`].
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
/// [`MapError`] with all that is wrong.
pub fn load(path: &Path) -> Result<Map, MapError> {
    load_drawing(path, &ImportOptions::default())?.map.check(&path.display().to_string())
}

/// Reads a map file, not yet checked, and what is drawn beside the map.
///
/// # Errors
/// [`MapError::Unreadable`], [`MapError::TooLarge`] and [`MapError::Syntax`].
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
    /// Checks what was written and makes a map of it; `file` names it in errors.
    ///
    /// # Errors
    /// [`MapError::Unsound`] with all that is wrong.
    pub fn check(&self, file: &str) -> Result<Map, MapError> {
        check(self).map_err(|problems| MapError::Invalid { file: file.to_owned(), problems })
    }

    /// The walls of all levels.
    pub(super) fn all_walls(&self) -> impl Iterator<Item = &Vec<(f64, f64)>> {
        self.walls.iter().chain(self.levels.iter().flat_map(|level| &level.walls))
    }
}
