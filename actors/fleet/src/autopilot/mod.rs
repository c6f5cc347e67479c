//! Autopilot: selects the first voters, changes the voters so that enough of them stay alive, and
//! decommissions nodes.
//!
//! ```text
//!  gossip (alive? leaving? which store?) ─┐
//!  replica (contact? how far behind?) ────┴─▶ AutopilotInput ─▶ decide ─▶ AutopilotAction ─▶ perform ─▶ ledger
//!                                              └────── one at a time, by the coordinator ──────────┘
//! ```
//!
//! It follows the autopilot of Consul and Nomad, and does more: a dead voter is replaced, not only
//! removed; stationary voters on mains power are preferred; a voter that came back with an empty
//! store is a different member.

mod bootstrap;
mod bootstrap_promise;
mod cluster_snapshot;
mod decide;
mod decommission;
mod perform;

pub(crate) use bootstrap::Bootstrap;
pub use bootstrap::{VOTERS, VOTERS_MAX};
pub(crate) use decide::AutopilotRule;
pub use decide::{AutopilotAction, AutopilotInput, Member, MemberHealth, decide};
pub use decommission::{Decommission, DecommissionError, DecommissionReport};
pub(crate) use perform::{ActionResult, Autopilot, AutopilotSettings, perform};
