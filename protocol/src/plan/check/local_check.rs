//! Check (a): each plan alone, and the pairs of signals.

use super::violation::DivisionViolation;
use crate::ids::{RoleId, TaskId};
use crate::mission::GlobalOrder;
use crate::plan::local::{Division, LocalPlan, Signal, SignalKind, StepAction, StepIndex};
use std::collections::{BTreeMap, BTreeSet};

/// Part of a role in a task: task number and role.
pub(super) type Part<'a> = (usize, &'a RoleId);
/// Position of a step: role and index in its plan.
pub(super) type StepPosition<'a> = (&'a RoleId, usize);

/// First part of the check: each plan alone, and the pairs of signals.
pub(super) struct LocalCheck<'a> {
    pub(super) parts: BTreeMap<Part<'a>, usize>,
    pub(super) pairs: Vec<(StepPosition<'a>, StepPosition<'a>)>,
    pub(super) violations: Vec<DivisionViolation>,
}

impl<'a> LocalCheck<'a> {
    pub(super) fn of(order: &'a GlobalOrder<'a>, division: &'a Division) -> Self {
        let mut check = LocalCheck { parts: BTreeMap::new(), pairs: Vec::new(), violations: Vec::new() };
        let numbers: BTreeMap<&TaskId, usize> = (0..order.len()).map(|task| (order.id(task), task)).collect();
        for task in 0..order.len() {
            for role in &order.spec(task).roles {
                let number = check.parts.len();
                check.parts.insert((task, role), number);
            }
        }
        let roles: BTreeSet<&RoleId> = check.parts.keys().map(|(_, role)| *role).collect();
        for role in roles.iter().filter(|role| !division.plans.contains_key(**role)) {
            check.violations.push(DivisionViolation::NoPlan { role: (*role).clone() });
        }
        let (mut sends, mut waits) = (BTreeMap::new(), BTreeMap::new());
        for (role, plan) in &division.plans {
            if plan.role != *role || !roles.contains(role) {
                check
                    .violations
                    .push(DivisionViolation::UnexpectedPlan { role: role.clone(), stated: plan.role.clone() });
                continue;
            }
            check.plan(order, &numbers, plan);
            check.signals(order, &numbers, plan, &mut sends, &mut waits);
        }
        for (signal, &send) in &sends {
            match waits.get(signal) {
                Some(wait) => check.pairs.push((send, *wait)),
                None => check.violations.push(DivisionViolation::UnmatchedSend { signal: (*signal).clone() }),
            }
        }
        let unmatched_waits = waits.keys().filter(|signal| !sends.contains_key(*signal));
        check
            .violations
            .extend(unmatched_waits.map(|signal| DivisionViolation::UnmatchedWait { signal: (*signal).clone() }));
        check
    }

    fn plan(&mut self, order: &GlobalOrder<'_>, numbers: &BTreeMap<&TaskId, usize>, plan: &'a LocalPlan) {
        let role = &plan.role;
        let mut seen: BTreeSet<usize> = BTreeSet::new();
        for (index, step) in plan.steps.iter().enumerate() {
            let in_order = step.after.is_sorted_by(|a, b| a < b);
            if !in_order || step.after.last().is_some_and(|last| *last as usize >= index) {
                let (step, after) = (index as StepIndex, step.after.clone());
                self.violations.push(DivisionViolation::InvalidPredecessors { role: role.clone(), step, after });
            }
            let StepAction::Task { id, spec } = &step.action else { continue };
            let problem = match numbers.get(id) {
                None => "which is not a task of the mission",
                Some(task) if !order.spec(*task).roles.contains(role) => "which is not assigned to the role",
                Some(task) if order.spec(*task) != spec => "which differs from the mission's",
                Some(task) if !seen.insert(*task) => "more than once",
                Some(_) => continue,
            };
            self.violations.push(DivisionViolation::UnexpectedTask { role: role.clone(), task: id.clone(), problem });
        }
        for (task, _) in self.parts.keys().filter(|(task, own)| *own == role && !seen.contains(task)) {
            self.violations.push(DivisionViolation::TaskMissing { role: role.clone(), task: order.id(*task).clone() });
        }
    }

    fn signals(
        &mut self,
        order: &GlobalOrder<'_>,
        numbers: &BTreeMap<&TaskId, usize>,
        plan: &'a LocalPlan,
        sends: &mut BTreeMap<&'a Signal, StepPosition<'a>>,
        waits: &mut BTreeMap<&'a Signal, StepPosition<'a>>,
    ) {
        let role = &plan.role;
        for (index, step) in plan.steps.iter().enumerate() {
            let (signal, own, found) = match &step.action {
                StepAction::Task { .. } => continue,
                StepAction::Send(signal) => (signal, &signal.from, &mut *sends),
                StepAction::Wait(signal) => (signal, &signal.to, &mut *waits),
            };
            let roles = numbers.get(&signal.task).map_or(&[][..], |task| &order.spec(*task).roles);
            let problem = if own != role {
                "must be sent or awaited by another role"
            } else if signal.from == signal.to {
                "has the same sender and receiver"
            } else if !roles.contains(&signal.from) {
                "belongs to a task in which its sender takes no part"
            } else if signal.kind == SignalKind::Ready && !roles.contains(&signal.to) {
                "has a receiver that takes no part in the joint task"
            } else if found.insert(signal, (role, index)).is_some() {
                "occurs twice"
            } else {
                continue;
            };
            self.violations.push(DivisionViolation::InvalidSignal {
                role: role.clone(),
                signal: signal.clone(),
                problem,
            });
        }
    }
}
