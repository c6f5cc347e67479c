//! The coordinator: a role that every node is ready for and one plays at a time, the one that leads the ledger.
//!
//! It keeps no truth of its own. What it has promised is in the ledger; what it remembers beside (who was last in
//! contact, which auctions are open) can be forgotten at any instant, and the next coordinator begins with an empty
//! memory and full leases.
//!
//! ```text
//!  submit ─▶ ledger ─▶ call for bids ─▶ conclude ─▶ award ─▶ ledger ─▶ notice ─▶ robot
//!                                                                       ▲          │
//!                                           accept, progress, fail ─────┴─ report ─┘
//! ```
//!
//! `duties` says what is to be done, as a value; the [`Coordinator`] actor does it, reign by reign.

mod actor;
mod api;
mod auctioneer;
mod auctions;
mod change_feed;
mod last_known_place;
mod leader_session;
mod no_leader;
mod rate_limit;
mod reconcile;
mod reports;
mod stall_detector;

pub use actor::{Coordinator, CoordinatorMessage, CoordinatorSettings};
pub(crate) use last_known_place::foreign_clusters;
pub use rate_limit::RequestLimits;
