//! Problems of missions in the flat iHTN form.

use crate::mission::limits::FILE_BYTES_MAX;
use consort_text::AllowedNames;

/// Problem of a node of a flat iHTN. The path of the diagnostic names the node
/// (`node 12 (deposit)`).
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum IhtnError {
    /// The text is larger than any mission needs.
    #[error("the file has {bytes} bytes; at most {FILE_BYTES_MAX} are allowed")]
    TooLarge {
        /// Size of the file.
        bytes: usize,
    },
    /// The text is not JSON, or has wrong fields.
    #[error("not a flat iHTN: {message}")]
    Syntax {
        /// Message of the parser, with line and column.
        message: String,
    },
    /// No node has the parent `-1`.
    #[error("there is no root; the root has the parent \"-1\"")]
    NoRoot,
    /// Several nodes have the parent `-1`.
    #[error("several nodes have the parent \"-1\": {nodes}; exactly 1 node must be the root")]
    SeveralRoots {
        /// Ids of these nodes.
        nodes: String,
    },
    /// The root is not a task.
    #[error("the root is of type {found}; it must be a task")]
    RootNotTask {
        /// Type of the root.
        found: &'static str,
    },
    /// A parent does not exist.
    #[error("its parent {parent:?} does not exist")]
    NoSuchParent {
        /// Id of the parent.
        parent: String,
    },
    /// A parent does not list the node.
    #[error("its parent {parent:?} does not have it among its children")]
    NotAmongChildren {
        /// Id of the parent.
        parent: String,
    },
    /// A child does not exist.
    #[error("its child {child:?} does not exist")]
    NoSuchChild {
        /// Id of the child.
        child: String,
    },
    /// A child names another parent.
    #[error("its child {child:?} names the parent {parent:?}")]
    WrongParent {
        /// Id of the child.
        child: String,
        /// Parent that the child names.
        parent: String,
    },
    /// A child is listed twice.
    #[error("lists the child {child:?} twice")]
    ChildTwice {
        /// Id of the child.
        child: String,
    },
    /// A node is its own ancestor.
    #[error("is its own ancestor: {cycle}")]
    Cycle {
        /// Ids along the cycle; the first and the last are equal.
        cycle: String,
    },
    /// A child has a type that is not allowed there.
    #[error("is of type {parent} and has {child:?} of type {found}; allowed: {takes}")]
    WrongType {
        /// Type of the node.
        parent: &'static str,
        /// Id of the child.
        child: String,
        /// Type of the child.
        found: &'static str,
        /// Allowed children, as text.
        takes: &'static str,
    },
    /// A task has no method or several.
    #[error("has {found} methods; in an instantiated network a task has exactly 1")]
    NotOneMethod {
        /// Number found.
        found: usize,
    },
    /// An agent is not listed at the parent.
    #[error("its agent `{agent}` is not among the agents of its parent")]
    AgentNotInParent {
        /// Agent.
        agent: String,
    },
    /// A node has wrong fields.
    #[error("{message}")]
    Node {
        /// Message of the parser.
        message: String,
    },
    /// An action has no agent that is a robot or a person.
    #[error("has no agent that is a robot or a person; an action needs at least 1")]
    NoAgent,
    /// The task type has no parameter for one of several locations, or for an object.
    #[error("has {value:?}, which becomes the parameter `{name}`, but its task type has no such {kind}; {allowed}")]
    Unnumbered {
        /// Location or object.
        value: String,
        /// Missing parameter.
        name: String,
        /// Required kind of parameter.
        kind: &'static str,
        /// Parameters of the type with this kind.
        allowed: AllowedNames,
    },
    /// A request has a parameter.
    #[error("is given, but a mission in the flat iHTN form has no parameters")]
    Parameter,
    /// The task type has no parameter for the location.
    #[error("has the location {location:?}, but `{task_type}` has no parameter for a place")]
    UnusedLocation {
        /// Location.
        location: String,
        /// Task type.
        task_type: String,
    },
    /// An agent of [`IhtnOptions::people`](crate::mission::IhtnOptions::people) has no action.
    #[error("is named as a person, but is no agent of an action; {allowed}")]
    NoSuchAgent {
        /// Agents with actions.
        allowed: AllowedNames,
    },
}
