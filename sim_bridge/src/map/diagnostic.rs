//! What can be wrong with a map.

use super::building_check::BuildingDiagnostic;
use super::file::limits;
use super::{drawio, rmf};
use consort_protocol::ids::{NameError, PlaceId};
use std::fmt;

/// One thing that is wrong with a map.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MapDiagnostic {
    /// The map's name is not one.
    #[error("{text:?} cannot name a map: allowed are 1 to 64 characters of A-Z, a-z, 0-9, `_`, `.` and `-`")]
    Name {
        /// The name as given.
        text: String,
    },
    /// More than [`limits`] allow.
    #[error("{count} {what} are more than the {max} allowed")]
    TooMany {
        /// Of what.
        what: &'static str,
        /// How many there are.
        count: usize,
        /// How many there may be.
        max: usize,
    },
    /// A map without places.
    #[error("there are no places")]
    Empty,
    /// The name of a place is not one.
    #[error("{0}")]
    PlaceName(#[from] NameError),
    /// Two places of one name.
    #[error("place {:?} stands more than once", place.as_str())]
    Duplicate {
        /// Its name.
        place: PlaceId,
    },
    /// A number of a place is infinite, not a number, or absurdly large.
    #[error("place {place:?}: {field} is {value}, allowed is a number from -{max} to {max}", max = limits::EXTENT_M)]
    Number {
        /// The place as written.
        place: String,
        /// The field.
        field: &'static str,
        /// The number.
        value: f64,
    },
    /// A corner of a wall is infinite, not a number, or absurdly large.
    #[error("wall {wall}: a corner is at ({x}, {y}), allowed are numbers from -{max} to {max}", max = limits::EXTENT_M)]
    Corner {
        /// Which wall, counted from 1.
        wall: usize,
        /// Metres to the east.
        x: f64,
        /// Metres to the north.
        y: f64,
    },
    /// A lane to a place that is not on the map.
    #[error("lane {lane}: there is no place {place:?}{hint}")]
    UnknownPlace {
        /// The lane.
        lane: LaneName,
        /// The name as written.
        place: String,
        /// The place probably meant, in words; may be empty.
        hint: String,
    },
    /// A lane from a place to itself.
    #[error("lane {lane}: both ends are one place")]
    Loop {
        /// The lane.
        lane: LaneName,
    },
    /// A lane without length, or with one that is no length.
    #[error("lane {lane}: length is {length_m} m, allowed is a number above 0 and up to {max}", max = limits::EXTENT_M)]
    Length {
        /// The lane.
        lane: LaneName,
        /// Its length as written or measured.
        length_m: f64,
    },
    /// A lane shorter than the straight line between its ends.
    #[error("lane {lane}: {length_m} m are less than the straight line of {straight_m:.3} m")]
    TooShort {
        /// The lane.
        lane: LaneName,
        /// Its length as written.
        length_m: f64,
        /// The distance of its ends.
        straight_m: f64,
    },
    /// Two lanes for one way.
    #[error("lane {lane} stands more than once")]
    DuplicateLane {
        /// The lane.
        lane: LaneName,
    },
    /// A place without a way to or from the rest of the map.
    #[error("place {:?} {how} the rest of the map", place.as_str())]
    CutOff {
        /// The place.
        place: PlaceId,
        /// Which way is missing.
        how: Disconnection,
    },
    /// A level, a door or a lift is not as it should be.
    #[error("{0}")]
    Structure(#[from] BuildingDiagnostic),
    /// A drawing says what cannot be.
    #[error("{0}")]
    Drawio(#[from] drawio::DrawioDiagnostic),
    /// A building of Open-RMF says what cannot be.
    #[error("{0}")]
    Building(#[from] rmf::RmfDiagnostic),
}

/// A lane by its ends as written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LaneName(pub String, pub String);

impl fmt::Display for LaneName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "between {:?} and {:?}", self.0, self.1)
    }
}

/// How a place is cut off from the others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Disconnection {
    /// No way there and none back.
    Isolated,
    /// One-way lanes lead away only.
    Unreachable,
    /// One-way lanes lead there only.
    DeadEnd,
}

impl fmt::Display for Disconnection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Disconnection::Isolated => "is cut off from",
            Disconnection::Unreachable => "cannot be reached from",
            Disconnection::DeadEnd => "cannot be left for",
        })
    }
}
