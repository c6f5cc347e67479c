//! Unmanaged roles of the active missions, executed as far as the signals of other roles and the
//! people permit.

use super::proxy_role::{HolderChange, PlanChange, ProxyRole, RoleKey};
use super::state::HumanTaskProxyState;
use crate::robot::{ReceivedSignals, SequencerAction, SignalEffect, StaleSignal};
use consort_bus::Author;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{ClusterId, TaskId};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::Branch;
use consort_protocol::message::{ActiveMissions, ActivePlan, FailureKind, ReportReply, TaskFailure};
use consort_skills::actions::{ActionError, GoalId};
use tracing::warn;

impl HumanTaskProxyState {
    /// Ends roles that are no longer active, starts new roles, and updates the others from the
    /// coordinator's reply.
    pub(super) async fn update_missions(&mut self, ActiveMissions { cluster, plans, .. }: ActiveMissions) {
        let active: Vec<_> = plans.iter().map(role_key).collect();
        for key in self.roles.keys().filter(|key| !active.contains(key)).cloned().collect::<Vec<_>>() {
            self.end_role_and_cancel(&key);
        }
        for active in plans {
            self.follow_role(cluster, active).await;
        }
    }

    async fn follow_role(&mut self, cluster: Option<ClusterId>, active: ActivePlan) {
        let key = role_key(&active);
        match self.roles.get(&key).map(|proxied| proxied.compare(cluster, &active)) {
            Some(PlanChange::Outdated) => return,
            Some(PlanChange::Same) => self.update_role(&key, &active),
            Some(PlanChange::Replaced) => {
                self.end_role_and_cancel(&key);
                self.start_role(&key, cluster, &active);
            }
            None => self.start_role(&key, cluster, &active),
        }
        if let Some(proxied) = self.roles.get_mut(&key) {
            proxied.sequencer.set_vacant_roles(&active.vacant);
            proxied.sequencer.receive_recorded(&active.signals);
            self.advance(&key).await;
        }
    }

    /// Updates a role: the mission may have new holders.
    fn update_role(&mut self, key: &RoleKey, active: &ActivePlan) {
        let Some(proxied) = self.roles.get_mut(key) else { return };
        let HolderChange { query_signals, outdated_request } = proxied.update(active);
        if query_signals {
            self.query_signals(key);
        }
        if let Some(request) = outdated_request {
            self.cancel_request(request);
        }
    }

    /// Starts a role. A role with an invalid plan is ignored.
    fn start_role(&mut self, key: &RoleKey, cluster: Option<ClusterId>, active: &ActivePlan) {
        let (mission, role) = key;
        let proxied = match ProxyRole::start(cluster, active) {
            Ok(proxied) => proxied,
            Err(problem) => {
                return warn!(%mission, %role, %problem, "plan cannot be started");
            }
        };
        let sent = proxied.sequencer.sent_signals().clone();
        self.signals.start_role(mission, role, Epoch::default(), sent);
        self.roles.insert(key.clone(), proxied);
        self.query_signals(key);
    }

    /// Receives the signals of another role.
    pub(super) async fn receive_signals(&mut self, ReceivedSignals { history, author }: &ReceivedSignals) {
        for signal in &history.signals {
            let key = (history.mission.clone(), signal.to.clone());
            let Some(proxied) = self.roles.get_mut(&key) else { continue };
            match proxied.sequencer.receive_signal(signal, history.epoch, author) {
                Ok(SignalEffect::Received) => self.advance(&key).await,
                Ok(SignalEffect::None) => {}
                // The reply contains the present holders.
                Ok(SignalEffect::AwaitsConfirmation) => self.query_missions(),
                Err(StaleSignal { current: known }) => {
                    let event = self.signals.record_stale(&mut proxied.stale_signals, history, signal, known);
                    event.into_iter().for_each(|event| self.settings.events.publish(event));
                }
            }
        }
    }

