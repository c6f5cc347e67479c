//! A node: everything that runs in one process of a fleet (or in one place of a virtual one), started in order and
//! watched over together.
//!
//! Each node gossips; each that may vote keeps a copy of the ledger and is ready to coordinate; a robot's node drives a
//! body and bids; one node hosts bodies and attends to people. If any of these actors fails, the node stops: what it
//! promised is in the ledger, and its supervisor (a service manager, a test) starts it anew.

mod assembly;
mod handle;
mod root;
mod settings;

pub use handle::{NodeError, NodeHandle};
pub use settings::{DriverServerPart, FleetSettings, NodeSettings, RobotPart};
