//! Errors in a layout.

/// An error in a layout, and its position.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{at}: {error}")]
pub struct LifDiagnostic {
    /// Position: the file, or a layout, a node or an edge with its id.
    pub at: String,
    /// The error at this position.
    pub error: ElementError,
}

/// An error of an element of a layout.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ElementError {
    /// The version of the format is not supported.
    #[error("lifVersion is {version:?}, allowed: 1.0 and later versions 1.x")]
    Version {
        /// The version as written.
        version: String,
    },
    /// The file has no layouts, or no nodes.
    #[error("there are no {what}")]
    Empty {
        /// `layouts` or `nodes`.
        what: &'static str,
    },
    /// Two nodes have the same id.
    #[error("its nodeId is already the id of another node")]
    DuplicateNode,
    /// No layout of the file has this node.
    #[error("{field}: there is no node {node:?}{hint}")]
    UnknownNode {
        /// Field with the id.
        field: &'static str,
        /// The id as written.
        node: String,
        /// Suggestion of a node, in words; may be empty.
        hint: String,
    },
    /// An edge has no types of vehicles.
    #[error("vehicleTypeEdgeProperties is empty: no vehicle may use the edge; name the types of vehicles")]
    NoVehicleTypes,
}
