//! The coordinator: a role for which every voter is ready. The leader of the ledger is the only
//! active coordinator.
//!
//! The coordinator owns no durable state. Its decisions are in the ledger. Everything else (last
//! contacts, open auctions) can be lost at any time: the next coordinator starts with empty state
//! and full leases.
//!
//! ```text
//!  submit ─▶ ledger ─▶ call for bids ─▶ clear ─▶ award ─▶ ledger ─▶ notice ─▶ robot
//!                                                                     ▲          │
//!                                         accept, progress, fail ─────┴─ report ─┘
//! ```
//!
//! `reconcile` computes the pending actions as values. The `Coordinator` actor performs them, in
//! a separate session for each term. Beacons, and the reports by which robots renew their leases, do not pass through the mailbox
//! of the actor: tasks beside it handle them, so that they never wait behind auctions.

mod actions;
mod actor;
mod alarm_requests;
mod api;
mod auctioneer;
mod auctions;
mod battery_swaps;
mod beacons;
mod candidates;
mod change_feed;
mod circular_waits;
mod clearing;
mod closure_requests;
mod confirmed_time;
mod ensemble_members;
mod held_roles;
mod last_known_place;
mod leader_session;
mod lease_monitor;
mod limit_requests;
mod map_parts;
mod message;
mod mission_requests;
#[cfg(test)]
pub(crate) mod model_session;
mod no_leader;
mod open_replies;
mod order_requests;
mod people;
mod promises;
mod queues;
mod rate_limit;
mod reauctions;
mod reconcile;
mod record_news;
mod reports;
mod requests;
mod resource_leases;
mod robot_orders;
mod role_requests;
mod rounds;
mod schedules;
mod scope;
mod session_context;
mod settings;
mod stall_detector;
mod status;
pub(crate) mod submission;
#[cfg(test)]
mod test_leader;
#[cfg(test)]
pub(crate) mod test_ledger;
mod voter_clocks;

pub(crate) use actor::Coordinator;
pub(crate) use last_known_place::{foreign_clusters, last_known_place};
pub(crate) use message::CoordinatorMessage;
pub use rate_limit::RequestLimits;
pub use settings::CandidateSettings;
pub(crate) use settings::{AuctionSettings, CoordinatorSettings, NodeParts};
pub(crate) use status::CoordinatorStatus;
