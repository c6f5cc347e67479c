//! The command line, as people and scripts use it.

mod binary;
mod certs;
mod deploy;
mod dry_run;
mod files;
mod help;
mod map;
mod network;
mod recordings;
mod recover;
mod requests;
mod support;
