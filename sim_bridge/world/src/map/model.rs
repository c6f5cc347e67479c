//! The types of a valid map, and queries of its places and lanes.

use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_protocol::units::{Metres, MetresPerSecond, Seconds};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

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
    /// Name by which drivers know the dock or the charger at the place.
    pub dock: Option<String>,
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
    /// is the opposite heading relative to the lane.
    pub facing: Option<Facing>,
    /// Navigation graphs with this lane; empty: all of them.
    pub graphs: BTreeSet<String>,
}

impl Lane {
    /// Checks whether robots of a graph drive on the lane. A robot without a graph drives on all lanes.
    pub fn is_in(&self, graph: Option<&str>) -> bool {
        graph.is_none_or(|graph| self.graphs.is_empty() || self.graphs.contains(graph))
    }
}

/// Name of the only level of a map without levels.
pub const DEFAULT_LEVEL: &str = "ground";

/// Index of a level in [`Map::levels`]; the default is the first level.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LevelIndex(pub(crate) usize);

/// A level (storey) of the building.
#[derive(Debug, Clone, PartialEq)]
pub struct MapLevel {
    /// Its name, unique on the map.
    pub name: String,
    /// Metres above the lowest level, or above the zero height of the map.
    pub elevation_m: f64,
}

/// An automatic door across its lanes, or a door that is only drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct Door {
    /// Its name, unique among the doors.
    pub name: String,
    /// The lanes through the door, each given by its ends in the order of the lane; all on the same
    /// level. Empty for a door that is only drawn.
    pub lanes: Vec<(PlaceId, PlaceId)>,
    /// Time from closed to open, and from open to closed.
    pub opening: Seconds,
    /// The two posts, as (x, y) in metres. `None` if the map gives none; the door then stands in
    /// the middle of each lane.
    pub span: Option<((f64, f64), (f64, f64))>,
    /// Level of the door.
    pub level: LevelIndex,
}

/// A door on a lane, with its position in driving direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LaneDoor<'a> {
    /// The door.
    pub door: &'a Door,
    /// Position on the lane, from 0 (start) to 1 (end).
    pub at: f64,
}

/// A lift that connects places on two or more levels.
#[derive(Debug, Clone, PartialEq)]
pub struct Lift {
    /// Its name, unique among the lifts.
    pub name: String,
    /// The places at its doors; each place belongs to a single lift.
    pub stops: Vec<PlaceId>,
    /// Number of robots in the cabin at the same time.
    pub capacity: u32,
    /// Time from closed to open of its doors, and from open to closed.
    pub opening: Seconds,
    /// Vertical speed of the cabin.
    pub speed: MetresPerSecond,
}

/// A ride by lift.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LiftRide<'a> {
    /// The lift.
    pub lift: &'a Lift,
    /// Time from the closing of the doors at the first stop until they are open at the second.
    pub time: Seconds,
}

/// Heading of a robot on a lane, relative to the direction of the lane.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Facing {
    /// Robots face the direction of the lane.
    Forward,
    /// Robots face against the direction of the lane.
    Backward,
}

impl Facing {
    /// Returns the same heading relative to the opposite direction of the lane.
    pub(crate) fn reversed(self) -> Facing {
        match self {
            Facing::Forward => Facing::Backward,
            Facing::Backward => Facing::Forward,
        }
    }
}

/// Position of a place in [`Map::places`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct PlaceIndex(pub(super) usize);

/// A valid map. Built by [`MapFile::check`](super::MapFile::check).
#[derive(Debug, Clone, PartialEq)]
pub struct Map {
    pub(super) name: String,
    pub(super) levels: Vec<MapLevel>,
    pub(super) places: Vec<MapPlace>,
    pub(super) lanes: Vec<Lane>,
    pub(super) walls: Vec<Vec<(f64, f64)>>,
    /// Level of each wall.
    pub(super) wall_levels: Vec<LevelIndex>,
    pub(super) doors: Vec<Door>,
    pub(super) lifts: Vec<Lift>,
    pub(super) by_name: BTreeMap<PlaceId, PlaceIndex>,
    /// Lanes by start and end; a two-way lane has two entries.
    pub(super) by_ends: BTreeMap<(PlaceIndex, PlaceIndex), usize>,
    /// The doors of each lane, each with its position on the lane: 0 is the end `from`, 1 the end
    /// `to`.
    pub(super) doors_by_lane: BTreeMap<usize, Vec<(usize, f64)>>,
    /// Lift of each stop.
    pub(super) lift_of: BTreeMap<PlaceIndex, usize>,
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

    /// Returns the names of all navigation graphs. Empty if all robots drive on all lanes.
    pub fn graphs(&self) -> BTreeSet<&str> {
        self.lanes.iter().flat_map(|lane| &lane.graphs).map(String::as_str).collect()
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
