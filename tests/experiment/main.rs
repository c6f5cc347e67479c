//! Evaluations from design to rows: whole fleets on virtual time, reduced designs.

mod published;
mod trials;
