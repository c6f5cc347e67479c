//! The map of a building: places, the lanes between them, doors, lifts, levels and walls.
//!
//! A map file is YAML, or JSON if its name ends in `.json`. Unknown fields are rejected.
//!
//! ```yaml
//! name: ward                    # 1 to 64 characters of A-Z a-z 0-9 _ . -
//! levels:                       # optional; default: a single level called ground
//!   - { name: ground }          # elevation_m defaults to 0
//!   - { name: first, elevation_m: 4.0, walls: [[[0, 0], [12, 0]]] }
//! walls:                        # optional, of the first level: open polylines of [x, y] in metres
//!   - [[0, 0], [12, 0], [12, 6]]
//! places:                       # x east, y north, in metres; yaw counter-clockwise from east; default level: the first
//!   - { name: Ward Corridor, kind: corridor, x_m: 2.0, y_m: 3.0 }
//!   - { name: Room 1, kind: room, x_m: 2.0, y_m: 5.0, yaw_rad: 1.57 }
//!   - { name: Hall, kind: corridor, x_m: 2.0, y_m: 3.0, level: first }
//! lanes:                        # where robots may drive; default: two-way, as long as the straight line
//!   - { between: [Ward Corridor, Room 1] }
//!   # - { between: [A, B], length_m: 3.5, one_way: true }            (only from A to B)
//!   # - { between: [A, B], speed_limit_mps: 0.5, facing: backward }  (facing: while driving from A to B)
//! doors:                        # optional: automatic doors, with the lanes through them
//!   - { name: Door 1, on: [[Ward Corridor, Room 1]], opening_s: 3.0 }
//!   # span: [[x, y], [x, y]] gives the two posts; without it the door stands in the middle of its lane
//! lifts:                        # optional: a robot that enters at a stop may leave at any other stop
//!   - { name: Lift A, stops: [Ward Corridor, Hall], capacity: 1, opening_s: 3.0, speed_mps: 1.0 }
//! ```
//!
//! The kinds of place are `room`, `lab`, `corridor`, `dock`, `charger` and `other`. The opening
//! times, the capacity and the speed in the example are the defaults. Reading a file reports *all*
//! its errors, each with the file and the position; an existing [`Map`] is valid: every place can
//! be reached from every other place, by lanes and lifts.
//!
//! Two foreign formats are read as well: drawings (`.drawio`, `.xml`: see [`drawio`]) and buildings
//! of Open-RMF (`.building.yaml`: see [`rmf`]). [`Drawing`] holds their content that is not part of
//! a map. [`render`] draws a map of any format.

mod building;
mod building_check;
#[cfg(test)]
mod building_tests;
mod check;
mod connectivity;
mod diagnostic;
mod drawing;
pub mod drawio;
mod file;
mod import;
mod map_json;
#[cfg(test)]
mod nesting_tests;
pub mod render;
pub mod rmf;
mod shipped;
#[cfg(test)]
mod tests;
mod topology;

pub use building::{DEFAULT_LEVEL, Door, Facing, LaneDoor, LevelIndex, Lift, LiftRide, MapLevel};
pub use building_check::BuildingDiagnostic;
pub use diagnostic::{Disconnection, LaneName, MapDiagnostic};
pub use drawing::{Drawing, DrawnItem, DrawnObject, DrawnPerson, DrawnRobot};
pub use file::{
    DoorEntry, ImportOptions, LaneEntry, LevelEntry, LiftEntry, MapError, MapFile, MapFormat, PlaceEntry, limits, load,
    load_drawing, parse_drawing, read,
};
pub use shipped::{SHIPPED, shipped, shipped_drawing};

use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_protocol::units::{Metres, MetresPerSecond};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Purpose of a place.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum PlaceKind {
    /// A room with patients and nurses.
    Room,
    /// A laboratory, the destination of samples.
    Lab,
    /// A point on the way.
    Corridor,
    /// A resting position of a robot.
    Dock,
    /// A charging station.
    Charger,
    /// Any other purpose.
    #[default]
    Other,
}

impl PlaceKind {
    /// All kinds.
    pub const ALL: [PlaceKind; 6] =
        [PlaceKind::Room, PlaceKind::Lab, PlaceKind::Corridor, PlaceKind::Dock, PlaceKind::Charger, PlaceKind::Other];

    /// Returns the name used in files.
    pub fn as_str(self) -> &'static str {
        match self {
            PlaceKind::Room => "room",
            PlaceKind::Lab => "lab",
            PlaceKind::Corridor => "corridor",
            PlaceKind::Dock => "dock",
            PlaceKind::Charger => "charger",
            PlaceKind::Other => "other",
        }
    }

    /// Returns the kind with this name.
    pub fn named(name: &str) -> Option<PlaceKind> {
        PlaceKind::ALL.into_iter().find(|kind| kind.as_str() == name)
    }
}

