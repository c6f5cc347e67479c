//! Execution of the evaluation of thesis chapter 4: each trial is a whole fleet on virtual time.
//! The design and the conclusions are values, in [`consort_evaluation`].
//!
//! ```text
//!  design ─▶ scenarios × policies × treatments × repetitions ─▶ trials, on all cores
//!                                                                 │ each: bootstrap a ledger, host a world, submit,
//!                                                                 │       observe until the first event decides
//!  report ◀── rows, in the order of the design ◀──────────────────┘
//! ```
//!
//! **Common to all policies.** Robots bid with their own estimators, the coordinator awards through
//! the ledger, robots execute their plans with their skills, and failures are handled as in any
//! fleet. Only the rule that assigns roles to robots differs. The world, its people, the drives,
//! the network and the moment of a kill depend on mission, scenario and repetition alone, so
//! policies with the same assignments have the same results. Only the random policy has a seed of
//! its own.
//!
//! **The fleet of a trial**: three stations that store the ledger and coordinate, so one of them
//! may be killed; a node for each robot; a node that hosts the world. The world starts when the
//! ledger is bootstrapped and the coordinator has a record of every robot: the published trials
//! also began with a fleet that was ready.

mod runner;
mod setup;
mod trial;
mod trial_id;
mod trial_observer;

pub use runner::run;
pub use setup::{ExperimentSetup, ExperimentSetupError};
pub use trial::TrialOutcome;
pub use trial_id::{Trial, trials};
