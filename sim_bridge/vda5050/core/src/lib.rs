//! VDA 5050 as values: messages of versions 2.0, 2.1 and 3.0, their schemas, and a state machine for
//! each side: fleet control with one vehicle, and a vehicle. The crate makes no I/O and reads no clock.
//!
//! ```text
//!  goal, keep, cancel ──▶ OrderMachine ──▶ order, instant action ──▶ vehicle
//!  result, feedback   ◀──              ◀── state, connection     ◀──
//! ```
//!
//! The machine takes events and returns commands. It names orders after goals ([`OrderId`]): a
//! machine that starts while a vehicle executes an order recognises the order in the vehicle's state
//! and continues it. [`OrderExecutor`] is the other side: it executes the orders of a fleet control.

mod cause;
mod executor;
mod identity;
mod incoming;
mod layout;
mod machine;
mod order_id;
mod outgoing;
mod received;
pub mod schema;

pub use cause::{Cause, CauseClass, CauseTable, ErrorLevel, VehicleError, class_of};
pub use executor::{
    ActivityEnd, ExecutorCommand, ExecutorEvent, ExecutorSettings, OrderExecutor, RobotCondition, connection,
};
pub use identity::{IdentityError, Topic, Vehicle, Version, VersionError};
pub use incoming::{
    ActionReport, ActionStatus, ConnectionState, Factsheet, Malformed, Position, RemainingNode, VehicleState,
    Visualization, read_connection, read_factsheet, read_state, read_visualization,
};
pub use layout::{Layout, LayoutError, LayoutNode};
pub use machine::{Command, Event, GoalStatus, MachineSettings, OrderMachine, Work};
pub use order_id::{OrderId, fingerprint};
pub use outgoing::{BlockingType, Order, OrderEdge, OrderNode, VehicleAction, instant_actions};
pub use received::{ReceivedEdge, ReceivedNode, ReceivedOrder, read_instant_actions, read_order};
