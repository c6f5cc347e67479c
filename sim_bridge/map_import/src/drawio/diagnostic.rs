//! Errors in a drawing.

use super::conventions::{GRID, REACH};
use consort_world::map::PlaceKind;
use consort_world::suggest::did_you_mean;

/// An error in a drawing, and its position.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("page {page:?}, cell {cell:?}: {error}")]
pub struct DrawioDiagnostic {
    /// Name of the page.
    pub page: String,
    /// Id of the cell; diagrams.net shows it in *Edit Data*.
    pub cell: String,
    /// The error of the cell.
    pub error: CellError,
}

/// An error of a cell.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CellError {
    /// Two cells of a page have the same id.
    #[error("this id occurs more than once")]
    Duplicate,
    /// A numeric attribute is not a number, or out of range.
    #[error("{field} is {text:?}, allowed: {allowed}")]
    Number {
        /// The attribute.
        field: String,
        /// Its value as written.
        text: String,
        /// Allowed values.
        allowed: &'static str,
    },
    /// A cell that needs a position has none.
    #[error("this {kind} has no position on the page: it must be a shape with a position and a size")]
    NoPosition {
        /// Its type.
        kind: String,
    },
    /// A cell that must be a line is not a line.
    #[error("this {kind} must be a line from one point to another")]
    NotALine {
        /// Its type.
        kind: String,
    },
    /// An end of a path refers to a missing cell.
    #[error("its {end} is cell {id:?}, which is not on this page")]
    UnknownEnd {
        /// `source` or `target`.
        end: &'static str,
        /// The id as written.
        id: String,
    },
    /// A path has only a single end.
    #[error("this path has no {end}: it must begin and end at a point or a cell")]
    MissingEnd {
        /// `source` or `target`.
        end: &'static str,
    },
    /// All points of a path are in the same grid cell.
    #[error("this path has no length: all its points are in the same cell of the grid of {grid} units", grid = GRID)]
    ZeroLength,
    /// The kind of a place is not known.
    #[error("kind is {text:?}, allowed are {allowed}{hint}")]
    UnknownPlaceKind {
        /// The kind as written.
        text: String,
        /// The known kinds.
        allowed: String,
        /// Suggestion of a kind, in words; may be empty.
        hint: String,
    },
    /// The value of a component is not JSON.
    #[error("component_{component} is not JSON: {reason}")]
    Component {
        /// Name of the component.
        component: String,
        /// The message of the parser.
        reason: String,
    },
    /// An attribute is missing.
    #[error("this {kind} has no {field}")]
    Missing {
        /// Its type.
        kind: String,
        /// The attribute.
        field: &'static str,
    },
    /// A place is too far from all paths.
    #[error(
        "place {place:?} is too far from all paths: draw a path to it, or within {reach} units of it without a wall in between",
        reach = REACH
    )]
    TooFarFromPaths {
        /// The place.
        place: String,
    },
}

impl CellError {
    pub(super) fn unknown_place_kind(text: &str) -> CellError {
        let kinds = PlaceKind::ALL.map(PlaceKind::as_str);
        let hint = did_you_mean(text, kinds);
        CellError::UnknownPlaceKind { text: text.to_owned(), allowed: kinds.join(", "), hint }
    }
}
