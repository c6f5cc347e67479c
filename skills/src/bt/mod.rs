//! Behavior trees: a small engine of our own.
//!
//! ```text
//!  XML ──read_xml──▶ TreeSpec ──Registry::check──▶ Blueprint ──instantiate──▶ Tree ──tick──▶ NodeStatus
//!  Rust builder ────────▲                             │                         │
//!                                           reports every mistake         RobotActions
//! ```
//!
//! Names and rules are those of BehaviorTree.CPP 4, so that trees can be drawn in Groot2. See
//! Colledanchise & Ögren, *Behavior Trees in Robotics and AI* (2018), for the theory.
//!
//! Every node takes the [script attributes](ScriptAttribute) of BehaviorTree.CPP: preconditions
//! such as `_skipIf`, and postconditions such as `_onSuccess`. `Script` and `ScriptCondition`
//! execute the script in their port `code`. The names in a script are keys of the tree that contains
//! the node; those of a `SubTree` node belong to the enclosing tree. Scripts are compiled once, by
//! [`Registry::check`]. A script whose execution fails ends the tree with a failure, whose cause
//! names file, line and node.
//!
//! Differences from BehaviorTree.CPP:
//! - Times are world time.
//! - Loops that can iterate within a tick stop after `MAX_LOOP_ITERATIONS_PER_TICK` and continue at
//!   the next tick. `LoopString` reads its list once.
//! - A port of a `SubTree` that the sub-tree does not use is an error. So is a key that is read and
//!   never written; in the main tree it is an input.
//! - A `Parallel` that skips all children is skipped, also with a negative `success_count`. A
//!   skipped condition of `IfThenElse` or `WhileDoElse` skips the node.
//! - Scripts have no bit operators, no `..`, no enums and no `@`. A number is not a condition, and
//!   a condition does not end with an assignment. The reserved words of CEL (`in`, `for`, `if` …)
//!   are not names.
//! - `<include>`, plugins and the remaining nodes (`SetBlackboard`, `UnsetBlackboard`, `Precondition`,
//!   `EntryUpdated`, `LoopInt` …) are not supported.
//!
//! [`report_nodes`] lists the nodes of a tree for another program, such as Nav2's navigator, and
//! names those that are unknown.
//!
//! ```
//! use consort_skills::bt::Registry;
//! use consort_skills::bt::xml::read_xml;
//!
//! let tree = read_xml("wait.xml", r#"<root BTCPP_format="4"><BehaviorTree ID="wait">
//!     <Sequence><AlwaysSuccess/><Wiat seconds="1"/></Sequence>
//!     </BehaviorTree></root>"#)?;
//! // A mistake is reported before anything moves, with file and line.
//! let error = Registry::<()>::new().check(&tree).err().map(|error| error.to_string()).unwrap_or_default();
//! assert!(error.starts_with("wait.xml:2: ") && error.contains("Wiat"), "{error}");
//! # Ok::<(), consort_skills::bt::TreeError>(())
//! ```

mod blackboard;
mod blueprint;
mod bound_script;
mod builtin;
mod checked_node;
mod conditions;
mod control;
mod decorator;
mod error;
mod expand;
mod leaf;
mod manifest;
mod node;
mod port_value;
mod ports;
mod registry;
mod report;
mod scopes;
mod script;
mod script_attribute;
mod spec;
mod status;
mod tick;
mod tree;
mod value;
pub mod xml;

#[cfg(test)]
mod tests;

pub use blackboard::BlackboardError;
pub use blueprint::Blueprint;
pub use checked_node::TreeInput;
pub use error::{TreeError, TreeErrorKind};
pub(crate) use expand::key_of;
pub use leaf::{Leaf, SyncLeaf};
pub use manifest::{NodeKind, NodeManifest, PortConstraint, PortDirection, PortPresence, PortSpec};
pub use port_value::PortValue;
pub use ports::PortError;
pub use registry::{Registry, RegistryError};
pub use report::{NodeOrigin, NodeReport, report_nodes};
pub use script::ScriptError;
pub use script_attribute::ScriptAttribute;
pub use spec::{NodeSpec, TreeSpec, sequence, timeout};
pub use status::NodeStatus;
pub use tick::{Cause, LeafContext};
pub(crate) use tree::Tree;
pub use value::{PortType, Value, ValueError};
