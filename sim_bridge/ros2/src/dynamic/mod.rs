//! ROS 2 messages whose types are known at run time only: definitions and hashes ([`types`]), CDR
//! ([`cdr`]), and a session on the graph that publishes, subscribes, calls services and executes
//! actions with them ([`graph`], [`action`]).
//!
//! Messages are JSON values. A received number that JSON cannot express, such as NaN, is `null`; `"nan"`,
//! `"inf"` and `"-inf"` are sent as such numbers.

pub mod action;
pub mod cdr;
pub mod graph;
pub mod types;
