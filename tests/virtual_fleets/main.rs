//! Whole fleets on virtual time.

mod delivery;
mod takeover;
