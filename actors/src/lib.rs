//! Carries decisions out: the bus, and the robot, coordinator, gossip and ledger actors around the pure core.
//!
//! An actor owns its mailbox, its timers and its share of the bus; what to do is decided by values from
//! `consort-protocol` and `consort-skills`. Only tokio's clock is used, chance comes from a seeded generator that is
//! handed in, and whatever is iterated to choose or to send is an ordered map, so that a whole fleet repeats exactly on
//! paused time.

mod api_types;
pub mod autopilot;
pub mod bus;
pub mod clock;
pub mod cluster_membership;
pub mod coordinator;
pub mod events;
pub mod fuzz_api;
pub mod gossip;
pub mod human_task_proxy;
mod ledger;
pub mod node;
pub mod observe;
pub mod raft;
mod reply;
pub mod robot;
pub mod robot_driver;
pub mod store;
mod tasks;
pub mod timing;
pub mod trust;
pub mod views;
pub mod wire_version;

pub use api_types::help as api_help;
