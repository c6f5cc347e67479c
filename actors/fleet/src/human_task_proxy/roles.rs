//! Unmanaged roles of the active missions, executed as far as the signals of other roles and the
//! people permit.

use super::actor::{HumanTaskProxyMessage, HumanTaskProxySettings, HumanTaskProxyState};
use super::requests::{OpenRequest, RequestSubject};
use crate::robot::{Sequencer, SequencerAction, SignalExchange, StaleSignal, StaleSignals, send_report};
use crate::robot_driver::{PersonCommand, PersonRequestState};
use bytes::Bytes;
use consort_bus::BusError;
use consort_bus::tasks::Tasks;
use consort_protocol::codec;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{ClusterId, MissionId, RobotId, RoleId};
use consort_protocol::keys::{Key, PeopleCall};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::Branch;
use consort_protocol::message::{
    ActiveMissions, ActivePlan, FailureKind, Report, ReportReply, SignalHistory, TaskFailure,
};
use consort_protocol::plan::LocalPlan;
use consort_skills::actions::{ActionError, GoalId, PersonRequest};
use ractor::ActorRef;
use std::time::Duration;
use tracing::{debug, warn};

/// Key of a role: mission and role.
pub(super) type RoleKey = (MissionId, RoleId);

/// Unmanaged role of an active mission.
pub(super) struct ProxyRole {
    pub(super) cluster: Option<ClusterId>,
    pub(super) branch: Branch,
    pub(super) plan: LocalPlan,
    pub(super) sequencer: Sequencer,
    /// Request that the person is working on.
    pub(super) request: Option<OpenRequest>,
    pub(super) failure: Option<TaskFailure>,
    /// Signals received under awards no longer in force; each is reported once.
    pub(super) stale_signals: StaleSignals,
}

impl HumanTaskProxyState {
    /// Ends roles that are no longer active, starts new roles, and updates the others from the
    /// coordinator's reply.
    pub(super) async fn update_missions(
        &mut self,
        myself: &ActorRef<HumanTaskProxyMessage>,
        ActiveMissions { cluster, plans, .. }: ActiveMissions,
    ) -> Result<(), BusError> {
        let active: Vec<_> = plans.iter().map(role_key).collect();
        for key in self.roles.keys().filter(|key| !active.contains(key)).cloned().collect::<Vec<_>>() {
            self.end_role_and_cancel(myself, &key);
        }
        for active in plans {
            self.follow_role(myself, cluster, active).await?;
        }
        Ok(())
    }

    async fn follow_role(
        &mut self,
        myself: &ActorRef<HumanTaskProxyMessage>,
        cluster: Option<ClusterId>,
        active: ActivePlan,
    ) -> Result<(), BusError> {
        let key = role_key(&active);
        match self.roles.get(&key) {
            // The coordinator has not applied the change to the recovery branch yet.
            Some(proxied) if proxied.cluster == cluster && active.branch < proxied.branch => return Ok(()),
            Some(proxied)
                if (proxied.cluster, proxied.branch) != (cluster, active.branch) || proxied.plan != active.plan =>
            {
                self.end_role_and_cancel(myself, &key);
            }
            Some(_) | None => {}
        }
        if self.roles.contains_key(&key) {
            self.update_role(myself, &key, &active);
        } else {
            self.start_role(myself, &key, cluster, &active).await?;
        }
        if let Some(proxied) = self.roles.get_mut(&key) {
            proxied.sequencer.set_vacant_roles(&active.vacant);
            proxied.sequencer.receive_recorded(&active.signals);
            self.advance(myself, &key).await;
        }
        Ok(())
    }

    /// Updates a role: the mission may have new holders.
    fn update_role(&mut self, myself: &ActorRef<HumanTaskProxyMessage>, key: &RoleKey, active: &ActivePlan) {
        let Some(proxied) = self.roles.get_mut(key) else { return };
        proxied.sequencer.set_recorded(&active.ended);
        if *proxied.sequencer.holders() == active.holders {
            return;
        }
        if proxied.sequencer.set_holders(active.holders.clone()) {
            query_signals(&self.signals, &mut self.tasks, myself, &key.0, &proxied.sequencer);
        }
        // The person would meet another robot now, so the request is replaced.
        if let Some(request) = proxied.request.take_if(|request| request.is_outdated(proxied.sequencer.holders())) {
            proxied.sequencer.abort_task();
            self.cancel_request(myself, request.id());
        }
    }

