//! Who votes: the first voters, the changes that keep enough of them alive, and how a node leaves.
//!
//! ```text
//!  gossip (alive? leaving? which store?) ─┐
//!  replica (answers? how far behind?) ────┴─▶ View ─▶ decide ─▶ Change ─▶ perform ─▶ ledger
//!                                              └── one at a time, by whoever coordinates ──┘
//! ```
//!
//! As Consul's and Nomad's autopilot, and more: a dead voter is replaced, not only removed; voters that stay where they
//! are and live on mains power are preferred; a voter that came back with an empty store is another member.

mod bootstrap;
mod bootstrap_promise;
mod cluster_snapshot;
mod decide;
mod decommission;
mod perform;

pub(crate) use bootstrap::Bootstrap;
pub use decide::{AutopilotAction, AutopilotInput, Member, MemberHealth, decide};
pub use decommission::{Decommission, DecommissionError, DecommissionReport};
pub use perform::ActionResult;
pub(crate) use perform::{Autopilot, perform};

/// Most voters: more slow every commit and survive little more.
pub const VOTERS_MAX: usize = 9;

/// Voters aimed at, where nothing else is said: two of five may fail at once.
pub const VOTERS: usize = 5;
