//! An unmanaged role of an active mission, as a value.

use super::requests::{OpenRequest, RequestSubject};
use crate::robot::{Sequencer, StaleSignals, StepRef};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{ClusterId, MissionId, RobotId, RoleId, TaskId};
use consort_protocol::ledger::Branch;
use consort_protocol::message::{ActivePlan, FailureKind, TaskFailure};
use consort_protocol::mission::TaskSpec;
use consort_protocol::plan::{LocalPlan, ProgressError};
use consort_skills::actions::{ActionError, GoalId};
use std::collections::BTreeMap;

/// Key of a role: mission and role.
pub(super) type RoleKey = (MissionId, RoleId);

/// Unmanaged role of an active mission.
pub(super) struct ProxyRole {
    pub(super) cluster: Option<ClusterId>,
    pub(super) branch: Branch,
    plan: LocalPlan,
    pub(super) sequencer: Sequencer,
    /// Request that the person is working on.
    pub(super) request: Option<OpenRequest>,
    pub(super) failure: Option<TaskFailure>,
    /// Signals received under awards no longer in force; each is reported once.
    pub(super) stale_signals: StaleSignals,
}

/// Effect of a coordinator's reply on a role that is executed already.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PlanChange {
    /// The coordinator has not applied the change to the recovery branch yet.
    Outdated,
    /// Another plan replaces the plan of the role.
    Replaced,
    /// The plan is unchanged.
    Same,
}

/// Effect of new holders on a role.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct HolderChange {
    /// Signals of a former holder were discarded: its successor is queried.
    pub(super) query_signals: bool,
    /// The person would meet another robot now: this request is canceled and sent anew.
    pub(super) outdated_request: Option<GoalId>,
}

impl ProxyRole {
    /// Starts a role.
    ///
    /// # Errors
    /// [`ProgressError`] if the recorded steps do not fit the plan.
    pub(super) fn start(cluster: Option<ClusterId>, active: &ActivePlan) -> Result<ProxyRole, ProgressError> {
        Ok(ProxyRole {
            cluster,
            branch: active.branch,
            plan: active.plan.clone(),
            sequencer: Sequencer::new(active.plan.clone(), &active.ended, active.holders.clone())?,
            request: None,
            failure: None,
            stale_signals: StaleSignals::new(),
        })
    }

    /// Compares the role with the plan that a coordinator of `cluster` returned.
    pub(super) fn compare(&self, cluster: Option<ClusterId>, active: &ActivePlan) -> PlanChange {
        match () {
            () if self.cluster == cluster && active.branch < self.branch => PlanChange::Outdated,
            () if (self.cluster, self.branch) != (cluster, active.branch) || self.plan != active.plan => {
                PlanChange::Replaced
            }
            () => PlanChange::Same,
        }
    }

    /// Updates the recorded steps and the holders.
    pub(super) fn update(&mut self, active: &ActivePlan) -> HolderChange {
        self.sequencer.set_recorded(&active.ended);
        if *self.sequencer.holders() == active.holders {
            return HolderChange { query_signals: false, outdated_request: None };
        }
        let query_signals = self.sequencer.set_holders(active.holders.clone());
        let outdated = self.request.take_if(|request| request.is_outdated(self.sequencer.holders()));
        if outdated.is_some() {
            self.sequencer.abort_task();
        }
        HolderChange { query_signals, outdated_request: outdated.map(|request| request.id()) }
    }

    /// Checks whether a robot takes part in the mission.
    pub(super) fn is_with(&self, robot: &RobotId) -> bool {
        self.sequencer.holders().values().any(|holding| holding.robot == *robot)
    }

    /// Checks whether this request of the role is open.
    pub(super) fn has_request(&self, id: GoalId) -> bool {
        self.request.as_ref().is_some_and(|request| request.id() == id)
    }

    /// Opens the request for a task of the person.
    pub(super) fn open_request(&mut self, (mission, role): &RoleKey, step: StepRef, task: TaskId, spec: TaskSpec) {
        let (cluster, branch, holders) = (self.cluster, self.branch, self.sequencer.holders().clone());
        let (mission, role) = (mission.clone(), role.clone());
        let subject = RequestSubject { cluster, mission, branch, role, task, spec, holders };
        self.request = Some(OpenRequest::new(step, subject));
    }

    /// Ends the open request: the person has completed the task, or cannot. Returns the event to be
    /// published.
    pub(super) fn end_request(&mut self, key: &RoleKey, result: Result<(), ActionError>) -> Option<EventKind> {
        let OpenRequest { step, .. } = self.request.take()?;
        let task = self.sequencer.current_task().cloned()?;
        let (mission, role) = key.clone();
        Some(match result {
            Ok(()) => {
                self.sequencer.end_task(step, BTreeMap::new());
                EventKind::TaskEnded { mission, role, task }
            }
            Err(problem) => {
                let cause = problem.to_string();
                let (failed, kind) = (Some(task.clone()), FailureKind::Task);
                self.failure = Some(TaskFailure { task: failed, cause: cause.clone(), kind });
                EventKind::TaskFailed { mission, role, task, cause }
            }
        })
    }

    /// Checks whether the ledger may lack something that happened in the role.
    pub(super) fn has_news(&self) -> bool {
        !self.sequencer.ended().is_empty() || self.failure.is_some()
    }
}
