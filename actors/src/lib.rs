//! Carries decisions out: the bus, and the robot, coordinator, gossip and ledger actors around the pure core.
//!
//! An actor owns its mailbox, its timers and its share of the bus; what to do is decided by values from
//! `consort-protocol` and `consort-skills`. Only tokio's clock is used, chance comes from a seeded generator that is
//! handed in, and whatever is iterated to choose or to send is an ordered map, so that a whole fleet repeats exactly on
//! paused time.

pub mod allegiance;
mod answer;
pub mod attendant;
pub mod autopilot;
pub mod body;
pub mod bus;
mod calls;
pub mod clock;
pub mod coordinator;
pub mod events;
pub mod gossip;
mod ledger;
pub mod node;
pub mod observe;
pub mod replica;
pub mod robot;
pub mod store;
mod tasks;
pub mod timing;
pub mod trust;
pub mod untrusted;
pub mod views;
pub mod wire;

pub use calls::help as api_help;
