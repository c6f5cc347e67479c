//! Whole fleets on virtual time.

mod again;
mod delivery;
mod determinism;
mod fencing;
mod found_by_chaos;
mod leases;
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
