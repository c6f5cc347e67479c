//! Tests of the released binary: real processes, real Zenoh, signals, and a plain Zenoh client.
//!
//! Every test has its own folder, and every process that it starts has the path of that folder on
//! its command line or in its environment. So the test finds its leftover processes and never
//! touches others. Each process is killed when its handle is dropped, also when a test fails.

mod backups;
mod closed;
mod crashes;
mod decommission;
mod demo;
mod demo_on_virtual_time;
mod demo_shutdown;
mod driver_process;
mod example_fleet;
mod foreign_clients;
mod full_disk;
mod holder_loss;
mod invalid_usage;
mod mission_rights;
mod published_ihtns;
mod recordings;
mod refusals;
mod service;
mod stock_client;
mod support;
mod terminal_ui;
mod upgrade;
mod zenoh_rest;
