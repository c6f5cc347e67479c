//! Proof by chaos: seeded fleets under generated faults, watched at every step.
//!
//! ```text
//!  seed ──▶ generate ──▶ Schedule ──▶ run: perform + invariants ──▶ Outcome ──▶ shrink ──▶ the few faults that matter
//! ```
//!
//! One seed is one run, to the byte: a violation is repeated by its seed, or by its schedule once that was cut down.
//!
//! What it cannot show: pauses leave a node's own timers running (a stopped process's do not), disks tear off whole
//! writes and never hand back other bytes than were written, and the bus is not Zenoh. Real processes, real files and real
//! hosts are tried elsewhere.

pub mod chaos_fleet;
mod executor;
mod fault_injector;
pub mod generate;
pub mod invariants;
pub mod mutants;
pub mod run;
pub mod run_counters;
pub mod schedule;
pub mod scoreboard;
pub mod seed_sweep;
pub mod shrink;

pub use chaos_fleet::ChaosFleet;
pub use generate::generate;
pub use run::{RunConfig, RunOutcome, Violation, run};
pub use schedule::{ChaosAction, FaultKind, Schedule, ScheduledAction};
pub use seed_sweep::SeedSweep;
pub use shrink::shrink;
