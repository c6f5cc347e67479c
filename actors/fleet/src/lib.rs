//! Performs the actions that the pure crates decide: the bus, and the robot, coordinator, gossip
//! and Raft actors.
//!
//! An actor owns its mailbox, its timers and its declarations on the bus. Its decisions are values
//! from `consort-protocol` and `consort-skills`. A whole fleet repeats exactly on paused time: only
//! tokio's clock is used, all randomness comes from a seeded generator passed in, and every
//! collection that is iterated to choose or to send is ordered.

mod api_help;
pub mod autopilot;
mod charger_users;
pub mod coordinator;
mod device_host;
mod device_reports;
mod ensemble_exchange;
pub mod events;
mod followed_coordinator;
#[cfg(feature = "test-util")]
pub mod fuzz_api;
#[cfg(test)]
mod lease_model;
pub mod node;
pub mod observe;
pub mod recurrence;
pub mod robot;
pub mod robot_driver;
mod shared_exchanges;
pub(crate) mod views;

pub use api_help::help as api_help;
