//! Evaluations from design to rows: whole fleets on virtual time, reduced designs.

mod published;
#[path = "../support/skip.rs"]
mod skip;
mod solomon;
mod trials;
