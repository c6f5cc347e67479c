//! Allocation of jobs with time windows to robots with [timelines](consort_protocol::timeline), measured against
//! instances of the literature.
//!
//! ```text
//!  instance file ─▶ Instance ─▶ policy ── orders ──▶ bidders, one for each robot
//!                                 ▲─────── prices ──────┘
//!                                 └──▶ routes ─▶ check ─▶ distance, late, unassigned
//! ```
//!
//! A policy sees prices only: a robot inserts a job into its own timeline and prices all others for it. Policies ask
//! through [`Market`], so the same policy runs in a function call and on a bus.

mod bidder;
mod check;
mod instance;
mod instance_file;
mod market;
mod policy;
mod reallocation;

pub use bidder::{Bidder, Order, Prices, Settlement};
pub use check::{CheckedRoutes, RouteProblem, check_routes};
pub use instance::{Instance, Site};
pub use instance_file::{InstanceError, read_instance};
pub use market::Market;
pub use policy::{AllocationPolicy, allocate, usual_orders};
