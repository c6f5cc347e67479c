//! The one binary as it is used: real processes, real Zenoh, signals and a client that has nothing of ours.
//!
//! Every test has a folder of its own, and every process that it starts carries that folder's path on its command line or
//! in its environment. So what is left over can be found, and what belongs to others is never touched. Each process is
//! killed when its handle is dropped, also when a test fails.

mod backups;
mod closed;
mod crashes;
mod decommission;
mod demo;
mod demo_on_virtual_time;
mod demo_shutdown;
mod example_fleet;
mod foreign_clients;
mod full_disk;
mod holder_loss;
mod invalid_usage;
mod recordings;
mod service;
mod stock_client;
mod support;
mod terminal_ui;
mod upgrade;
mod zenoh_rest;
