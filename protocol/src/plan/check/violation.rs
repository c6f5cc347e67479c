//! Violations that the check of a division finds.

use crate::ids::{RoleId, TaskId};
use crate::plan::local::{Signal, StepIndex};
use std::collections::BTreeSet;
use std::fmt;

/// Violations found in a division.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DivisionViolations {
    /// Mission that was divided.
    pub mission: TaskId,
    /// Violations found. Never empty.
    pub violations: Vec<DivisionViolation>,
}

impl fmt::Display for DivisionViolations {
    /// Writes 1 line for the mission, then 1 line per violation.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the local plans of mission {} do not execute it:", self.mission)?;
        self.violations.iter().try_for_each(|violation| write!(f, "\n  {violation}"))
    }
}

impl std::error::Error for DivisionViolations {}

/// Violation found in a division.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages explain the fields")]
pub enum DivisionViolation {
    /// A role has no plan.
    #[error("role {role} has no plan")]
    NoPlan { role: RoleId },
    /// A plan belongs to no role of the mission, or is stored under the name of another role.
    #[error("the plan of {role} names the role {stated}; each role of the mission has exactly 1 plan")]
    UnexpectedPlan { role: RoleId, stated: RoleId },
    /// A task is missing in the plan of its role.
    #[error("role {role}: its plan lacks the task {task}")]
    TaskMissing { role: RoleId, task: TaskId },
    /// A task does not belong to the role, or occurs twice.
    #[error("role {role}: its plan has the task {task}, {problem}")]
    UnexpectedTask { role: RoleId, task: TaskId, problem: &'static str },
    /// A step is listed after itself, after a later step, or after the same step twice.
    #[error(
        "role {role}: step {step} lists the predecessors {after:?}; they must be smaller numbers, in order, without repetition"
    )]
    InvalidPredecessors { role: RoleId, step: StepIndex, after: Vec<StepIndex> },
    /// A signal is invalid.
    #[error("role {role}: the signal {signal} in its plan {problem}")]
    InvalidSignal { role: RoleId, signal: Signal, problem: &'static str },
    /// No role waits for a signal that is sent.
    #[error("role {} sends {signal}, and role {} does not wait for it", signal.from, signal.to)]
    UnmatchedSend { signal: Signal },
    /// No role sends a signal that is awaited.
    #[error("role {} waits for {signal}, and role {} never sends it", signal.to, signal.from)]
    UnmatchedWait { signal: Signal },
    /// A role may begin a joint task without its partner.
    #[error("role {role} may begin the joint task {task} before it has exchanged `ready` with {partner}")]
    MissingRendezvous { role: RoleId, task: TaskId, partner: RoleId },
    /// A `done` may be sent too early.
    #[error("role {} may send {signal} before it has ended that task", signal.from)]
    DoneTooEarly { signal: Signal },
    /// Steps wait for each other.
    #[error("these tasks wait for each other: {tasks}")]
    Cycle { tasks: String },
    /// An order of the mission is violated.
    #[error("role {role} may begin {task} before role {other} has ended {earlier}")]
    OutOfOrder { role: RoleId, task: TaskId, other: RoleId, earlier: TaskId },
    /// A role may commit itself while a preceding task is still open and none of its partners
    /// ensures its end.
    #[error("role {role} may signal `ready` for {task} before role {other} has ended {earlier}")]
    ReadyTooEarly { role: RoleId, task: TaskId, other: RoleId, earlier: TaskId },
    /// The guarded steps differ from the expected steps.
    #[error("role {role}: its plan guards the steps {found:?}; it must guard {expected:?}")]
    GuardMismatch { role: RoleId, found: BTreeSet<StepIndex>, expected: BTreeSet<StepIndex> },
    /// The alternatives differ from those of the mission.
    #[error("role {role}: the alternatives of its plan differ from those of the mission")]
    AlternativeMismatch { role: RoleId },
    /// An alternative could be observed by other roles.
    #[error("role {role}: step {step} is between steps that an alternative replaces")]
    NonLocalAlternative { role: RoleId, step: StepIndex },
}
