//! Errors in a building of Open-RMF.

/// An error in a building, and its position.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{at}: {error}")]
pub struct RmfDiagnostic {
    /// Position: the building, a level, or an entry with its number in the file (from 0).
    pub at: String,
    /// The error at this position.
    pub error: EntryError,
}

/// An error of an entry of the building.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EntryError {
    /// An entry has the wrong form.
    #[error("this is {text}, allowed: {allowed}")]
    Malformed {
        /// The entry as written.
        text: String,
        /// Allowed form.
        allowed: &'static str,
    },
    /// A value is not allowed.
    #[error("{field} is {text}, allowed: {allowed}")]
    InvalidValue {
        /// Name of the field.
        field: String,
        /// The value as written.
        text: String,
        /// Allowed values.
        allowed: &'static str,
    },
    /// A required parameter is missing.
    #[error("parameter {field} is missing")]
    Missing {
        /// The parameter.
        field: &'static str,
    },
    /// The level has no such vertex.
    #[error("there is no vertex {vertex}; {}", allowed(*.count))]
    UnknownVertex {
        /// Number of the vertex as written.
        vertex: i64,
        /// Number of vertices of the level.
        count: usize,
    },
    /// The building has no such level.
    #[error("{field}: there is no level {level:?}{hint}")]
    UnknownLevel {
        /// Field with the name of the level.
        field: &'static str,
        /// The name as written.
        level: String,
        /// Suggestion of a level name, in words; may be empty.
        hint: String,
    },
    /// The building has no such lift.
    #[error("lift_cabin: there is no lift {lift:?}{hint}")]
    UnknownLift {
        /// The name as written.
        lift: String,
        /// Suggestion of a lift name, in words; may be empty.
        hint: String,
    },
    /// Two vertices of a level have the same name.
    #[error("its name {name:?} is already the name of vertex {other}")]
    DuplicateName {
        /// The name.
        name: String,
        /// The other vertex.
        other: usize,
    },
    /// The building has no levels.
    #[error("the building has no levels")]
    NoLevels,
    /// The building has no lanes.
    #[error("the building has no lanes")]
    NoLanes,
    /// The graph has no lanes.
    #[error("graph {graph} has no lanes; graphs with lanes: {known}")]
    UnknownGraph {
        /// The requested graph.
        graph: i64,
        /// The graphs with lanes.
        known: String,
    },
    /// The reference level has no measurements, so the scale is unknown.
    #[error("it has no measurements, so the scale is unknown: add a measurement, or give a scale")]
    NoMeasurements,
    /// A measurement begins and ends at the same point.
    #[error("both ends are the same point: measure between two points")]
    ZeroLength,
    /// A level cannot be aligned with the reference level.
    #[error(
        "it has {shared} fiducial(s) in common with the reference level {reference:?}; needed: 2 at different points"
    )]
    NotAligned {
        /// The reference level.
        reference: String,
        /// Number of common fiducials.
        shared: usize,
    },
}

fn allowed(count: usize) -> String {
    match count {
        0 => "this level has no vertices".to_owned(),
        count => format!("allowed are 0 to {}", count - 1),
    }
}
