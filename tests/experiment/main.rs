//! Evaluations from design to rows: whole fleets on virtual time, reduced designs.

mod published;
mod shift;
#[path = "../support/skip.rs"]
mod skip;
mod solomon;
mod trials;
