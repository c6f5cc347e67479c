//! State of a fleet for people: folded into a model, shown on a page, recorded and replayed.
//!
//! [`fleet_model`] is the state as a value. [`subscriber`] passes a bus's messages to listeners:
//! the model behind the page ([`server`]) and recorders ([`recording`]). Commands and nodes are in
//! the program; nothing here reads configuration.

pub mod address;
pub mod admission;
pub mod event_text;
pub mod fleet_model;
pub mod loaded_map;
mod missions_copy;
pub mod query;
pub mod recording;
pub mod server;
pub mod subscriber;
