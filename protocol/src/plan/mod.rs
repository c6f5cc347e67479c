//! Local plans: what one role does, with the messages that keep it in step with the others.
//!
//! A global plan is divided (Lesire et al. 2016; thesis 2.1.1.1) into one [`LocalPlan`] per role, the unmanaged ones
//! too. Where a task of one role must follow a task of another, the first sends a [`Signal`] and the second waits for
//! it; a joint task begins when all its roles have said that they are ready. Steps are partly ordered by `after`:
//! a robot may begin any step whose predecessors are done, and a wait for a message that has not come holds up
//! only what stands after it.
//!
//! ```text
//! Mission ─► GlobalOrder ─► divide ─► Division ─► check_division ─► PlanProgress, one a role
//! ```

mod alternatives;
mod bits;
mod check;
mod divide;
mod guards;
mod local;
mod order;
mod progress;

pub use check::{DivisionError, DivisionViolation, DivisionViolations, check_division, divide_and_check};
pub use divide::divide;
pub use guards::{ItemMove, item_moves};
pub use local::{Alternative, Division, LocalPlan, Signal, SignalKind, Step, StepAction, StepIndex};
pub use order::GlobalOrder;
pub use progress::{PlanProgress, ProgressError, StepNotPermitted};
