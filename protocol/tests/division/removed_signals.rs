//! Divisions from which steps or signals were removed.

use consort_protocol::ids::RoleId;
use consort_protocol::plan::{Division, Signal, StepAction, StepIndex};
use std::collections::{BTreeMap, BTreeSet};

/// Removes a step from the division; its successors get its predecessors.
pub(crate) fn without_step(division: &Division, role: &RoleId, step: usize) -> Division {
    let mut division = division.clone();
    let plan = division.plans.get_mut(role).unwrap();
    let removed = plan.steps.remove(step);
    for later in &mut plan.steps[step..] {
        let was_after = later.after.contains(&(step as StepIndex));
        let mut after: BTreeSet<StepIndex> = later
            .after
            .iter()
            .filter(|index| **index as usize != step)
            .map(|index| if *index as usize > step { index - 1 } else { *index })
            .collect();
        if was_after {
            after.extend(&removed.after);
        }
        later.after = after.into_iter().collect();
    }
    division
}

/// Position of a step: role and index.
pub(crate) type StepPlace = (RoleId, usize);

/// Returns every signal, with the positions of its send and its wait.
pub(crate) fn signals(division: &Division) -> Vec<(Signal, StepPlace, StepPlace)> {
    let mut places: BTreeMap<Signal, [Option<StepPlace>; 2]> = BTreeMap::new();
    for (role, plan) in &division.plans {
        for (index, step) in plan.steps.iter().enumerate() {
            let (signal, which) = match &step.action {
                StepAction::Send(signal) => (signal, 0),
                StepAction::Wait(signal) => (signal, 1),
                StepAction::Task { .. } => continue,
            };
            places.entry(signal.clone()).or_default()[which] = Some((role.clone(), index));
        }
    }
    places.into_iter().map(|(signal, [send, wait])| (signal, send.unwrap(), wait.unwrap())).collect()
}

/// Removes a signal from the division.
pub(crate) fn without_signal(division: &Division, signal: &Signal) -> Division {
    let (_, send, wait) = signals(division).into_iter().find(|(other, ..)| other == signal).unwrap();
    without_step(&without_step(division, &send.0, send.1), &wait.0, wait.1)
}