    /// Starts a role. A role with an invalid plan is ignored.
    async fn start_role(
        &mut self,
        myself: &ActorRef<HumanTaskProxyMessage>,
        key: &RoleKey,
        cluster: Option<ClusterId>,
        active: &ActivePlan,
    ) -> Result<(), BusError> {
        let (mission, role) = key;
        let sequencer = match Sequencer::new(active.plan.clone(), &active.ended, active.holders.clone()) {
            Ok(sequencer) => sequencer,
            Err(problem) => {
                warn!(%mission, %role, %problem, "plan cannot be started");
                return Ok(());
            }
        };
        self.signals.start_role(mission, role, Epoch::default(), sequencer.sent_signals().clone()).await?;
        query_signals(&self.signals, &mut self.tasks, myself, mission, &sequencer);
        let proxied = ProxyRole {
            cluster,
            branch: active.branch,
            plan: active.plan.clone(),
            sequencer,
            request: None,
            failure: None,
            stale_signals: StaleSignals::new(),
        };
        self.roles.insert(key.clone(), proxied);
        Ok(())
    }

    /// Receives the signals of another role.
    pub(super) async fn receive_signals(&mut self, myself: &ActorRef<HumanTaskProxyMessage>, history: &SignalHistory) {
        for signal in &history.signals {
            let key = (history.mission.clone(), signal.to.clone());
            let Some(proxied) = self.roles.get_mut(&key) else { continue };
            match proxied.sequencer.receive_signal(signal, history.epoch) {
                Ok(true) => self.advance(myself, &key).await,
                Ok(false) => {}
                Err(StaleSignal { current: known }) => {
                    let event = self.signals.record_stale(&mut proxied.stale_signals, history, signal, known);
                    event.into_iter().for_each(|event| self.settings.events.publish(event));
                }
            }
        }
    }

    /// Handles the end of a request: the person has completed the task, or cannot.
    pub(super) async fn handle_request_ended(
        &mut self,
        myself: &ActorRef<HumanTaskProxyMessage>,
        id: GoalId,
        result: Result<(), ActionError>,
    ) {
        let request =
            self.roles.iter().find(|(_, proxied)| proxied.request.as_ref().is_some_and(|request| request.id() == id));
        let Some(key) = request.map(|(key, _)| key.clone()) else { return };
        let Some(proxied) = self.roles.get_mut(&key) else { return };
        let (Some(OpenRequest { step, .. }), Some(task)) =
            (proxied.request.take(), proxied.sequencer.current_task().cloned())
        else {
            return;
        };
        let (mission, role) = key.clone();
        match result {
            Ok(()) => {
                proxied.sequencer.end_task(step);
                self.settings.events.publish(EventKind::TaskEnded { mission, role, task });
            }
            Err(problem) => {
                let cause = problem.to_string();
                let (failed, kind) = (Some(task.clone()), FailureKind::Task);
                proxied.failure = Some(TaskFailure { task: failed, cause: cause.clone(), kind });
                self.settings.events.publish(EventKind::TaskFailed { mission, role, task, cause });
            }
        }
        self.report(myself, &key);
        self.advance(myself, &key).await;
    }

    /// Renews a request that was canceled although it is still needed, by an earlier decision of
    /// this proxy or by another proxy.
    pub(super) fn renew_request(&mut self, myself: &ActorRef<HumanTaskProxyMessage>, id: GoalId) {
        let mut requests = self.roles.values_mut().filter_map(|proxied| proxied.request.as_mut());
        let Some(request) = requests.find(|request| request.id() == id) else { return };
        request.renew();
        send_person_request(&self.settings, &mut self.tasks, myself, request.id(), Some(request.request()));
    }

    /// Handles the reply to a report: the recorded progress of the role in this branch, or its end.
    pub(super) async fn handle_report_reply(
        &mut self,
        myself: &ActorRef<HumanTaskProxyMessage>,
        key: &RoleKey,
        branch: Branch,
        reply: ReportReply,
    ) {
        let Some(proxied) = self.roles.get_mut(key).filter(|proxied| proxied.branch == branch) else { return };
        match reply {
            ReportReply::Ended { .. } => self.end_role_and_cancel(myself, key),
            ReportReply::Renewed { ended, signals, .. } => {
                proxied.sequencer.set_recorded(&ended);
                proxied.sequencer.receive_recorded(&signals);
                self.advance(myself, key).await;
            }
            ReportReply::NotCoordinator { .. } => {}
        }
    }