/// A named pose on a level.
#[derive(Debug, Clone, PartialEq)]
pub struct MapPlace {
    /// Its name, unique on the map.
    pub id: PlaceId,
    /// Purpose of the place.
    pub kind: PlaceKind,
    /// Position, and the heading that a robot takes there.
    pub pose: Pose,
    /// Level of the place.
    pub level: LevelIndex,
}

/// A straight connection of two places on which robots drive.
#[derive(Debug, Clone, PartialEq)]
pub struct Lane {
    /// First end.
    pub from: PlaceId,
    /// Second end.
    pub to: PlaceId,
    /// Driving distance; never zero, never less than the straight line.
    pub length: Metres,
    /// True if robots may also drive from `to` to `from`.
    pub two_way: bool,
    /// Highest allowed speed; `None`: limited by the robot only.
    pub speed_limit: Option<MetresPerSecond>,
    /// Required heading of a robot that drives from `from` to `to`, if any. From `to` to `from` it
    /// is [`Facing::reversed`].
    pub facing: Option<Facing>,
}

/// Position of a place in [`Map::places`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct PlaceIndex(pub(crate) usize);

/// A valid map. Built by [`read`], [`load`], [`shipped`] or [`MapFile::check`].
#[derive(Debug, Clone, PartialEq)]
pub struct Map {
    name: String,
    levels: Vec<MapLevel>,
    places: Vec<MapPlace>,
    lanes: Vec<Lane>,
    walls: Vec<Vec<(f64, f64)>>,
    /// Level of each wall.
    wall_levels: Vec<LevelIndex>,
    doors: Vec<Door>,
    lifts: Vec<Lift>,
    by_name: BTreeMap<PlaceId, PlaceIndex>,
    /// Lanes by start and end; a two-way lane has two entries.
    by_ends: BTreeMap<(PlaceIndex, PlaceIndex), usize>,
    /// The doors of each lane, each with its position on the lane: 0 is the end `from`, 1 the end
    /// `to`.
    doors_by_lane: BTreeMap<usize, Vec<(usize, f64)>>,
    /// Lift of each stop.
    lift_of: BTreeMap<PlaceIndex, usize>,
}

impl Map {
    /// Returns the name of the map.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns all places, in the order of the file. Never empty.
    pub fn places(&self) -> &[MapPlace] {
        &self.places
    }

    /// Returns all lanes, in the order of the file.
    pub fn lanes(&self) -> &[Lane] {
        &self.lanes
    }

    /// Returns the walls of all levels as polylines of (x, y) in metres.
    pub fn walls(&self) -> &[Vec<(f64, f64)>] {
        &self.walls
    }

    /// Returns the place with this name.
    pub fn place(&self, id: &PlaceId) -> Option<&MapPlace> {
        self.by_name.get(id).map(|index| &self.places[index.0])
    }

    /// Returns the lane on which a robot may drive from `from` to `to`.
    pub fn lane(&self, from: &PlaceId, to: &PlaceId) -> Option<&Lane> {
        let ends = (self.index(from)?, self.index(to)?);
        self.by_ends.get(&ends).map(|lane| &self.lanes[*lane])
    }

    /// Returns the smallest rectangle around all places and walls: (least x, least y) and (greatest
    /// x, greatest y) in metres.
    pub fn bounds(&self) -> ((f64, f64), (f64, f64)) {
        let places = self.places.iter().map(|place| (place.pose.x, place.pose.y));
        let corners = self.walls.iter().flatten().copied();
        places.chain(corners).fold(
            ((f64::INFINITY, f64::INFINITY), (f64::NEG_INFINITY, f64::NEG_INFINITY)),
            |((x0, y0), (x1, y1)), (x, y)| ((x0.min(x), y0.min(y)), (x1.max(x), y1.max(y))),
        )
    }

    pub(crate) fn index(&self, id: &PlaceId) -> Option<PlaceIndex> {
        self.by_name.get(id).copied()
    }

    pub(crate) fn place_at(&self, index: PlaceIndex) -> &MapPlace {
        &self.places[index.0]
    }

    pub(crate) fn lane_between(&self, from: PlaceIndex, to: PlaceIndex) -> Option<&Lane> {
        self.by_ends.get(&(from, to)).map(|lane| &self.lanes[*lane])
    }

    /// Returns `; did you mean "…"?` for a place name that is not on the map.
    pub fn suggest(&self, id: &PlaceId) -> String {
        crate::suggest::did_you_mean(id.as_str(), self.places.iter().map(|place| place.id.as_str()))
    }
}
