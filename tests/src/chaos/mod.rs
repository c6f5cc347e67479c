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

pub mod cast;
mod gear;
pub mod generate;
pub mod invariants;
pub mod many;
pub mod mutants;
mod perform;
pub mod run;
pub mod schedule;
pub mod scoreboard;
pub mod shrink;
pub mod tally;

pub use cast::Cast;
pub use generate::generate;
pub use many::Many;
pub use run::{Order, Outcome, Violation, run};
pub use schedule::{Act, Kind, Schedule, Step};
pub use shrink::shrink;
