//! The floor: places, the lanes between them, doors, lifts, levels, and walls.
//!
//! A map file is YAML, or JSON where its name ends in `.json`; unknown fields are refused.
//!
//! ```yaml
//! name: ward                    # 1 to 64 characters of A-Z a-z 0-9 _ . -
//! levels:                       # optional; one level called ground if there are none
//!   - { name: ground }          # elevation_m is 0 unless told otherwise
//!   - { name: first, elevation_m: 4.0, walls: [[[0, 0], [12, 0]]] }
//! walls:                        # optional, of the first level: open polylines of [x, y] in metres
//!   - [[0, 0], [12, 0], [12, 6]]
//! places:                       # x east, y north, in metres; yaw counter-clockwise from east; on the first level
//!   - { name: Ward Corridor, kind: corridor, x_m: 2.0, y_m: 3.0 }
//!   - { name: Room 1, kind: room, x_m: 2.0, y_m: 5.0, yaw_rad: 1.57 }
//!   - { name: Hall, kind: corridor, x_m: 2.0, y_m: 3.0, level: first }
//! lanes:                        # where one may drive; two-way and as long as the straight line unless told otherwise
//!   - { between: [Ward Corridor, Room 1] }
//!   # - { between: [A, B], length_m: 3.5, one_way: true }            (only from A to B)
//!   # - { between: [A, B], speed_limit_mps: 0.5, facing: backward }  (facing: while going from A to B)
//! doors:                        # optional: automatic doors, by the lanes through them
//!   - { name: Door 1, on: [[Ward Corridor, Room 1]], opening_s: 3.0 }
//!   # span: [[x, y], [x, y]] gives the posts; without it the door stands in the middle of its lane
//! lifts:                        # optional: who steps in at one stop steps out at another
//!   - { name: Lift A, stops: [Ward Corridor, Hall], capacity: 1, opening_s: 3.0, speed_mps: 1.0 }
//! ```
//!
//! Kinds of place are `room`, `lab`, `corridor`, `dock`, `charger` and `other`. Opening times, capacity and speed of a
//! lift are those above unless given. Reading a file reports *all* that is wrong with it, with the file and the place;
//! a [`Map`] that exists is sound: every place can be reached from every other, by lanes and lifts.
//!
//! Drawings (`.drawio`, `.xml`: see [`drawio`]) and buildings of Open-RMF (`.building.yaml`: see [`rmf`]) are read too;
//! what they hold beside a map is in [`Drawing`]. [`show`] draws any of them.

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

/// What a place is for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum PlaceKind {
    /// Where patients and nurses are.
    Room,
    /// Where samples are brought.
    Lab,
    /// On the way.
    Corridor,
    /// Where robots rest.
    Dock,
    /// Where robots fill their batteries.
    Charger,
    /// Anything else.
    #[default]
    Other,
}

impl PlaceKind {
    /// All kinds.
    pub const ALL: [PlaceKind; 6] =
        [PlaceKind::Room, PlaceKind::Lab, PlaceKind::Corridor, PlaceKind::Dock, PlaceKind::Charger, PlaceKind::Other];

    /// Its name in files.
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

    /// The kind of this name.
    pub fn named(name: &str) -> Option<PlaceKind> {
        PlaceKind::ALL.into_iter().find(|kind| kind.as_str() == name)
    }
}

/// A named pose on the floor.
#[derive(Debug, Clone, PartialEq)]
pub struct MapPlace {
    /// Its name, unique on the map.
    pub id: PlaceId,
    /// What it is for.
    pub kind: PlaceKind,
    /// Where it is, and the heading a robot takes there.
    pub pose: Pose,
    /// The level it is on.
    pub level: LevelIndex,
}

/// A stretch of floor between two places that robots drive in a straight line.
#[derive(Debug, Clone, PartialEq)]
pub struct Lane {
    /// One end.
    pub from: PlaceId,
    /// The other end.
    pub to: PlaceId,
    /// How far it is to drive; never zero, never less than the straight line.
    pub length: Metres,
    /// Whether it may also be driven from `to` to `from`.
    pub two_way: bool,
    /// The fastest that is allowed there; none if robots may drive as they can.
    pub speed_limit: Option<MetresPerSecond>,
    /// Which way a robot must face while it drives from `from` to `to`, if that matters; from `to` to `from` it is
    /// [`Facing::reversed`].
    pub facing: Option<Facing>,
}

/// Position of a place in [`Map::places`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct PlaceIndex(pub(crate) usize);

/// A sound map. Made by [`read`], [`load`], [`shipped`] or [`MapFile::check`].
#[derive(Debug, Clone, PartialEq)]
pub struct Map {
    name: String,
    levels: Vec<MapLevel>,
    places: Vec<MapPlace>,
    lanes: Vec<Lane>,
    walls: Vec<Vec<(f64, f64)>>,
    /// For each wall its level.
    wall_levels: Vec<LevelIndex>,
    doors: Vec<Door>,
    lifts: Vec<Lift>,
    by_name: BTreeMap<PlaceId, PlaceIndex>,
    /// By start and end, each two-way lane twice.
    by_ends: BTreeMap<(PlaceIndex, PlaceIndex), usize>,
    /// For each lane its doors, each with the share of the lane, from its `from`, at which it stands.
    doors_by_lane: BTreeMap<usize, Vec<(usize, f64)>>,
    /// For each stop its lift.
    lift_of: BTreeMap<PlaceIndex, usize>,
}

impl Map {
    /// The map's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// All places, in the order of the file. Never empty.
    pub fn places(&self) -> &[MapPlace] {
        &self.places
    }

    /// All lanes, in the order of the file.
    pub fn lanes(&self) -> &[Lane] {
        &self.lanes
    }

    /// Walls of all levels as polylines of (x, y) in metres.
    pub fn walls(&self) -> &[Vec<(f64, f64)>] {
        &self.walls
    }

    /// The place of this name.
    pub fn place(&self, id: &PlaceId) -> Option<&MapPlace> {
        self.by_name.get(id).map(|index| &self.places[index.0])
    }

    /// The lane that may be driven from one place to the other.
    pub fn lane(&self, from: &PlaceId, to: &PlaceId) -> Option<&Lane> {
        let ends = (self.index(from)?, self.index(to)?);
        self.by_ends.get(&ends).map(|lane| &self.lanes[*lane])
    }

    /// The smallest rectangle that holds places and walls: (least x, least y) and (greatest x, greatest y) in metres.
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

    /// `; did you mean "…"?` for a place that is not here.
    pub(crate) fn suggest(&self, id: &PlaceId) -> String {
        crate::suggest::did_you_mean(id.as_str(), self.places.iter().map(|place| place.id.as_str()))
    }
}
