//! What a role may do instead of some of its tasks, without anybody else noticing.
//!
//! A method with alternatives is one role's own affair: no task below it is another's, none is joint. In the tree-shaped
//! order any other task then stands before all of these tasks, after all of them, or in no order with any of them: where
//! the branches part is the same for all, and of the rule for joint tasks, which adds to that order, only what comes before
//! or after all of them can follow, as none of them is joint. Hence no wait and no send stands *between* two of them:
//!
//! - a wait is for a task that comes before one of them, so before all, and it stands after no task of the role that such
//!   a task does not also come after;
//! - a send tells of one of them to somebody whose task comes after all, and nothing of this role stands after a send.
//!
//! So when one of them has begun, all that any of them waits for has been heard. Doing other tasks in their stead is, to
//! all others, one of them taking longer; when they count as ended, their sends may go out, in any order. The check of a
//! division proves the first part anew from the plan alone.

use super::local::{Alternative, LocalPlan, StepAction, StepIndex};
use crate::ids::{RoleId, TaskId};
use crate::mission::{Mission, TaskBody};
use std::collections::{BTreeMap, BTreeSet};

/// The alternatives of a role's plan: innermost first, then in the order of the file.
pub(super) fn alternatives(mission: &Mission, plan: &LocalPlan) -> Vec<Alternative> {
    let tasks = (0..).zip(&plan.steps).filter_map(|(index, step)| match &step.action {
        StepAction::Task { id, .. } => Some((id, index)),
        StepAction::Send(_) | StepAction::Wait(_) => None,
    });
    let tasks: BTreeMap<&TaskId, StepIndex> = tasks.collect();
    let mut depths = vec![0usize; mission.tasks.len()];
    let mut found: Vec<(usize, Alternative)> = Vec::new();
    for (index, node) in mission.tasks.iter().enumerate() {
        let TaskBody::Abstract(method) = &node.body else { continue };
        for child in &method.children {
            if let Some(depth) = depths.get(index).map(|depth| depth + 1)
                && let Some(child) = depths.get_mut(*child as usize)
            {
                *child = depth;
            }
        }
        for other in &method.alternatives {
            let below = mission.elementary_below(index);
            if below.iter().any(|(_, spec)| spec.roles[..] != [plan.role.clone()]) {
                continue; // another role's
            }
            let replaces = below.iter().filter_map(|(id, _)| tasks.get(id).copied()).collect();
            found.push((depths[index], Alternative { replaces, tasks: other.tasks.clone() }));
        }
    }
    found.sort_by_key(|(depth, _)| std::cmp::Reverse(*depth)); // stable: the order of the file stays
    found.into_iter().map(|(_, alternative)| alternative).collect()
}

/// A step that stands between two that an alternative replaces and is not one of them.
pub(super) fn step_between(plan: &LocalPlan, replaces: &BTreeSet<StepIndex>) -> Option<StepIndex> {
    let mut later: BTreeSet<StepIndex> = BTreeSet::new();
    for (index, step) in (0..).zip(&plan.steps) {
        let follows = step.after.iter().any(|sooner| later.contains(sooner));
        if follows || replaces.contains(&index) {
            later.insert(index);
        }
    }
    // What follows one of them and is itself none of them must not be followed by one.
    let outside: BTreeSet<StepIndex> = later.difference(replaces).copied().collect();
    let inside = |index: &StepIndex| {
        let step = plan.steps.get(*index as usize);
        step.and_then(|step| step.after.iter().find(|sooner| outside.contains(sooner)).copied())
    };
    replaces.iter().find_map(inside)
}

/// Whose alternatives differ from the mission's: the role, if this one's do.
pub(super) fn alternatives_differ(mission: &Mission, role: &RoleId, plan: &LocalPlan) -> bool {
    plan.role == *role && plan.alternatives != alternatives(mission, plan)
}
