//! The binary as people and scripts meet it.

mod chaos;
mod dry_run;
mod experiment;
mod files;
mod help;
mod network;
mod recover;
mod requests;
mod support;
