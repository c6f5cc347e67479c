//! Whole fleets on virtual time.

mod again;
mod canceling;
mod clusters;
mod deadlines;
mod delivery;
mod determinism;
mod fencing;
mod found_by_chaos;
mod keepers;
mod leaderless;
mod leases;
mod leaving;
mod people;
mod queueing;
mod recovery;
mod refusals;
mod requests;
mod rescue;
mod restart;
mod setbacks;
mod supervision;
mod takeover;
mod takeover_everywhere;
mod takeover_of_holders;
mod views;
