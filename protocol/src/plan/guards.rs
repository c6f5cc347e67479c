//! Write-ahead of custody: guarded steps, which wait until the ledger contains their predecessors.
//!
//! A robot may be lost at any moment, and with it all progress that it has not reported. It must
//! still be certain whether the parcel is in its box. So a task that moves an item cannot begin
//! before the ledger is known to contain a preceding step, the predecessor of a *guard*. If the
//! ledger lacks a predecessor of a guard, the item was not moved.
//!
//! ```text
//!   r1                                   clerk                 deposit gives the parcel to r1:
//!   open ─ [ledger has `open`] ─ done ─► wait, deposit         the guard is r1's `done:open`
//! ```
//!
//! The guard of a move belongs to the role that receives the item. If the receiver is a person, or
//! outside the mission, the guard belongs to the role that has the item. If no managed role has it
//! either, the guards belong to the robots that execute the task.
//!
//! - A role that executes the task itself is guarded at its own step. In a joint task it is guarded
//!   at each `ready` that it sends for the task, since its partners begin when they have received
//!   it.
//! - Any other role is guarded at the sends after which, directly or through other roles, the
//!   executing roles may begin.
//!
//! A task that waits for no step of that role has no guard: it may have been executed as soon as
//! the role is held.

use super::local::{Division, Signal, SignalKind, StepAction, StepIndex};
use crate::ids::{ItemId, RoleId, TaskId};
use crate::mission::{GlobalOrder, Mission, MissionErrors, RoleKind};
use std::collections::{BTreeMap, BTreeSet};

/// Task that moves an item.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ItemMove {
    /// The task.
    pub task: TaskId,
    /// Roles that execute it.
    pub performers: Vec<RoleId>,
    /// Role that has the item afterwards; `None` if the item leaves the mission.
    pub receiver: Option<RoleId>,
    /// Steps that precede the task. Each is performed only after the ledger contains all steps that
    /// ended before it.
    pub guards: Vec<(RoleId, StepIndex)>,
}

/// Returns the moves of each item of a divided mission, in their order.
///
/// # Errors
/// [`MissionErrors`] if the mission has no valid order, or if moves of an item are unordered.
pub fn item_moves(mission: &Mission, division: &Division) -> Result<BTreeMap<ItemId, Vec<ItemMove>>, MissionErrors> {
    let order = GlobalOrder::of(mission)?;
    let sends = sends(division);
    let managed = |role: &RoleId| mission.roles.get(role).is_some_and(|role| role.kind == RoleKind::Managed);
    let mut all = BTreeMap::new();
    for (item, tasks) in order.moves() {
        let mut holder: Option<&RoleId> = None;
        let mut moves = Vec::new();
        for task in tasks {
            let (id, spec) = (order.id(task), order.spec(task));
            let to = spec.acquires.get(item);
            let guarded_roles: Vec<&RoleId> = match to.filter(|to| managed(to)).or(holder.filter(|from| managed(from)))
            {
                Some(guarded_role) => vec![guarded_role],
                None => spec.roles.iter().filter(|role| managed(role)).collect(),
            };
            let mut guards: Vec<(RoleId, StepIndex)> = Vec::new();
            for guarded_role in guarded_roles {
                let steps = match spec.roles.contains(guarded_role) {
                    true => own_guards(division, guarded_role, id),
                    false => sends_leading_to(division, &sends, guarded_role, id, &spec.roles),
                };
                guards.extend(steps.into_iter().map(|step| (guarded_role.clone(), step)));
            }
            moves.push(ItemMove { task: id.clone(), performers: spec.roles.clone(), receiver: to.cloned(), guards });
            holder = to;
        }
        all.insert(item.clone(), moves);
    }
    Ok(all)
}

/// Returns the guarded steps of each role.
pub(super) fn guarded_steps(
    mission: &Mission,
    division: &Division,
) -> Result<BTreeMap<RoleId, BTreeSet<StepIndex>>, MissionErrors> {
    let mut guarded: BTreeMap<RoleId, BTreeSet<StepIndex>> = BTreeMap::new();
    for guard in item_moves(mission, division)?.into_values().flatten().flat_map(|item_move| item_move.guards) {
        guarded.entry(guard.0).or_default().insert(guard.1);
    }
    Ok(guarded)
}

/// Returns the step that sends each signal.
fn sends(division: &Division) -> BTreeMap<&Signal, StepIndex> {
    let steps = division.plans.values().flat_map(|plan| (0..).zip(&plan.steps));
    let sends = steps.filter_map(|(index, step)| match &step.action {
        StepAction::Send(signal) => Some((signal, index)),
        StepAction::Wait(_) | StepAction::Task { .. } => None,
    });
    sends.collect()
}

fn own_guards(division: &Division, role: &RoleId, task: &TaskId) -> Vec<StepIndex> {
    let Some(plan) = division.plans.get(role) else { return vec![] };
    let of_task = |action: &StepAction| match action {
        StepAction::Task { id, spec } => id == task && !spec.is_joint(),
        StepAction::Send(signal) => signal.kind == SignalKind::Ready && signal.task == *task,
        StepAction::Wait(_) => false,
    };
    (0..).zip(&plan.steps).filter(|(_, step)| of_task(&step.action)).map(|(index, _)| index).collect()
}

/// Returns the last steps of `guarded_role` on every path to the task, found by walking back from
/// the task and stopping at them.
fn sends_leading_to(
    division: &Division,
    sends: &BTreeMap<&Signal, StepIndex>,
    guarded_role: &RoleId,
    task: &TaskId,
    by: &[RoleId],
) -> Vec<StepIndex> {
    let mut guards = BTreeSet::new();
    let mut seen: BTreeSet<(&RoleId, StepIndex)> = BTreeSet::new();
    let mut open: Vec<(&RoleId, StepIndex)> = Vec::new();
    for role in by {
        let steps = division.plans.get(role).into_iter().flat_map(|plan| (0..).zip(&plan.steps));
        let own = steps.filter(|(_, step)| matches!(&step.action, StepAction::Task { id, .. } if id == task));
        open.extend(own.map(|(index, _)| (role, index)));
    }
    while let Some((role, index)) = open.pop() {
        if role == guarded_role {
            guards.insert(index);
            continue;
        }
        let step = division.plans.get(role).and_then(|plan| plan.steps.get(index as usize));
        let Some(step) = step.filter(|_| seen.insert((role, index))) else { continue };
        open.extend(step.after.iter().map(|sooner| (role, *sooner)));
        if let StepAction::Wait(signal) = &step.action {
            open.extend(sends.get(signal).map(|send| (&signal.from, *send)));
        }
    }
    guards.into_iter().collect()
}
