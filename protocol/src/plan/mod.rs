//! Local plans: the steps of each role, with the messages that synchronise it with other roles.
//!
//! A global plan is divided (Lesire et al. 2016; thesis 2.1.1.1) into 1 [`LocalPlan`] per role,
//! including the unmanaged roles. Where a task of a role must follow a task of another role, the
//! first role sends a [`Signal`] and the second role waits for it. A joint task begins when all its
//! roles have signalled that they are ready. Steps are partially ordered by `after`: a robot may
//! begin any step once its predecessors have ended. A wait for a missing message blocks only its
//! successors.
//!
//! ```text
//! Mission ─► GlobalOrder ─► divide ─► Division ─► check_division ─► PlanProgress, 1 per role
//! ```

mod alternatives;
mod check;
mod divide;
mod guards;
mod local;
mod progress;
mod start_times;

pub use check::{DivisionError, DivisionViolation, DivisionViolations, check_division, divide_and_check};
pub use divide::divide;
pub use guards::{ItemMove, item_moves};
pub use local::{Alternative, Division, LocalPlan, Signal, SignalKind, Step, StepAction, StepIndex};
pub use progress::{PlanProgress, ProgressError, StepNotPermitted};
pub use start_times::{EstimatedPlan, earliest_starts};
