//! Errors in a map.

use super::building_check::BuildingDiagnostic;
use super::file::limits;
use super::{drawio, rmf};
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
    /// A place is not connected with the rest of the map.
    #[error("place {:?} {disconnection} the rest of the map", place.as_str())]
    Disconnected {
        /// The place.
        place: PlaceId,
        /// The missing direction.
        disconnection: Disconnection,
    },
    /// An error in a level, a door or a lift.
    #[error("{0}")]
    Structure(#[from] BuildingDiagnostic),
    /// An error in a drawing.
    #[error("{0}")]
    Drawio(#[from] drawio::DrawioDiagnostic),
    /// An error in a building of Open-RMF.
    #[error("{0}")]
    RmfBuilding(#[from] rmf::RmfDiagnostic),
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
