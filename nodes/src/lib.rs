//! Configuration, command line and wiring of Consort's one binary.
//!
//! [`config`] reads files, [`wiring`] makes nodes of them, each command in [`command`] runs or asks nodes. What missions,
//! auctions and worlds are is decided elsewhere; nothing here computes a plan or a price.

pub mod address;
pub mod admission;
mod asking;
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
pub mod exit;
mod file;
pub mod floor;
pub mod kit;
pub mod metrics;
pub mod output;
pub mod picture;
pub mod recording;
pub mod rendering;
pub mod running;
pub mod screen;
mod service;
mod signals;
pub mod source;
pub mod telemetry;
pub mod trust;
mod watcher;
pub mod wiring;
pub mod words;
