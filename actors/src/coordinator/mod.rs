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
mod duties;
mod intake;
mod interregnum;
mod news;
mod pace;
mod reign;
mod reports;
mod whereabouts;

pub use actor::{Coordinator, CoordinatorMessage, CoordinatorSettings};
pub use intake::IntakeLimits;
pub(crate) use whereabouts::foreign;
