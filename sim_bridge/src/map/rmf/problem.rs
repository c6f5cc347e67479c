//! What can be wrong with a building of Open-RMF.

/// One thing that is wrong with a building, and where.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{at}: {wrong}")]
pub struct RmfDiagnostic {
    /// Where: the building, a level, or what is on it, by its number as the file counts (from 0).
    pub at: String,
    /// What is wrong there.
    pub wrong: EntryError,
}

/// What can be wrong there.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EntryError {
    /// An entry of another form than it must have.
    #[error("this is {text}, allowed is {allowed}")]
    Form {
        /// What stands there.
        text: String,
        /// What may stand there.
        allowed: &'static str,
    },
    /// A value that is none of those it may be.
    #[error("{field} is {text}, allowed is {allowed}")]
    Value {
        /// Of what.
        field: String,
        /// What stands there.
        text: String,
        /// What may stand there.
        allowed: &'static str,
    },
    /// A parameter that must be there.
    #[error("parameter {field} is missing")]
    Missing {
        /// The parameter.
        field: &'static str,
    },
    /// A vertex that the level does not have.
    #[error("there is no vertex {vertex}; {}", allowed(*.count))]
    UnknownVertex {
        /// Its number as written.
        vertex: i64,
        /// How many vertices the level has.
        count: usize,
    },
    /// A level that the building does not have.
    #[error("{field}: there is no level {level:?}{hint}")]
    UnknownLevel {
        /// What names it.
        field: &'static str,
        /// The name as written.
        level: String,
        /// The level probably meant, in words; may be empty.
        hint: String,
    },
    /// A lift that the building does not have.
    #[error("lift_cabin: there is no lift {lift:?}{hint}")]
    UnknownLift {
        /// The name as written.
        lift: String,
        /// The lift probably meant, in words; may be empty.
        hint: String,
    },
    /// Two vertices of one name on one level.
    #[error("its name {name:?} is that of vertex {other}, too")]
    SameName {
        /// The name.
        name: String,
        /// The other vertex.
        other: usize,
    },
    /// A building without levels.
    #[error("there are no levels")]
    NoLevels,
    /// A building without lanes.
    #[error("there are no lanes")]
    NoLanes,
    /// A graph without lanes.
    #[error("no lane is of graph {graph}; there are lanes of {known}")]
    UnknownGraph {
        /// The graph that was asked for.
        graph: i64,
        /// Those there are.
        known: String,
    },
    /// A reference level from which no scale can be had.
    #[error("it has no measurements, so a pixel has no length: measure something on it, or give a scale")]
    NoScale,
    /// A measurement that begins and ends at one point.
    #[error("both ends are one point, which measures nothing")]
    NoExtent,
    /// A level that cannot be laid over the reference level.
    #[error(
        "it has {shared} fiducial(s) in common with the reference level {reference:?}; needed are 2, apart from each other"
    )]
    Unplaced {
        /// The reference level.
        reference: String,
        /// How many fiducials they share.
        shared: usize,
    },
}

fn allowed(count: usize) -> String {
    match count {
        0 => "this level has none".to_owned(),
        count => format!("allowed are 0 to {}", count - 1),
    }
}
