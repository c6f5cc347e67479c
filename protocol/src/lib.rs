//! What Consort decides, in plain values.
//!
//! Missions and their division into local plans, knowledge and membership, bids and their selection, leases, the
//! ledger's state machine, the messages between nodes and every key they travel on. Nothing here waits: there is no
//! async, no clock, no socket and no actor in this crate, so every decision can be called, compared and fuzzed alone.

pub mod auction;
pub mod codec;
pub mod ensemble;
pub mod event;
pub mod ids;
pub mod keys;
pub mod knowledge;
pub mod lease;
pub mod ledger;
pub mod message;
pub mod mission;
pub mod mutants;
pub mod plan;
pub mod pose;
pub mod trust;
pub mod units;
mod words;
