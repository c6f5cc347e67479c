//! Check of a division: it executes its mission completely, in order, and without deadlock.
//!
//! The check is independent of the algorithm that made the division. It examines the plans alone,
//! as they may arrive from the network.
//!
//! # Contract of a robot that executes a plan
//!
//! 1. A robot does one task at a time, and each step once.
//! 2. It may begin any step with all `after` ended. A send takes no time. A wait ends when its
//!    signal has been received, and blocks only its successors.
//! 3. Once it has sent a `ready` for a joint task, it begins no other task, and sends no `ready`
//!    for another task, until its part in that joint task has ended. It sends a `ready` only while
//!    it executes no task.
//! 4. Every signal sent is received eventually, in any order. Every task begun ends eventually.
//!
//! # Conditions checked
//!
//! *Steps* form a graph: `after`, and each send before its wait. *Tasks* form a coarser graph: all
//! steps of a joint task (its `ready` signals and its parts) are merged into a single node, and
//! `T < D` if a path leads from `T` to `D` through this graph.
//!
//! - (a) The plan of every role has exactly the role's tasks. Every wait has exactly 1 send, by the
//!   right role, and every send has its wait. A `done` follows its task.
//! - (b) In a joint task, each role sends `ready` to each other role and receives `ready` from each
//!   before it begins.
//! - (c) Neither graph has a cycle.
//! - (d) If the mission puts `T` before `D`, each part of `T` ends before each part of `D` begins.
//! - (e) If `T < D`: the part of a role `t` in `T` ends before the part of `s` in `D` *opens*. A
//!   part opens when its task begins or, if `D` is joint, before its first `ready` is sent. This
//!   holds if `s` is `t`, or if `t` takes no part in `D`.
//! - (f) The guarded steps are those of [`item_moves`](super::item_moves). A guard blocks a step
//!   until a report was answered, which happens eventually (4), so guards do not affect the proof
//!   below.
//! - (g) The alternatives are those of the mission, and no step is between the steps that an
//!   alternative replaces. To other roles, an alternative looks like a task that takes longer.
//!
//! Two joint tasks that share a role are always ordered by `<`: the order of the mission orders
//! them, and (d) holds.
//!
//! # Proof that no role waits forever
//!
//! Suppose a state without progress in which some step has not ended. A role is *committed* to a
//! joint task if it has sent a `ready` for it and has not ended its part. Fix a sequence of all
//! tasks that extends `<` (c).
//!
//! Signals never block: a `done`, or a wait for a signal that was sent, is performed when all its
//! predecessors have ended. So some task has not ended. If all tasks before an unended task have
//! ended, then some role of it is blocked by rule 3 alone. (If the task is joint and all its
//! `ready` are sent, they are received, and its parts begin. These parts are not blocked, since
//! their roles are committed to this task, and by rule 3 to no other.)
//!
//! *No role is committed.* For the first unended task in the sequence, all preceding tasks have
//! ended, and nothing blocks it.
//!
//! *Some role is committed.* Consider the tasks to which roles are committed. Let `J` be the first
//! of them in the sequence, and `r` a role committed to `J`. Let `T` be the first unended task with
//! `T < J` or `T = J`. All tasks before `T` have ended. So some role `u` of `T` has not opened its
//! part and is committed to a joint `K`, with `K ≠ T`. `K` is not before `J` in the sequence.
//!
//! - If `T < K`, by (e) with `s = t = u`, `u` ended its part in `T` before it committed itself to
//!   `K`. This contradicts the choice of `u`.
//! - Else, if `T` is joint, it shares `u` with `K`, and by the last remark `K < T`. So `K < J` or
//!   `K < T = J`: `K` is before `J`.
//! - Else `T` is not joint, hence `T < J`. If `u` takes no part in `J`, by (e) `T` ended before `r`
//!   committed itself to `J`, which contradicts the choice of `T`. If `u` takes part in `J`, `J`
//!   and `K` share it. `J = K` is the first case. Else either `J < K`, and so `T < K`, the first
//!   case again, or `K < J`, and `K` is before `J`.
//!
//! Every case is a contradiction, so there is no such state. Each step ends once, so every run
//! ends.
//!
//! Without (e) the proof fails. Take two unordered sequences: first `A` (`r`), then `J` (`s`, `x`);
//! and first `B` (`s`), then `K` (`r`, `y`). Suppose that `r` may be ready for `K` before it has
//! received the end of `B` (since `y` would wait for it), and `s` for `J`. Then `r` waits for `y`,
//! `y` for `B` of `s`, `s` for `x`, and `x` for `A` of `r`.

mod global_check;
mod local_check;
mod violation;

pub use violation::{DivisionViolation, DivisionViolations};

use self::global_check::GlobalCheck;
use self::local_check::LocalCheck;
use super::alternatives::{alternatives_differ, step_between};
use super::divide::divide;
use super::guards::guarded_steps;
use super::local::Division;
use crate::mission::{GlobalOrder, Mission, MissionErrors};

/// Divides a mission and checks the result.
///
/// # Errors
/// [`DivisionError`] if the mission's tree is invalid. A division of our own that does not pass
/// would be a bug, and is rejected as well.
pub fn divide_and_check(mission: &Mission) -> Result<Division, DivisionError> {
    let division = divide(mission)?;
    check_division(mission, &division)?;
    Ok(division)
}

/// Checks that the division executes the mission, in whatever order events occur.
///
/// # Errors
/// [`DivisionError`] lists the violations, up to the first kind that makes the rest meaningless.
pub fn check_division(mission: &Mission, division: &Division) -> Result<(), DivisionError> {
    let order = GlobalOrder::of(mission)?;
    let check_empty = |violations: Vec<DivisionViolation>| match violations.is_empty() {
        true => Ok(()),
        false => Err(DivisionError::Unsound(DivisionViolations { mission: mission.name.clone(), violations })),
    };
    let local = LocalCheck::of(&order, division);
    check_empty(local.violations)?;
    let global = GlobalCheck { order: &order, division, part_numbers: local.parts, pairs: local.pairs };
    check_empty(global.violations())?;
    check_empty(recovery_violations(mission, division)?)
}

/// Error: a mission cannot be divided, or a division is invalid.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DivisionError {
    /// The mission's tree is invalid.
    #[error(transparent)]
    Mission(#[from] MissionErrors),
    /// The plans do not execute the mission.
    #[error(transparent)]
    Unsound(#[from] DivisionViolations),
}

/// Checks (f) and (g).
fn recovery_violations(mission: &Mission, division: &Division) -> Result<Vec<DivisionViolation>, MissionErrors> {
    let mut expected = guarded_steps(mission, division)?;
    let mut violations = Vec::new();
    for (role, plan) in &division.plans {
        let expected = expected.remove(role).unwrap_or_default();
        if plan.guarded != expected {
            let (role, found) = (role.clone(), plan.guarded.clone());
            violations.push(DivisionViolation::GuardMismatch { role, found, expected });
        }
        if alternatives_differ(mission, role, plan) {
            violations.push(DivisionViolation::AlternativeMismatch { role: role.clone() });
        }
        for alternative in &plan.alternatives {
            if let Some(step) = step_between(plan, &alternative.replaces) {
                violations.push(DivisionViolation::NonLocalAlternative { role: role.clone(), step });
            }
        }
    }
    Ok(violations)
}
