//! What can be wrong with a division.

use crate::ids::{RoleId, TaskId};
use crate::plan::local::{Signal, StepIndex};
use std::collections::BTreeSet;
use std::fmt;

/// What is wrong with a division.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DivisionViolations {
    /// The mission that was divided.
    pub mission: TaskId,
    /// Every fault found. Never empty.
    pub violations: Vec<DivisionViolation>,
}

impl fmt::Display for DivisionViolations {
    /// One line for the mission, then one line a fault.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the local plans of mission {} do not carry it out:", self.mission)?;
        self.violations.iter().try_for_each(|fault| write!(f, "\n  {fault}"))
    }
}

impl std::error::Error for DivisionViolations {}

/// One thing that is wrong with a division.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say what the fields are")]
pub enum DivisionViolation {
    /// A role without a plan.
    #[error("role {role} has no plan")]
    NoPlan { role: RoleId },
    /// A plan for a role that the mission does not have, or under another role's name.
    #[error("there is a plan for {role} that says it is for {says}; the mission's roles have one plan each")]
    UnexpectedPlan { role: RoleId, says: RoleId },
    /// A task that its role's plan leaves out.
    #[error("role {role}: its plan lacks the task {task}")]
    TaskMissing { role: RoleId, task: TaskId },
    /// A task that is not the role's, or is there twice.
    #[error("role {role}: its plan has the task {task}, {problem}")]
    UnexpectedTask { role: RoleId, task: TaskId, problem: &'static str },
    /// A step after itself, after a later one, or after a step twice.
    #[error("role {role}: step {step} says it comes after {after:?}; these are smaller numbers, in order, each once")]
    InvalidPredecessors { role: RoleId, step: StepIndex, after: Vec<StepIndex> },
    /// A signal that cannot be.
    #[error("role {role}: the signal {signal} in its plan {problem}")]
    InvalidSignal { role: RoleId, signal: Signal, problem: &'static str },
    /// A send that nobody waits for.
    #[error("role {} sends {signal}, and role {} does not wait for it", signal.from, signal.to)]
    UnmatchedSend { signal: Signal },
    /// A wait for what nobody sends.
    #[error("role {} waits for {signal}, and role {} never sends it", signal.to, signal.from)]
    UnmatchedWait { signal: Signal },
    /// A joint task that a role may begin without its partner.
    #[error("role {role} may begin the joint task {task} before it has told {partner} and heard from it")]
    MissingRendezvous { role: RoleId, task: TaskId, partner: RoleId },
    /// A `done` that is sent too early.
    #[error("role {} may send {signal} before it has ended that task", signal.from)]
    DoneTooEarly { signal: Signal },
    /// Steps that wait for each other.
    #[error("these tasks wait for one another: {tasks}")]
    Cycle { tasks: String },
    /// An order that is not kept.
    #[error("role {role} may begin {task} before role {other} has ended {earlier}")]
    OutOfOrder { role: RoleId, task: TaskId, other: RoleId, earlier: TaskId },
    /// A role that binds itself while work is open that it does not see its partners do.
    #[error("role {role} may stand ready for {task} before it knows that role {other} has ended {earlier}")]
    ReadyTooEarly { role: RoleId, task: TaskId, other: RoleId, earlier: TaskId },
    /// Steps that the ledger should know of first, and that are not marked so, or the other way round.
    #[error("role {role}: its plan guards the steps {found:?}, and it should guard {expected:?}")]
    GuardMismatch { role: RoleId, found: BTreeSet<StepIndex>, expected: BTreeSet<StepIndex> },
    /// Alternatives that are not the mission's.
    #[error("role {role}: the alternatives of its plan are not the mission's")]
    AlternativeMismatch { role: RoleId },
    /// An alternative that others would notice.
    #[error("role {role}: step {step} stands between steps that an alternative replaces")]
    NonLocalAlternative { role: RoleId, step: StepIndex },
}