    /// Handles the end of a request: the person has completed the task, or cannot.
    pub(super) async fn handle_request_ended(&mut self, id: GoalId, result: Result<(), ActionError>, author: &Author) {
        let Some((key, proxied)) = self.roles.iter_mut().find(|(_, proxied)| proxied.has_request(id)) else { return };
        let key = key.clone();
        if !author.may_serve(key.1.as_str()) {
            return warn!(%author, role = %key.1, "the author does not serve this person: result ignored");
        }
        let Some(event) = proxied.end_request(&key, result) else { return };
        self.settings.events.publish(event);
        self.report(&key);
        self.advance(&key).await;
    }

    /// Renews a request that was canceled although it is still needed, by an earlier decision of
    /// this proxy or by another proxy.
    pub(super) fn renew_request(&mut self, id: GoalId) {
        let Some((key, proxied)) = self.roles.iter_mut().find(|(_, proxied)| proxied.has_request(id)) else { return };
        let key = key.clone();
        proxied.request.iter_mut().for_each(|request| request.renew());
        self.send_open_request(&key);
    }

    /// Handles the reply to a report: the recorded progress of the role in this branch, or its end.
    pub(super) async fn handle_report_reply(&mut self, key: &RoleKey, branch: Branch, reply: ReportReply) {
        let Some(proxied) = self.roles.get_mut(key).filter(|proxied| proxied.branch == branch) else { return };
        match reply {
            ReportReply::Ended { .. } => self.end_role_and_cancel(key),
            ReportReply::Renewed { ended, signals, outcomes, .. } => {
                proxied.sequencer.set_recorded(&ended);
                proxied.sequencer.set_recorded_outcomes(outcomes);
                proxied.sequencer.receive_recorded(&signals);
                self.advance(key).await;
            }
            ReportReply::NotCoordinator { .. } => {}
        }
    }

    /// Performs the next steps of the plan until it has to wait.
    async fn advance(&mut self, key: &RoleKey) {
        let mission = &key.0;
        let mut progressed = false;
        while let Some(proxied) = self.roles.get_mut(key).filter(|proxied| proxied.failure.is_none()) {
            let Some(next) = proxied.sequencer.next_action() else { break };
            progressed = true;
            match next {
                SequencerAction::StartTask { step, task, spec } => {
                    let event = task_began(key, &task);
                    proxied.open_request(key, step, task, spec);
                    self.settings.events.publish(event);
                    self.send_open_request(key);
                }
                SequencerAction::SendSignal(signal) => {
                    self.signals.send(mission, &signal);
                    self.settings.events.publish(EventKind::Sent { mission: mission.clone(), signal });
                }
                SequencerAction::TaskSkipped(task) => {
                    let (mission, role) = key.clone();
                    self.settings.events.publish(EventKind::TaskSkipped { mission, role, task });
                }
                SequencerAction::ResultUnknown { task, cause } => {
                    let (mission, role) = key.clone();
                    proxied.failure = Some(TaskFailure {
                        task: Some(task.clone()),
                        cause: cause.clone(),
                        kind: FailureKind::UnknownResult,
                    });
                    self.settings.events.publish(EventKind::TaskFailed { mission, role, task, cause });
                }
                SequencerAction::SignalReceived(signal) => {
                    self.settings.events.publish(EventKind::Received { mission: mission.clone(), signal });
                }
            }
        }
        if progressed {
            self.report(key);
        }
    }

    fn end_role_and_cancel(&mut self, key: &RoleKey) {
        let Some(proxied) = self.roles.remove(key) else { return };
        self.signals.end_role(&key.0, &key.1);
        if let Some(request) = proxied.request {
            self.cancel_request(request.id());
        }
    }
}

fn role_key(active: &ActivePlan) -> RoleKey {
    (active.mission.clone(), active.plan.role.clone())
}

fn task_began((mission, role): &RoleKey, task: &TaskId) -> EventKind {
    EventKind::TaskBegan { mission: mission.clone(), role: role.clone(), task: task.clone() }
}