    /// Performs the next steps of the plan until it has to wait.
    async fn advance(&mut self, myself: &ActorRef<HumanTaskProxyMessage>, key: &RoleKey) {
        let (mission, role) = key;
        let mut progressed = false;
        while let Some(proxied) = self.roles.get_mut(key).filter(|proxied| proxied.failure.is_none()) {
            let Some(next) = proxied.sequencer.next_action() else { break };
            progressed = true;
            match next {
                SequencerAction::StartTask { step, task, spec } => {
                    let (cluster, branch, holders) =
                        (proxied.cluster, proxied.branch, proxied.sequencer.holders().clone());
                    let (mission, role) = (mission.clone(), role.clone());
                    let event =
                        EventKind::TaskBegan { mission: mission.clone(), role: role.clone(), task: task.clone() };
                    let request =
                        OpenRequest::new(step, RequestSubject { cluster, mission, branch, role, task, spec, holders });
                    self.settings.events.publish(event);
                    send_person_request(&self.settings, &mut self.tasks, myself, request.id(), Some(request.request()));
                    proxied.request = Some(request);
                }
                SequencerAction::SendSignal(signal) => {
                    self.signals.send(mission, &signal).await;
                    self.settings.events.publish(EventKind::Sent { mission: mission.clone(), signal });
                }
                SequencerAction::SignalReceived(signal) => {
                    self.settings.events.publish(EventKind::Received { mission: mission.clone(), signal });
                }
            }
        }
        if progressed {
            self.report(myself, key);
        }
    }

    /// Reports the progress of a role to the ledger.
    pub(super) fn report(&mut self, myself: &ActorRef<HumanTaskProxyMessage>, key: &RoleKey) {
        let (Some(proxied), Some(beacon)) = (self.roles.get(key), &self.coordinator) else { return };
        if proxied.sequencer.ended().is_empty() && proxied.failure.is_none() {
            return; // nothing new for the ledger
        }
        let (mission, role) = key.clone();
        let report = Report {
            robot: RobotId::from(self.settings.node.clone()),
            incarnation: 0,
            mission: mission.clone(),
            role: role.clone(),
            epoch: Epoch::default(),
            branch: proxied.branch,
            ended: proxied.sequencer.ended().clone(),
            current_task: proxied.sequencer.current_task().cloned(),
            place: None,
            from_checkpoint: false,
            failure: proxied.failure.clone(),
        };
        let to_node = self.settings.keys.write(&Key::Report(beacon.node.clone()));
        let (bus, limit, to, branch) =
            (self.settings.bus.clone(), self.settings.tick_interval, myself.clone(), proxied.branch);
        self.tasks.spawn(async move {
            match send_report(bus, &to_node, &report, limit).await {
                // A stopped proxy needs no reply.
                Some(reply) => drop(to.cast(HumanTaskProxyMessage::ReportReplied(mission, role, branch, reply))),
                None => debug!(%mission, %role, "report got no reply; the next timer repeats it"),
            }
        });
    }

    fn end_role_and_cancel(&mut self, myself: &ActorRef<HumanTaskProxyMessage>, key: &RoleKey) {
        let Some(proxied) = self.roles.remove(key) else { return };
        self.signals.end_role(&key.0, &key.1);
        if let Some(request) = proxied.request {
            self.cancel_request(myself, request.id());
        }
    }

    /// Cancels a request. The timer repeats this until it is confirmed, so that no person serves
    /// the request during the next mission.
    fn cancel_request(&mut self, myself: &ActorRef<HumanTaskProxyMessage>, id: GoalId) {
        self.cancellations.add(id);
        send_person_request(&self.settings, &mut self.tasks, myself, id, None);
    }
}

fn role_key(active: &ActivePlan) -> RoleKey {
    (active.mission.clone(), active.plan.role.clone())
}

/// Queries the signal histories of the roles with awaited signals.
pub(super) fn query_signals(
    signals: &SignalExchange,
    tasks: &mut Tasks,
    myself: &ActorRef<HumanTaskProxyMessage>,
    mission: &MissionId,
    sequencer: &Sequencer,
) {
    let to = myself.clone();
    signals.query_history(mission, &sequencer.awaited_signals(), tasks, move |history| {
        // A stopped proxy needs no reply.
        let _ = to.cast(HumanTaskProxyMessage::SignalHistory(history));
    });
}

/// Sends a person request, or cancels it if `request` is `None`.
pub(super) fn send_person_request(
    settings: &HumanTaskProxySettings,
    tasks: &mut Tasks,
    myself: &ActorRef<HumanTaskProxyMessage>,
    id: GoalId,
    request: Option<PersonRequest>,
) {
    let bytes = match codec::encode(&PersonCommand { id, request }) {
        Ok(bytes) => Bytes::from(bytes),
        Err(problem) => return warn!(%problem, "person request does not fit a message"),
    };
    let (bus, key, to) = (settings.bus.clone(), settings.keys.write(&Key::People(PeopleCall::Ask)), myself.clone());
    tasks.spawn(async move {
        let Ok(mut replies) = bus.query(&key, bytes, Duration::from_millis(500)).await else { return };
        while let Some(reply) = replies.recv().await {
            match reply.payload.map(|bytes| codec::decode::<PersonRequestState>(&bytes)) {
                // A stopped proxy needs no reply.
                Ok(Ok(state)) => drop(to.cast(HumanTaskProxyMessage::RequestReplied(id, state))),
                other => debug!(?other, "person request got no reply"),
            }
        }
    });
}
