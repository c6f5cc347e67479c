//! The command line, as people and scripts use it.

mod binary;
mod certs;
mod deploy;
mod domains;
mod drivers;
mod dry_run;
mod files;
mod fleet_missions;
#[path = "../../../../tests/support/free_port.rs"]
mod free_port;
mod help;
mod ihtn;
mod map;
mod network;
#[path = "../processes/support/published.rs"]
mod published;
mod recordings;
mod recover;
mod requests;
#[path = "../../../../tests/support/skip.rs"]
mod skip;
mod support;
