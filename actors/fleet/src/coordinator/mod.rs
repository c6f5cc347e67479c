//! The coordinator: a role for which every voter is ready. The leader of the ledger is the only
//! active coordinator.
//!
//! The coordinator owns no durable state. Its promises are in the ledger. Everything else (last
//! contacts, open auctions) can be lost at any time: the next coordinator starts with empty state
//! and full leases.
//!
//! ```text
//!  submit ─▶ ledger ─▶ call for bids ─▶ clear ─▶ award ─▶ ledger ─▶ notice ─▶ robot
//!                                                                     ▲          │
//!                                         accept, progress, fail ─────┴─ report ─┘
//! ```
//!
//! `reconcile` computes the pending actions as values. The [`Coordinator`] actor performs them, in
//! a separate session for each term.

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
