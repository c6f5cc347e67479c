//! Drivers of robots in any language: a child process that exchanges JSON lines over its standard
//! streams, or a program that does so over a local socket (`docs/reference/driver.md`).
//!
//! ```text
//!  robot's node                                                        child process
//!  DriverServer ─▶ ProcessDriver ─▶ DriverSession ─▶ process ── start, goal, keep, cancel ──▶ driver.py
//!   (RobotBackend)                (state machine)   (I/O)   ◀─ hello, feedback, result, pose ──
//! ```
//!
//! `DriverSession` makes every decision: it takes messages of the driver and the time, and returns
//! actions. [`ProcessDriver`] is the backend of the driver server; the process module performs the
//! actions. `conformance` tries a driver without a fleet.

mod backend;
pub mod conformance;
mod contract;
mod endpoint;
mod line;
mod messages;
mod process;
mod program;
mod session;
mod throttle;

pub use backend::{ProcessDriver, RobotStart};
pub use contract::{Contract, ContractError};
pub use endpoint::{DriverEndpoint, DriverSetting, DriverSocket, EndpointError};
pub use line::LINE_BYTES_MAX;
pub use messages::{DriverMessage, NodeMessage, OfferedAction, PROTOCOL_VERSION, ResultStatus, message_schemas};
pub use program::{DriverProgram, ProgramError};
