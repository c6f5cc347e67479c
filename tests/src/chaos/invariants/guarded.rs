//! A robot takes an item over, or lets another robot take it, only after the ledger contains all of
//! its preceding steps.
//!
//! Otherwise, if the robot were lost at that instant, the ledger could not show whether the robot
//! has the item.

use super::reference_ledger::ReferenceLedger;
use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId, RoleId};
use consort_protocol::plan::{LocalPlan, StepAction, StepIndex};
use std::collections::BTreeSet;
use std::time::Duration;

#[derive(Default)]
pub(super) struct Guarded {
    reference: ReferenceLedger,
}

impl Guarded {
    /// Checks a step that a robot performs; `is` selects the step by its action.
    fn performs(
        &self,
        node: &NodeId,
        mission: &MissionId,
        role: &RoleId,
        is: impl Fn(&StepAction) -> bool,
    ) -> Result<(), InvariantViolation> {
        let Some(entry) = self.reference.ledger.mission(mission) else { return Ok(()) };
        let (Some(plan), Some(held)) = (entry.plan(role), entry.roles.get(role)) else { return Ok(()) };
        // Another invariant checks whether a robot that does not hold the role may act at all.
        if held.holder.as_ref().is_none_or(|holder| holder.robot.as_str() != node.as_str()) {
            return Ok(());
        }
        let guarded = plan.guarded.iter().filter(|step| plan.steps.get(**step as usize).is_some_and(|s| is(&s.action)));
        for step in guarded {
            let missing: Vec<_> = before(plan, *step).difference(&held.ended).copied().collect();
            if !missing.is_empty() {
                return Err(format!(
                    "{node} performs step {step} as {role} of {mission}, and no ledger has the steps {missing:?} before it"
                ).into());
            }
        }
        Ok(())
    }
}

/// Returns all steps that must end before this step begins.
fn before(plan: &LocalPlan, step: StepIndex) -> BTreeSet<StepIndex> {
    let mut all = BTreeSet::new();
    let mut open = vec![step];
    while let Some(step) = open.pop() {
        let after = plan.steps.get(step as usize).map_or(&[][..], |step| &step.after);
        open.extend(after.iter().filter(|before| all.insert(**before)));
    }
    all
}

impl Invariant for Guarded {
    fn name(&self) -> &'static str {
        "guarded"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, fleet: &Fleet) -> Result<(), InvariantViolation> {
        self.reference.observe(entry);
        let node = entry.node();
        match entry.event_kind() {
            Some(EventKind::TaskBegan { mission, role, task }) if fleet.is_robot(node) => {
                self.performs(node, mission, role, |action| matches!(action, StepAction::Task { id, .. } if id == task))
            }
            Some(EventKind::Sent { mission, signal }) if fleet.is_robot(node) => {
                let is = |action: &StepAction| matches!(action, StepAction::Send(sent) if sent == signal);
                self.performs(node, mission, &signal.from, is)
            }
            _ => Ok(()),
        }
    }
}
