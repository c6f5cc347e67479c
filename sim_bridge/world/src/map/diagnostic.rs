//! Errors in a map.

use super::file::limits;
use consort_protocol::ids::{NameError, PlaceId};
use std::fmt;

/// An error in a map.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MapDiagnostic {
    /// The name of the map is not allowed.
    #[error("{text:?} is not a name for a map: allowed are 1 to 64 characters of A-Z, a-z, 0-9, `_`, `.` and `-`")]
    Name {
        /// The name as given.
        text: String,
    },
    /// The map exceeds [`limits`].
    #[error("{count} {what} are more than the {max} allowed")]
    TooMany {
        /// Kind of the counted items.
        what: &'static str,
        /// Number of items.
        count: usize,
        /// Greatest allowed number.
        max: usize,
    },
    /// The map has no places.
    #[error("the map has no places")]
    Empty,
    /// The name of a place is not allowed.
    #[error("{0}")]
    PlaceName(#[from] NameError),
    /// Two places have the same name.
    #[error("place {:?} occurs more than once", place.as_str())]
    Duplicate {
        /// Its name.
        place: PlaceId,
    },
    /// A number of a place is infinite, not a number, or too large.
    #[error("place {place:?}: {field} is {value}, allowed: a number from -{max} to {max}", max = limits::EXTENT_M)]
    Number {
        /// The place as written.
        place: String,
        /// The field.
        field: &'static str,
        /// The number.
        value: f64,
    },
    /// A corner of a wall is infinite, not a number, or too large.
    #[error("wall {wall}: a corner is at ({x}, {y}), allowed: numbers from -{max} to {max}", max = limits::EXTENT_M)]
    Corner {
        /// Number of the wall, counted from 1.
        wall: usize,
        /// Metres to the east.
        x: f64,
        /// Metres to the north.
        y: f64,
    },
    /// An end of a lane is not on the map.
    #[error("lane {lane}: there is no place {place:?}{hint}")]
    UnknownPlace {
        /// The lane.
        lane: LaneName,
        /// The name as written.
        place: String,
        /// Suggestion of a place name, in words; may be empty.
        hint: String,
    },
    /// A lane connects a place with itself.
    #[error("lane {lane}: both ends are the same place")]
    Loop {
        /// The lane.
        lane: LaneName,
    },
    /// The length of a lane is zero or not allowed.
    #[error("lane {lane}: length is {length_m} m, allowed: a number above 0 and up to {max}", max = limits::EXTENT_M)]
    Length {
        /// The lane.
        lane: LaneName,
        /// Its length as written or measured.
        length_m: f64,
    },
    /// A lane is shorter than the straight line between its ends.
    #[error("lane {lane}: {length_m} m are less than the straight line of {straight_m:.3} m")]
    TooShort {
        /// The lane.
        lane: LaneName,
        /// Its length as written.
        length_m: f64,
        /// Distance of its ends.
        straight_m: f64,
    },
    /// Two lanes connect the same places.
    #[error("lane {lane} occurs more than once")]
    DuplicateLane {
        /// The lane.
        lane: LaneName,
    },
    /// A place is not connected with the rest of the map, or of a navigation graph.
    #[error("place {:?} {disconnection} the rest of {}", place.as_str(), part(.graph.as_ref()))]
    Disconnected {
        /// The place.
        place: PlaceId,
        /// The missing direction.
        disconnection: Disconnection,
        /// The graph on which it is missing, if the map has several.
        graph: Option<String>,
    },
    /// An error in a level, a door or a lift.
    #[error("{0}")]
    Structure(#[from] BuildingDiagnostic),
}

fn part(graph: Option<&String>) -> String {
    graph.map_or_else(|| "the map".to_owned(), |graph| format!("graph {graph:?}"))
}

/// An error in a level, a door or a lift.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BuildingDiagnostic {
    /// The name of a level, door or lift is not allowed.
    #[error(
        "{text:?} is not a name for a {what}: allowed are 1 to 64 characters, no control characters, no space at either end"
    )]
    Name {
        /// `level`, `door` or `lift`.
        what: &'static str,
        /// The name as given.
        text: String,
    },
    /// Two levels, doors or lifts have the same name.
    #[error("{what} {name:?} occurs more than once")]
    Duplicate {
        /// `level`, `door` or `lift`.
        what: &'static str,
        /// Its name.
        name: String,
    },
    /// A number is infinite, not a number, or out of range.
    #[error("{what} {name:?}: {field} is {value}, allowed: a number from {min} to {max}")]
    Number {
        /// `level`, `door` or `lift`.
        what: &'static str,
        /// Its name.
        name: String,
        /// The field.
        field: &'static str,
        /// The number.
        value: f64,
        /// Smallest allowed value.
        min: f64,
        /// Greatest allowed value.
        max: f64,
    },
    /// The level of a place or a door does not exist.
    #[error("{what} {name:?}: there is no level {level:?}{hint}")]
    UnknownLevel {
        /// `place` or `door`.
        what: &'static str,
        /// The place or the door.
        name: String,
        /// The name as written.
        level: String,
        /// Suggestion of a level name, in words; may be empty.
        hint: String,
    },
    /// A lane connects two levels.
    #[error("lane {lane}: its ends are on levels {from:?} and {to:?}; only lifts connect levels")]
    LaneAcrossLevels {
        /// The lane.
        lane: LaneName,
        /// Level of the first end.
        from: String,
        /// Level of the second end.
        to: String,
    },
    /// A speed limit is not allowed.
    #[error("lane {lane}: speed limit is {value} m/s, allowed: a number above 0")]
    SpeedLimit {
        /// The lane.
        lane: LaneName,
        /// The number.
        value: f64,
    },
    /// A door has no lanes.
    #[error("door {door:?} has no lanes: add the lanes through it")]
    DoorOnNoLane {
        /// The door.
        door: String,
    },
    /// A lane of a door does not exist.
    #[error("door {door:?}: there is no lane {lane}{hint}")]
    UnknownLane {
        /// The door.
        door: String,
        /// The lane as written.
        lane: LaneName,
        /// Suggestion, in words; may be empty.
        hint: String,
    },
    /// The lanes of a door are on several levels.
    #[error("door {door:?} has lanes on several levels; allowed: lanes on the same level")]
    DoorAcrossLevels {
        /// The door.
        door: String,
    },
    /// A lane of a door does not pass between its posts.
    #[error("door {door:?}: lane {lane} does not pass between its posts")]
    DoorMissesLane {
        /// The door.
        door: String,
        /// The lane.
        lane: LaneName,
    },
    /// A stop of a lift does not exist.
    #[error("lift {lift:?}: there is no place {place:?}{hint}")]
    UnknownStop {
        /// The lift.
        lift: String,
        /// The name as written.
        place: String,
        /// Suggestion of a place name, in words; may be empty.
        hint: String,
    },
    /// A place is a stop of two lifts, or twice a stop of the same lift.
    #[error("lift {lift:?}: place {place:?} is a stop of lift {other:?} already")]
    StopOfAnotherLift {
        /// The lift.
        lift: String,
        /// The place.
        place: String,
        /// The other lift with this stop.
        other: String,
    },
    /// All stops of a lift are on the same level.
    #[error("lift {lift:?} has stops on {levels} level(s), needed: 2 or more")]
    SingleLevelLift {
        /// The lift.
        lift: String,
        /// Number of levels with a stop.
        levels: usize,
    },
    /// A lift has room for no robot.
    #[error("lift {lift:?}: capacity is 0, allowed: a number of robots from 1")]
    ZeroCapacity {
        /// The lift.
        lift: String,
    },
}

/// The ends of a lane as written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LaneName(pub String, pub String);

impl fmt::Display for LaneName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "between {:?} and {:?}", self.0, self.1)
    }
}

/// Missing connection of a place with the rest of the map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Disconnection {
    /// No lane leads to the place or away from it.
    Isolated,
    /// All lanes of the place lead away from it.
    Unreachable,
    /// All lanes of the place lead to it.
    DeadEnd,
}

impl fmt::Display for Disconnection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Disconnection::Isolated => "is not connected with",
            Disconnection::Unreachable => "cannot be reached from",
            Disconnection::DeadEnd => "cannot be left for",
        })
    }
}
