//! Whole fleets on virtual time.

mod again;
mod delivery;
mod takeover;
