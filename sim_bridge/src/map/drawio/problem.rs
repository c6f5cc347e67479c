//! What can be wrong with a drawing.

use super::REACH;
use crate::map::PlaceKind;

/// One thing that is wrong with a drawing, and where.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("page {page:?}, cell {cell:?}: {wrong}")]
pub struct DrawioDiagnostic {
    /// The page, by its name.
    pub page: String,
    /// The cell, by its id: in diagrams.net it is shown by *Edit Data*.
    pub cell: String,
    /// What is wrong with it.
    pub wrong: CellError,
}

/// What can be wrong with a cell.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CellError {
    /// Two cells of one id on a page.
    #[error("this id stands more than once")]
    Duplicate,
    /// An attribute that must be a number and is none.
    #[error("{field} is {text:?}, allowed is {allowed}")]
    Number {
        /// The attribute.
        field: String,
        /// What it says.
        text: String,
        /// What it may say.
        allowed: &'static str,
    },
    /// Something that must be somewhere and is not.
    #[error("this {kind} has no place on the page: it must be a shape with a position and a size")]
    Nowhere {
        /// Its type.
        kind: String,
    },
    /// Something that must be a line and is none.
    #[error("this {kind} must be a line from one point to another")]
    NoLine {
        /// Its type.
        kind: String,
    },
    /// A path that begins or ends at nothing.
    #[error("its {end} is cell {id:?}, which is not on this page")]
    UnknownEnd {
        /// `source` or `target`.
        end: &'static str,
        /// The id as written.
        id: String,
    },
    /// A path that has one end only.
    #[error("this path has no {end}: it must begin and end at a point or a cell")]
    OpenEnd {
        /// `source` or `target`.
        end: &'static str,
    },
    /// A path on which nobody gets anywhere.
    #[error("this path has no length: all its points lie in one cell of the grid of {grid} units", grid = super::GRID)]
    NoLength,
    /// A place of a kind that there is not.
    #[error("kind is {text:?}, allowed are {allowed}{hint}")]
    Kind {
        /// What it says.
        text: String,
        /// The kinds there are.
        allowed: String,
        /// The kind probably meant, in words; may be empty.
        hint: String,
    },
    /// A component without JSON.
    #[error("component_{component} is no JSON: {reason}")]
    Component {
        /// Which component.
        component: String,
        /// What the parser says.
        reason: String,
    },
    /// Something without its name.
    #[error("this {kind} has no {field}")]
    Missing {
        /// Its type.
        kind: String,
        /// The attribute.
        field: &'static str,
    },
    /// A place beside all paths.
    #[error(
        "place {place:?} is off all paths: lead one there, or to within {reach} units of it without a wall between",
        reach = REACH
    )]
    OffPaths {
        /// The place.
        place: String,
    },
}

impl CellError {
    pub(super) fn kind(text: &str) -> CellError {
        let kinds = PlaceKind::ALL.map(PlaceKind::as_str);
        let hint = crate::suggest::did_you_mean(text, kinds);
        CellError::Kind { text: text.to_owned(), allowed: kinds.join(", "), hint }
    }
}
