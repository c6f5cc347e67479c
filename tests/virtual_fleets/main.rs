//! Whole fleets on virtual time.

mod again;
mod clusters;
mod delivery;
mod determinism;
mod fencing;
mod keepers;
mod leases;
mod leaving;
mod queueing;
mod refusals;
mod requests;
mod restart;
mod setbacks;
mod supervision;
mod takeover;
mod takeover_everywhere;
mod takeover_of_holders;
mod views;
