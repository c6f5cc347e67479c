//! Errors in tree descriptions.

use super::blackboard::BlackboardError;
use super::script::ScriptError;
use super::value::{PortType, ValueError};
use std::fmt;

/// An error in a description, with its position. Common in hand-edited files. No tree was built.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TreeError {
    /// The file, or the name given instead.
    pub source: String,
    /// The line in the file, from 1.
    pub line: Option<u32>,
    /// The tree and the node, if the error concerns a node.
    pub node: Option<String>,
    /// The error, and the allowed values.
    pub kind: Box<TreeErrorKind>,
}

/// Position of a node: file, line, tree and node.
#[derive(Debug, Clone)]
pub(crate) struct Place {
    pub(crate) source: String,
    pub(crate) line: Option<u32>,
    pub(crate) node: Option<String>,
}

impl Place {
    /// Creates an error at this position.
    pub(crate) fn error(&self, kind: TreeErrorKind) -> TreeError {
        TreeError { source: self.source.clone(), line: self.line, node: self.node.clone(), kind: Box::new(kind) }
    }
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

/// Kind of error in a description.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TreeErrorKind {
    /// The text is not XML, or not a tree file.
    #[error("{0}")]
    Syntax(String),
    /// The kind of node is unknown.
    #[error("there is no node `{id}`; known are {known}")]
    UnknownNode {
        /// The kind as written.
        id: String,
        /// The known kinds, as text.
        known: String,
    },
    /// The node is an action that people perform.
    #[error("people perform `{id}`, and no robot; the node that asks a person is `AskPerson`")]
    ActionOfPeople {
        /// The action.
        id: String,
    },
    /// The fleet lacks the ensemble whose values the node reads.
    #[error("the fleet has no ensemble `{ensemble}`; {allowed}")]
    UnknownEnsemble {
        /// The ensemble.
        ensemble: String,
        /// The ensembles of the fleet, as text.
        allowed: String,
    },
    /// The ensemble does not list the value that the node reads.
    #[error("ensemble {ensemble} exchanges no `{exchanged}`; {allowed}")]
    NotExchanged {
        /// The ensemble.
        ensemble: String,
        /// The value.
        exchanged: String,
        /// The values that the ensemble lists, as text.
        allowed: String,
    },
    /// The explicit form names another kind than the node's.
    #[error("`{id}` is written as <{written}>, but is of kind <{is}>")]
    WrongKind {
        /// The node.
        id: String,
        /// The tag in the file.
        written: &'static str,
        /// The kind in the registry.
        is: &'static str,
    },
    /// The tree is unknown.
    #[error("there is no tree `{tree}` in this file; there are {known}")]
    UnknownTree {
        /// The tree as named.
        tree: String,
        /// The known trees, as text.
        known: String,
    },
    /// A tree contains itself.
    #[error("the sub-trees form a cycle: {path}")]
    Recursion {
        /// Tree names joined by arrows.
        path: String,
    },
    /// A required port is not bound.
    #[error("port `{port}` ({wanted}) is missing")]
    MissingPort {
        /// The port.
        port: String,
        /// Type of the port.
        wanted: PortType,
    },
    /// A tree sets only one of two ports that belong together.
    #[error("port `{bound}` needs port `{missing}`, which is missing")]
    HalfPair {
        /// The bound port.
        bound: String,
        /// The other port.
        missing: String,
    },
    /// The node has no such port.
    #[error("there is no port `{port}`; allowed are {allowed}")]
    UnknownPort {
        /// The port as written.
        port: String,
        /// The allowed ports, as text.
        allowed: String,
    },
    /// The fixed value does not fit the port.
    #[error("port `{port}`: {source}")]
    PortValue {
        /// The port.
        port: String,
        /// Cause, and the allowed values.
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
    /// Two ports share a key but differ in type.
    #[error("port `{port}` takes {wanted}, but its key {{{key}}} is {is} elsewhere")]
    KeyType {
        /// The port.
        port: String,
        /// Type of the port.
        wanted: PortType,
        /// The key, with its sub-tree.
        key: String,
        /// Type of the key from other ports.
        is: PortType,
    },
    /// A fixed value passed to a sub-tree does not fit its key.
    #[error(transparent)]
    KeyValue(BlackboardError),
    /// A sub-tree reads a key that is never written.
    #[error("`{port}` reads {{{key}}}, which is neither written nor passed to the sub-tree")]
    NeverWritten {
        /// The port or the script attribute.
        port: String,
        /// The key.
        key: String,
    },
    /// A script cannot be compiled, or its execution failed.
    #[error("script `{attribute}`: {source}")]
    Script {
        /// The script attribute, or the port `code`.
        attribute: String,
        /// Cause, and the allowed form.
        source: ScriptError,
    },
    /// The number of children is wrong.
    #[error("it has {found} children; allowed is {allowed}")]
    Children {
        /// Number of children.
        found: usize,
        /// Allowed number, as text.
        allowed: String,
    },
    /// The nesting exceeds the limit.
    #[error("it is nested deeper than {limit} levels, sub-trees included")]
    TooDeep {
        /// The limit.
        limit: usize,
    },
    /// The number of nodes exceeds the limit.
    #[error("the tree has more than {limit} nodes, sub-trees included")]
    TooLarge {
        /// The limit.
        limit: usize,
    },
}
