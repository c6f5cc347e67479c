//! Chaos testing: seeded fleets under generated faults, with invariants checked at every step.
//!
//! ```text
//!  seed ──▶ generate ──▶ Schedule ──▶ run: executor + invariants ──▶ RunOutcome ──▶ shrink ──▶ minimal schedule
//! ```
//!
//! A seed determines a run to the byte. A violation is reproduced by its seed, or by its schedule
//! after shrinking.
//!
//! Limits: a pause leaves the timers of a node running, unlike a stopped process. The bus is not
//! Zenoh. Other tests use real processes, real files and real hosts.

mod alarms;
pub mod chaos_fleet;
mod chargers;
mod closures;
mod control_flow;
mod coverage;
mod dates;
mod executor;
mod fault_injector;
mod fault_kind;
pub mod generate;
mod hostile;
pub(crate) mod invariants;
mod mission_changes;
pub mod mutants;
pub mod mutation_checks;
mod orders;
mod people;
mod people_requests;
mod person_action;
mod poison;
mod quiet_thread;
mod recurring;
mod request_ids;
mod requested_missions;
mod revocation;
mod rolling_upgrade;
mod run;
pub(crate) mod run_counters;
pub(crate) mod schedule;
mod schedule_check;
mod schedule_text;
pub mod scoreboard;
mod scripted;
pub mod seed_sweep;
pub mod shrink;
mod small_limits;
mod speed_limits;
mod zones;

pub use alarms::FIRST_SEED as FIRST_SEED_WITH_ALARMS;
pub use chaos_fleet::{ChaosFleet, SHIFT_ARMS, SHIFT_CARRIERS, UserParticipants, user_missions};
pub use chargers::FIRST_SEED_WITH_STOPS;
pub use coverage::{Coverage, CoverageKind};
pub use fault_kind::{FaultKind, UnknownFaultKind};
pub use generate::{FIRST_LARGE_SEED, generate};
pub use person_action::{CancelSelection, ClosureAction, MissionAction, OrderAction, SpeedLimitAction};
pub use run::{FaultyShift, RunConfig, RunOutcome, Violation, run, run_shift};
pub use schedule::{ChaosAction, Schedule, ScheduledAction};
pub use schedule_check::{ScheduleError, ScheduleProblem};
pub use seed_sweep::SeedSweep;
pub use shrink::shrink;
pub use small_limits::FIRST_SEED_WITH_SMALL_LIMITS;
