//! A node: everything that runs in a single process of a fleet (or at a single place of a virtual
//! fleet), started in order and supervised together.
//!
//! Each node gossips. A node that may vote keeps a copy of the ledger and is ready to coordinate.
//! The node of a robot drives it and bids. A single node runs the driver server.
//! If any of these actors fails, the node stops. Its promises are in the ledger, and its supervisor (a
//! service manager, a test) restarts it.

mod assembly;
mod error;
mod handle;
mod root;
mod settings;

pub use error::{NodeEnded, NodeError};
pub use handle::NodeHandle;
pub use settings::{DevicePart, DriverServerPart, FleetSettings, NodeSettings, RobotPart};
