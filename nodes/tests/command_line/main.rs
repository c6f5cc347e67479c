//! The command line, as people and scripts use it.

mod bench;
mod binary;
mod certs;
mod chaos;
mod deploy;
mod dry_run;
mod experiment;
mod files;
mod help;
mod map;
mod network;
mod recordings;
mod recover;
mod requests;
mod support;
mod test;
