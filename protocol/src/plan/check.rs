//! Whether a division carries out its mission: nothing missing, nothing out of order, nobody waiting for ever.
//!
//! The check takes nothing from the way in which the division was made; it looks at the plans alone, as they might
//! have come off the wire.
//!
//! # The contract of those who carry out a plan
//!
//! 1. A robot does one task at a time, and each step once.
//! 2. It may begin any step of which all `after` have ended. A send takes no time. A wait ends when its signal has been
//!    heard and holds up only what stands after it.
//! 3. Once it has sent a `ready` for a joint task, it begins no other task, and sends no `ready` for another one, until
//!    its part in that joint task has ended. It sends a `ready` only while it does no task.
//! 4. Signals sent are heard in the end, in any order; tasks begun end in the end.
//!
//! # What is checked
//!
//! *Steps* form a graph: `after`, and each send before its wait. *Tasks* form a coarser one: all steps of a joint task
//! (its `ready` signals and its parts) are taken for one, and `T < D` if some path leads from `T` to `D` through it.
//!
//! - (a) Every role's plan has exactly the role's tasks; every wait has exactly one send, of the right role, and every
//!   send its wait; a `done` follows its task.
//! - (b) In a joint task, each role sends `ready` to each other one and hears `ready` from each before it begins.
//! - (c) Neither graph has a cycle.
//! - (d) If the mission puts `T` before `D`, each part of `T` ends before each part of `D` begins.
//! - (e) If `T < D`: the part of a role `t` in `T` ends before the part of `s` in `D` *opens*, that is, before its task
//!   begins or, if `D` is joint, before its first `ready` is sent; if `s` is `t`, or `t` takes no part in `D`.
//! - (f) The guarded steps are those of [`item_moves`](super::item_moves): a guard holds a step up until a report was
//!   answered, which ends in the end (4), so it changes nothing below.
//! - (g) The alternatives are the mission's, and nothing stands between the steps that one replaces: to all others, doing
//!   it is one of those tasks taking longer.
//!
//! Two joint tasks that share a role are always ordered by `<`: the mission's order orders them, and (d) holds.
//!
//! # Why nobody waits for ever
//!
//! Suppose a state in which nothing moves, while some step has not ended. Say that a role is *committed* to a joint task
//! if it has sent a `ready` for it and has not ended its part. Fix a sequence of all tasks which extends `<` (c).
//!
//! Signals never hold out: a `done`, or a wait for what was sent, is carried out when all before it has ended. So some
//! task has not ended, and if all before an unended task has ended, then one of its roles is held up by rule 3 alone.
//! (If it is joint and all its `ready` are sent, they are heard, and its parts begin. They are not held up, as those
//! roles are committed to it, and by rule 3 to it alone.)
//!
//! *Nobody is committed.* The first unended task in the sequence has all before it ended and is held up by nothing.
//!
//! *Somebody is committed.* Let `J` be the first in the sequence of the tasks to which some role `r` is committed, and
//! `T` the first unended task with `T < J` or `T = J`. All before `T` has ended; so some role `u` of `T`, which has not
//! opened its part, is committed to a joint `K`, and `K ≠ T`. `K` is not before `J` in the sequence.
//!
//! - If `T < K`, by (e) with `s = t = u`, `u` ended its part in `T` before it committed itself to `K`. It did not.
//! - Else, if `T` is joint, it shares `u` with `K`, and by the last remark `K < T`. So `K < J` or `K < T = J`: `K` is before `J`.
//! - Else `T` is not joint, hence `T < J`. If `u` takes no part in `J`, by (e) `T` ended before `r` committed itself to
//!   `J`. It did not. If `u` does, `J` and `K` share it; `J = K` is the first case; else either `J < K`, and so
//!   `T < K`, the first case again, or `K < J`, and `K` is before `J`.
//!
//! Every case contradicts the choice, so there is no such state. Each step ends once, so every run ends.
//!
//! Without (e) this fails. Take, in no order, first `A` (`r`) then `J` (`s`, `x`), and first `B` (`s`) then `K` (`r`, `y`).
//! If `r` may stand ready for `K` before it has heard of `B` (since `y` would wait for it), and `s` for `J`, then `r` waits
//! for `y`, `y` for `B` of `s`, `s` for `x`, `x` for `A` of `r`.

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
use super::order::GlobalOrder;
use crate::mission::{Mission, MissionErrors};

/// Divides a mission and checks the result.
///
/// # Errors
/// [`DivisionError`]: of a mission whose tree is none; a division of our own that does not pass would be our mistake, and
/// is refused all the same.
pub fn divide_and_check(mission: &Mission) -> Result<Division, DivisionError> {
    let division = divide(mission)?;
    check_division(mission, &division)?;
    Ok(division)
}

/// Checks that the division carries out the mission, whatever the order in which things happen.
///
/// # Errors
/// [`DivisionError`] lists what is wrong, up to the first kind of problem that makes the rest meaningless.
pub fn check_division(mission: &Mission, division: &Division) -> Result<(), DivisionError> {
    let order = GlobalOrder::of(mission)?;
    let unsound = |faults: Vec<DivisionViolation>| match faults.is_empty() {
        true => Ok(()),
        false => Err(DivisionError::Unsound(DivisionViolations { mission: mission.name.clone(), violations: faults })),
    };
    let survey = LocalCheck::of(&order, division);
    unsound(survey.violations)?;
    let product = GlobalCheck { order: &order, division, part_numbers: survey.parts, pairs: survey.pairs };
    unsound(product.violations())?;
    unsound(recovery_faults(mission, division)?)
}

/// Why there is no division.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DivisionError {
    /// The mission's tree is none.
    #[error(transparent)]
    Mission(#[from] MissionErrors),
    /// The plans do not carry out the mission.
    #[error(transparent)]
    Unsound(#[from] DivisionViolations),
}

/// (f) and (g)
fn recovery_faults(mission: &Mission, division: &Division) -> Result<Vec<DivisionViolation>, MissionErrors> {
    let mut expected = guarded_steps(mission, division)?;
    let mut faults = Vec::new();
    for (role, plan) in &division.plans {
        let expected = expected.remove(role).unwrap_or_default();
        if plan.guarded != expected {
            let (role, found) = (role.clone(), plan.guarded.clone());
            faults.push(DivisionViolation::GuardMismatch { role, found, expected });
        }
        if alternatives_differ(mission, role, plan) {
            faults.push(DivisionViolation::AlternativeMismatch { role: role.clone() });
        }
        for alternative in &plan.alternatives {
            if let Some(step) = step_between(plan, &alternative.replaces) {
                faults.push(DivisionViolation::NonLocalAlternative { role: role.clone(), step });
            }
        }
    }
    Ok(faults)
}
