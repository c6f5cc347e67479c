//! Configuration, command line and wiring of the program `consort`.
//!
//! [`config`] reads files, [`wiring`] builds nodes from them, and each command in [`command`] runs
//! or queries nodes. Missions, auctions and worlds are implemented in other crates; no plan and no
//! price is computed here.

mod archive;
pub mod certs;
pub mod check;
pub mod cli;
pub mod client;
pub mod command;
pub mod config;
pub mod demo;
pub mod diagnostic;
pub(crate) mod doctor;
pub mod domains;
pub(crate) mod dry_run;
pub mod exit;
mod file;
pub mod inputs;
mod lab_program;
pub mod map_loader;
pub(crate) mod metrics;
mod mission_files;
pub mod node_runtime;
pub mod output;
pub(crate) mod people_asked;
pub(crate) mod rendering;
mod service_manager;
mod shutdown_signals;
pub mod telemetry;
pub mod trust;
pub(crate) mod tui;
pub mod wiring;
mod zenoh_panic;
