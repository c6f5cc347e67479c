//! Why a description is not a tree.

use super::blackboard::BlackboardError;
use super::value::{PortType, ValueError};
use std::fmt;

/// What is wrong with a description, and where. Ordinary in hand-edited files; nothing was built.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TreeError {
    /// The file, or the name given instead.
    pub source: String,
    /// The line, counted from 1, where it was read from a file.
    pub line: Option<u32>,
    /// The tree and the node, where it is about one.
    pub node: Option<String>,
    /// What is wrong, and what is allowed.
    pub kind: Box<TreeErrorKind>,
}

impl fmt::Display for TreeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.source)?;
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
        }
        if let Some(node) = &self.node {
            write!(f, ": {node}")?;
        }
        write!(f, ": {}", self.kind)
    }
}

impl std::error::Error for TreeError {}

/// The kinds of mistake in a description.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TreeErrorKind {
    /// The text is not XML, or not a tree file.
    #[error("{0}")]
    Syntax(String),
    /// No such kind of node.
    #[error("there is no node `{id}`; known are {known}")]
    UnknownNode {
        /// The kind as written.
        id: String,
        /// What there is, in words.
        known: String,
    },
    /// The explicit form names another kind than the node is.
    #[error("`{id}` is written as <{written}>, but is of kind <{is}>")]
    WrongKind {
        /// The node.
        id: String,
        /// The tag in the file.
        written: &'static str,
        /// What the registry says.
        is: &'static str,
    },
    /// No such tree.
    #[error("there is no tree `{tree}` in this file; there are {known}")]
    UnknownTree {
        /// The tree as named.
        tree: String,
        /// What there is, in words.
        known: String,
    },
    /// A tree is part of itself.
    #[error("the sub-trees go round in a circle: {path}")]
    Recursion {
        /// Tree names joined by arrows.
        path: String,
    },
    /// A port that must be bound is not.
    #[error("port `{port}` ({wanted}) is missing")]
    MissingPort {
        /// The port.
        port: String,
        /// What it takes.
        wanted: PortType,
    },
    /// No such port.
    #[error("there is no port `{port}`; allowed are {allowed}")]
    UnknownPort {
        /// The port as written.
        port: String,
        /// What there is, in words.
        allowed: String,
    },
    /// The fixed value is not what the port takes.
    #[error("port `{port}`: {source}")]
    PortValue {
        /// The port.
        port: String,
        /// What is wrong, and what is allowed.
        source: ValueError,
    },
    /// An output port must be bound to a key.
    #[error("port `{port}` is written by the node: bind it to a key such as {{{port}}}, not to {value:?}")]
    FixedOutput {
        /// The port.
        port: String,
        /// The fixed value.
        value: String,
    },
    /// Two ports share a key but not a type.
    #[error("port `{port}` takes {wanted}, but its key {{{key}}} is {is} elsewhere")]
    KeyType {
        /// The port.
        port: String,
        /// Its type.
        wanted: PortType,
        /// The key, with the sub-tree it belongs to.
        key: String,
        /// The type that the key has from other ports.
        is: PortType,
    },
    /// A fixed value handed to a sub-tree is not what its key takes.
    #[error(transparent)]
    KeyValue(BlackboardError),
    /// A sub-tree reads what nobody gives it.
    #[error("port `{port}` reads {{{key}}}, which nothing writes and the sub-tree is not given")]
    NeverWritten {
        /// The port.
        port: String,
        /// The key.
        key: String,
    },
    /// A wrong number of children.
    #[error("it has {found} children; allowed is {allowed}")]
    Children {
        /// How many it has.
        found: usize,
        /// How many are allowed, in words.
        allowed: String,
    },
    /// Deeper than trees may be.
    #[error("it stands deeper than {limit} levels, sub-trees included")]
    TooDeep {
        /// The limit.
        limit: usize,
    },
    /// Larger than trees may be.
    #[error("the tree has more than {limit} nodes, sub-trees included")]
    TooLarge {
        /// The limit.
        limit: usize,
    },
}
