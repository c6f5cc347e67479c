//! Evaluations from design to rows: whole fleets on virtual time, thin designs.

mod published;
mod trials;
