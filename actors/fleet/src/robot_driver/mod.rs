//! Robot drivers over the bus: the node of a robot sends goals; a driver server (a simulated world,
//! or an adapter to a real robot) executes them.
//!
//! ```text
//!  robot's node                                           driver server
//!  skill ─▶ RobotDriver ── wire/driver/{robot}/command ──▶ DriverServer ─▶ RobotBackend (world)
//!                       ◀── wire/driver/{robot}/state ────
//!  coordinator          ── wire/people/ask ──────────────▶
//!                       ◀── wire/people/done ─────────────
//! ```
//!
//! Commands are queries that are repeated until a reply arrives. Goals have ids, so a repeated goal
//! starts nothing. States are published when a goal ends and at an interval. A state may be lost,
//! because the next state replaces it. A command lists the goals that may continue, and until when
//! ([`Permit`]): at the end of the lease, or when no such command arrives for [`CLIENT_TIMEOUT`], the
//! robot stops.

mod client;
mod goal_table;
mod goal_tracker;
mod messages;
#[cfg(test)]
pub(crate) mod model_driver;
mod questions;
mod server;
mod state_order;
mod ways;

use std::time::Duration;

/// Time after the last command that permits a goal until a driver server stops the robot. Awards rely
/// on this guarantee of every server: the release of a role whose driver is unreachable waits for
/// this time.
pub const CLIENT_TIMEOUT: Duration = Duration::from_secs(3);

pub(crate) use client::MapOrders;
pub use client::{DriverClientSettings, RobotDriver};
pub use messages::{DriverCommand, DriverState, GoalRequest, Permit, PersonCommand, PersonEvent, PersonRequestState};
pub(crate) use questions::OpenQuestion;
pub use server::{DriverServer, DriverServerMessage, DriverServerSettings};
pub use state_order::{StateOrder, StateStamp};
pub(crate) use ways::{RequestedWay, SharedWays, Way};
