//! The ledger: what the fleet has promised and what came of it, as a state machine that consensus replicates.
//!
//! A mission that is in the ledger has been acknowledged; a role that it gives to a robot is that robot's until it is
//! released, whoever coordinates. [`Ledger::apply`] is a pure function of the ledger and a [`Command`] at its position
//! ([`Epoch`](crate::lease::Epoch)) in the log, so that all copies agree. Commands say what the coordinator saw; a command that no longer
//! fits the ledger is [refused](Refused) and changes nothing, so that a late or repeated one does no harm.
//!
//! ```text
//!                 award (all open roles)         all managed roles ended
//! submit ─▶ pending ───────────────────▶ running ───────────────────────▶ completed
//!             ▲  │ defer (why not yet)     │ │
//!             └──┘◀────── release ─────────┘ └── fail (cause) ─▶ failed      cancel: from pending and running
//! ```
//!
//! A mission that would fail or be canceled while a robot has something in its hands goes to *needs rescue* instead, and
//! stays there until a person closes it; with a recovery branch it goes on with that. `custody` says who has what.

mod apply;
mod custody;
mod entry;
mod loss;

pub use apply::{Command, CommandError, CommandOutcome, HISTORY_MAX, Ledger};
pub use custody::HeldItem;
pub use entry::{
    Branch, DeadlineError, MissionEntry, MissionState, Priority, PriorityError, RELEASES_KEPT, RecoveryBranch,
    RoleAssignment, RoleEntry, RolePhase, RoleRelease, Submission, time_until_deadline,
};
pub use loss::RELEASES_MAX;
