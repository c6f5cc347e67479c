//! Behavior trees: a small engine of our own.
//!
//! ```text
//!  XML ──read_xml──▶ TreeSpec ──Registry::check──▶ Blueprint ──instantiate──▶ Tree ──tick──▶ NodeStatus
//!  Rust builder ────────▲                             │                         │
//!                                           reports every mistake         RobotActions
//! ```
//!
//! Names and rules are those of BehaviorTree.CPP 4, so that trees can be drawn in Groot2. Scripts
//! (`_skipIf` and similar attributes) are not supported and are rejected. Differences: loops that
//! can iterate within a tick stop after `MAX_LOOP_ITERATIONS_PER_TICK` and continue at the next
//! tick, and times are world time. See Colledanchise & Ögren, *Behavior Trees in Robotics and AI*
//! (2018), for the theory.
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
pub use leaf::{Leaf, SyncLeaf};
pub(crate) use manifest::join_names;
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
