//! Bodies over the bus: a robot's node drives its body with goals; a host (a simulated world, or an adapter to a real
//! robot) carries them out.
//!
//! ```text
//!  robot's node                                               host of bodies
//!  skill ─▶ Body (mirror) ── wire/body/{robot}/command ──▶ Host ─▶ BodyHost (world)
//!                         ◀── wire/body/{robot}/state ────
//!  attendant of unmanaged ── wire/people/ask ─────────────▶
//!  roles                  ◀── wire/people/done ────────────
//! ```
//!
//! Commands are queries that are repeated until answered; goals have ids, so that a repeated one starts nothing. States
//! are published when something ends and at a beat, and may be lost: the next one tells the same. A body whose driver
//! falls silent stops where it is.

mod client;
mod goal_tracker;
mod messages;
mod server;

use std::time::Duration;

/// How long a driver may be silent until its body stops: a promise of every host, on which awards rest. Whoever gives a role
/// back while its body cannot be reached counts on it.
pub const CLIENT_TIMEOUT: Duration = Duration::from_secs(3);

pub use client::{DriverClient, DriverClientMessage, DriverClientSettings, RobotDriver};
pub use messages::{DriverCommand, DriverState, GoalRequest, PersonCommand, PersonEvent, PersonRequestState};
pub use server::{DriverServer, DriverServerMessage, DriverServerSettings};
