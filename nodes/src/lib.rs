//! Configuration, command line and wiring of Consort's single binary.
//!
//! [`config`] reads files, [`wiring`] builds nodes from them, and each command in [`command`] runs
//! or queries nodes. Missions, auctions and worlds are implemented in other crates; no plan and no
//! price is computed here.

pub mod address;
pub mod admission;
pub mod certs;
pub mod check;
pub mod cli;
pub mod client;
pub mod command;
pub mod config;
pub mod dashboard;
pub mod demo;
pub mod doctor;
pub mod dry_run;
pub mod evaluation;
pub mod event_text;
pub mod exit;
pub mod extensions;
mod file;
pub mod fleet_model;
pub mod inputs;
pub mod map_loader;
pub mod metrics;
pub mod node_runtime;
pub mod output;
mod query;
pub mod recording;
pub mod rendering;
mod service_manager;
mod shutdown_signals;
mod subscriber;
pub mod telemetry;
pub mod trust;
pub mod tui;
pub mod wiring;
