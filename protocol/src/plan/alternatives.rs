//! Alternatives of a role: replacement tasks that other roles cannot observe.
//!
//! A method with alternatives is local to a single role: no task below it belongs to another role,
//! and none is joint. In the tree-shaped order any other task then comes before all of these tasks,
//! after all of them, or is unordered with all of them, since its branch separates from theirs at
//! the same method. The rule for joint tasks adds only orders before or after all of them, since
//! none of them is joint. Hence no wait and no send is *between* two of them:
//!
//! - A wait is for a task that comes before any of them, so before all of them. It follows only
//!   those tasks of the role that the awaited task also follows.
//! - A send reports the end of any of them to a role with a task that comes after all of them. No
//!   step of this role follows a send.
//!
//! So when the first of them has begun, all signals that any of them waits for have been received.
//! To other roles, executing other tasks instead looks like a task that takes longer. When the
//! replaced steps count as ended, their sends may go out in any order. The check of a division
//! proves the first part again from the plan alone.

use super::local::{Alternative, LocalPlan, StepAction, StepIndex};
use crate::ids::{RoleId, TaskId};
use crate::mission::{Mission, TaskBody};
use std::collections::{BTreeMap, BTreeSet};

/// Returns the alternatives of a role's plan: innermost first, then in the order of the file.
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
                continue; // belongs to another role
            }
            let replaces = below.iter().filter_map(|(id, _)| tasks.get(id).copied()).collect();
            found.push((depths[index], Alternative { replaces, tasks: other.tasks.clone() }));
        }
    }
    found.sort_by_key(|(depth, _)| std::cmp::Reverse(*depth)); // stable: the order of the file stays
    found.into_iter().map(|(_, alternative)| alternative).collect()
}

/// Returns a step that is between two replaced steps and is not itself replaced, if there is any.
pub(super) fn step_between(plan: &LocalPlan, replaces: &BTreeSet<StepIndex>) -> Option<StepIndex> {
    let mut later: BTreeSet<StepIndex> = BTreeSet::new();
    for (index, step) in (0..).zip(&plan.steps) {
        let follows = step.after.iter().any(|sooner| later.contains(sooner));
        if follows || replaces.contains(&index) {
            later.insert(index);
        }
    }
    // A step that follows a replaced step and is not replaced itself must not precede a replaced
    // step.
    let outside: BTreeSet<StepIndex> = later.difference(replaces).copied().collect();
    let inside = |index: &StepIndex| {
        let step = plan.steps.get(*index as usize);
        step.and_then(|step| step.after.iter().find(|sooner| outside.contains(sooner)).copied())
    };
    replaces.iter().find_map(inside)
}

/// Checks whether the alternatives of this role's plan differ from those of the mission.
pub(super) fn alternatives_differ(mission: &Mission, role: &RoleId, plan: &LocalPlan) -> bool {
    plan.role == *role && plan.alternatives != alternatives(mission, plan)
}
