//! The evaluation of thesis chapter 4, carried out: each trial is a whole fleet on virtual time. What is tried and what is
//! concluded are values, in [`consort_sim::experiment`].
//!
//! ```text
//!  design ─▶ scenarios × policies × treatments × repetitions ─▶ trials, on all cores
//!                                                                 │ each: found a ledger, host a world, submit,
//!                                                                 │       watch until the first event decides
//!  report ◀── rows, in the order of the design ◀──────────────────┘
//! ```
//!
//! **What is the same for all policies.** Robots bid with their own estimators, the coordinator awards through the ledger,
//! robots carry their plans out with their skills, and what goes wrong is taken up as in any fleet. The rule by which roles are
//! given to robots is all that differs. The world, its people, drives, the network and the moment of a kill follow from mission,
//! scenario and repetition alone, so policies that choose alike end alike; only chance has dice of its own.
//!
//! **The fleet of a trial**: three stations that keep the ledger and coordinate, so that one may be killed; a node for each
//! robot; one that hosts the world. The world begins when the ledger has been founded and all robots are known, for the
//! published trials, too, began with a fleet that was ready.

mod runner;
mod setup;
mod trial;
mod trial_observer;

pub use runner::{Trial, run, trials};
pub use setup::{ExperimentSetup, ExperimentSetupError};
pub use trial::TrialOutcome;
