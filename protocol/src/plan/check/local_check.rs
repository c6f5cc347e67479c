//! (a): each plan by itself, and signals in pairs.

use super::violation::DivisionViolation;
use crate::ids::{RoleId, TaskId};
use crate::plan::local::{Division, LocalPlan, Signal, SignalKind, StepAction, StepIndex};
use crate::plan::order::GlobalOrder;
use std::collections::{BTreeMap, BTreeSet};

/// A role's part in a task, by the task's number.
pub(super) type Part<'a> = (usize, &'a RoleId);
/// A step: whose, and where in its plan.
pub(super) type StepPosition<'a> = (&'a RoleId, usize);

/// First part of the check: each plan by itself, and signals in pairs.
pub(super) struct LocalCheck<'a> {
    pub(super) parts: BTreeMap<Part<'a>, usize>,
    pub(super) pairs: Vec<(StepPosition<'a>, StepPosition<'a>)>,
    pub(super) violations: Vec<DivisionViolation>,
}

impl<'a> LocalCheck<'a> {
    pub(super) fn of(order: &'a GlobalOrder<'a>, division: &'a Division) -> Self {
        let mut survey = LocalCheck { parts: BTreeMap::new(), pairs: Vec::new(), violations: Vec::new() };
        let numbers: BTreeMap<&TaskId, usize> = (0..order.len()).map(|task| (order.id(task), task)).collect();
        for task in 0..order.len() {
            for role in &order.spec(task).roles {
                let number = survey.parts.len();
                survey.parts.insert((task, role), number);
            }
        }
        let roles: BTreeSet<&RoleId> = survey.parts.keys().map(|(_, role)| *role).collect();
        for role in roles.iter().filter(|role| !division.plans.contains_key(**role)) {
            survey.violations.push(DivisionViolation::NoPlan { role: (*role).clone() });
        }
        let (mut sends, mut waits) = (BTreeMap::new(), BTreeMap::new());
        for (role, plan) in &division.plans {
            if plan.role != *role || !roles.contains(role) {
                survey
                    .violations
                    .push(DivisionViolation::UnexpectedPlan { role: role.clone(), says: plan.role.clone() });
                continue;
            }
            survey.plan(order, &numbers, plan);
            survey.signals(order, &numbers, plan, &mut sends, &mut waits);
        }
        for (signal, &send) in &sends {
            match waits.get(signal) {
                Some(wait) => survey.pairs.push((send, *wait)),
                None => survey.violations.push(DivisionViolation::UnmatchedSend { signal: (*signal).clone() }),
            }
        }
        let in_vain = waits.keys().filter(|signal| !sends.contains_key(*signal));
        survey.violations.extend(in_vain.map(|signal| DivisionViolation::UnmatchedWait { signal: (*signal).clone() }));
        survey
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
                None => "which the mission does not have",
                Some(task) if !order.spec(*task).roles.contains(role) => "which is not its own",
                Some(task) if order.spec(*task) != spec => "which differs from the mission's",
                Some(task) if !seen.insert(*task) => "a second time",
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
                "is another role's to send or to await"
            } else if signal.from == signal.to {
                "goes to its own sender"
            } else if !roles.contains(&signal.from) {
                "is of a task in which its sender takes no part"
            } else if signal.kind == SignalKind::Ready && !roles.contains(&signal.to) {
                "is for a role that takes no part in the joint task"
            } else if found.insert(signal, (role, index)).is_some() {
                "stands there twice"
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
