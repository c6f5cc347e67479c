//! The one binary as it is used: real processes, real Zenoh, signals and a client that has nothing of ours.
//!
//! Every test has a folder of its own, and every process that it starts carries that folder's path on its command line or
//! in its environment. So what is left over can be found, and what belongs to others is never touched. Each process is
//! killed when its handle is dropped, also when a test fails.

mod backups;
mod by_hand;
mod closed;
mod crashes;
mod demo;
mod demo_on_virtual_time;
mod departures;
mod foreign_clients;
mod full_disk;
mod holder;
mod interruption;
mod mistakes;
mod recordings;
mod rest;
mod service;
mod stock_client;
mod support;
mod upgrade;
mod watch;
