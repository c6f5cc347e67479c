//! Write-ahead of custody: which steps wait until the ledger knows what came before them.
//!
//! A robot may be lost at any moment, and with it all that it has not reported. So that nobody need guess whether it has
//! the sample in its drawer, the task that moves an item cannot begin before the ledger is known to hold a step that
//! comes before it. What the ledger does not hold of a guard's predecessors tells that the item was not moved.
//!
//! ```text
//!   r1                                   nurse                 deposit gives the sample to r1:
//!   open ─ [ledger has `open`] ─ done ─► wait, deposit         the guard is r1's `done:open`
//! ```
//!
//! The guard of a move stands with the role that gets the item. If that is nobody, or a person, it stands with the role
//! that has it, and if that is nobody either, with the robots that do the task. A role that does the task itself is
//! guarded at its own step, or, where the task is joint, at each `ready` that it sends for it, since its partners begin when
//! they have heard it; another one at the sends by which those who do it learn, directly or through others, that they may
//! begin. A task that waits for nothing of that role has no guard: it
//! may have been done as soon as the role is held.

use super::local::{Division, Signal, SignalKind, StepAction, StepIndex};
use super::order::GlobalOrder;
use crate::ids::{ItemId, RoleId, TaskId};
use crate::mission::{Mission, MissionErrors, RoleKind};
use std::collections::{BTreeMap, BTreeSet};

/// A task that moves an item.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ItemMove {
    /// The task.
    pub task: TaskId,
    /// Who does it.
    pub performers: Vec<RoleId>,
    /// Who has the item afterwards; `None` for nobody of the mission.
    pub receiver: Option<RoleId>,
    /// It begins after each of these steps, which are performed only when the ledger holds all that ended before them.
    pub guards: Vec<(RoleId, StepIndex)>,
}

/// How a divided mission moves its items: for each, the moves in their order.
///
/// # Errors
/// [`MissionErrors`] if the mission has no order, or moves an item in none.
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
            let keepers: Vec<&RoleId> = match to.filter(|to| managed(to)).or(holder.filter(|from| managed(from))) {
                Some(keeper) => vec![keeper],
                None => spec.roles.iter().filter(|role| managed(role)).collect(),
            };
            let mut guards: Vec<(RoleId, StepIndex)> = Vec::new();
            for keeper in keepers {
                let steps = match spec.roles.contains(keeper) {
                    true => own_guards(division, keeper, id),
                    false => told_by(division, &sends, keeper, id, &spec.roles),
                };
                guards.extend(steps.into_iter().map(|step| (keeper.clone(), step)));
            }
            moves.push(ItemMove { task: id.clone(), performers: spec.roles.clone(), receiver: to.cloned(), guards });
            holder = to;
        }
        all.insert(item.clone(), moves);
    }
    Ok(all)
}

/// For each role, its guarded steps.
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

/// Where each signal is sent.
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

/// The last steps of `keeper` on every way to the task: from the task back, not beyond them.
fn told_by(
    division: &Division,
    sends: &BTreeMap<&Signal, StepIndex>,
    keeper: &RoleId,
    task: &TaskId,
    by: &[RoleId],
) -> Vec<StepIndex> {
    let mut found = BTreeSet::new();
    let mut seen: BTreeSet<(&RoleId, StepIndex)> = BTreeSet::new();
    let mut open: Vec<(&RoleId, StepIndex)> = Vec::new();
    for role in by {
        let steps = division.plans.get(role).into_iter().flat_map(|plan| (0..).zip(&plan.steps));
        let own = steps.filter(|(_, step)| matches!(&step.action, StepAction::Task { id, .. } if id == task));
        open.extend(own.map(|(index, _)| (role, index)));
    }
    while let Some((role, index)) = open.pop() {
        if role == keeper {
            found.insert(index);
            continue;
        }
        let step = division.plans.get(role).and_then(|plan| plan.steps.get(index as usize));
        let Some(step) = step.filter(|_| seen.insert((role, index))) else { continue };
        open.extend(step.after.iter().map(|sooner| (role, *sooner)));
        if let StepAction::Wait(signal) = &step.action {
            open.extend(sends.get(signal).map(|send| (&signal.from, *send)));
        }
    }
    found.into_iter().collect()
}
