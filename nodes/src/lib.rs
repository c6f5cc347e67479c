//! Configuration, command line and wiring of Consort's one binary.
//!
//! [`config`] reads files, [`wiring`] makes nodes of them, each command in [`command`] runs or asks nodes. What missions,
//! auctions and worlds are is decided elsewhere; nothing here computes a plan or a price.

pub mod config;
pub mod floor;
pub mod wiring;
