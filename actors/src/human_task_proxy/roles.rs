//! The unmanaged roles of missions under way, as far as the others' signals and people allow.

use super::actor::{HumanTaskProxyMessage, HumanTaskProxySettings, HumanTaskProxyState};
use super::requests::{OpenRequest, RequestSubject};
use crate::bus::BusError;
use crate::robot::{Sequencer, SequencerAction, SignalExchange, StaleSignal, StaleSignals, send_report};
use crate::robot_driver::{PersonCommand, PersonRequestState};
use crate::tasks::Tasks;
use bytes::Bytes;
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

/// Which role of which mission.
pub(super) type RoleKey = (MissionId, RoleId);

/// One unmanaged role of a mission under way.
pub(super) struct ProxyRole {
    pub(super) cluster: Option<ClusterId>,
    pub(super) branch: Branch,
    pub(super) plan: LocalPlan,
    pub(super) sequencer: Sequencer,
    /// What the person is at.
    pub(super) request: Option<OpenRequest>,
    pub(super) failure: Option<TaskFailure>,
    /// What was said under awards no longer in force, so that each is told of once.
    pub(super) stale_signals: StaleSignals,
}

impl HumanTaskProxyState {
    /// Puts down what is no longer under way, takes up what is new, and goes on with the rest as the coordinator knows it.
    pub(super) async fn update_missions(
        &mut self,
        myself: &ActorRef<HumanTaskProxyMessage>,
        ActiveMissions { cluster, plans, .. }: ActiveMissions,
    ) -> Result<(), BusError> {
        let live: Vec<_> = plans.iter().map(key_of).collect();
        for key in self.roles.keys().filter(|key| !live.contains(key)).cloned().collect::<Vec<_>>() {
            self.put_down(myself, &key);
        }
        for live in plans {
            self.follow_role(myself, cluster, live).await?;
        }
        Ok(())
    }

    async fn follow_role(
        &mut self,
        myself: &ActorRef<HumanTaskProxyMessage>,
        cluster: Option<ClusterId>,
        live: ActivePlan,
    ) -> Result<(), BusError> {
        let key = key_of(&live);
        match self.roles.get(&key) {
            // Said by a coordinator that has yet to learn of the recovery branch.
            Some(job) if job.cluster == cluster && live.branch < job.branch => return Ok(()),
            Some(job) if (job.cluster, job.branch) != (cluster, live.branch) || job.plan != live.plan => {
                self.put_down(myself, &key);
            }
            Some(_) | None => {}
        }
        if self.roles.contains_key(&key) {
            self.keep_up(myself, &key, &live);
        } else {
            self.take_up(myself, &key, cluster, &live).await?;
        }
        if let Some(job) = self.roles.get_mut(&key) {
            job.sequencer.set_vacant_roles(&live.vacant);
            job.sequencer.receive_recorded(&live.signals);
            self.advance(myself, &key).await;
        }
        Ok(())
    }

    /// Goes on with a role of which others' parts may have changed hands.
    fn keep_up(&mut self, myself: &ActorRef<HumanTaskProxyMessage>, key: &RoleKey, live: &ActivePlan) {
        let Some(job) = self.roles.get_mut(key) else { return };
        job.sequencer.set_recorded(&live.ended);
        if *job.sequencer.holders() == live.holders {
            return;
        }
        if job.sequencer.set_holders(live.holders.clone()) {
            query_signals(&self.signals, &mut self.tasks, myself, &key.0, &job.sequencer);
        }
        // Whoever was to be met is somebody else now: ask anew.
        if let Some(asked) = job.request.take_if(|asked| asked.is_outdated(job.sequencer.holders())) {
            job.sequencer.abort_task();
            self.dismiss(myself, asked.id());
        }
    }

    /// Begins with a role; one whose plan makes no sense is left alone.
    async fn take_up(
        &mut self,
        myself: &ActorRef<HumanTaskProxyMessage>,
        key: &RoleKey,
        cluster: Option<ClusterId>,
        live: &ActivePlan,
    ) -> Result<(), BusError> {
        let (mission, role) = key;
        let sequencer = match Sequencer::new(live.plan.clone(), &live.ended, live.holders.clone()) {
            Ok(sequencer) => sequencer,
            Err(problem) => {
                warn!(%mission, %role, %problem, "a plan that cannot be taken up");
                return Ok(());
            }
        };
        self.signals.start_role(mission, role, Epoch::default(), sequencer.sent_signals().clone()).await?;
        query_signals(&self.signals, &mut self.tasks, myself, mission, &sequencer);
        let job = ProxyRole {
            cluster,
            branch: live.branch,
            plan: live.plan.clone(),
            sequencer,
            request: None,
            failure: None,
            stale_signals: StaleSignals::new(),
        };
        self.roles.insert(key.clone(), job);
        Ok(())
    }

    /// Another role said something.
    pub(super) async fn receive_signals(&mut self, myself: &ActorRef<HumanTaskProxyMessage>, said: &SignalHistory) {
        for signal in &said.signals {
            let key = (said.mission.clone(), signal.to.clone());
            let Some(job) = self.roles.get_mut(&key) else { continue };
            match job.sequencer.receive_signal(signal, said.epoch) {
                Ok(true) => self.advance(myself, &key).await,
                Ok(false) => {}
                Err(StaleSignal { current: known }) => {
                    let told = self.signals.record_stale(&mut job.stale_signals, said, signal, known);
                    told.into_iter().for_each(|what| self.settings.events.publish(what));
                }
            }
        }
    }

    /// A person has done what was asked, or cannot.
    pub(super) async fn handle_request_ended(
        &mut self,
        myself: &ActorRef<HumanTaskProxyMessage>,
        id: GoalId,
        result: Result<(), ActionError>,
    ) {
        let asked = self.roles.iter().find(|(_, job)| job.request.as_ref().is_some_and(|asked| asked.id() == id));
        let Some(key) = asked.map(|(key, _)| key.clone()) else { return };
        let Some(job) = self.roles.get_mut(&key) else { return };
        let (Some(OpenRequest { step: spot, .. }), Some(task)) =
            (job.request.take(), job.sequencer.current_task().cloned())
        else {
            return;
        };
        let (mission, role) = key.clone();
        match result {
            Ok(()) => {
                job.sequencer.end_task(spot);
                self.settings.events.publish(EventKind::TaskEnded { mission, role, task });
            }
            Err(problem) => {
                let cause = problem.to_string();
                let (failed, kind) = (Some(task.clone()), FailureKind::Task);
                job.failure = Some(TaskFailure { task: failed, cause: cause.clone(), kind });
                self.settings.events.publish(EventKind::TaskFailed { mission, role, task, cause });
            }
        }
        self.report(myself, &key);
        self.advance(myself, &key).await;
    }

    /// Somebody has called off what is still wanted: this attendant itself, before it knew better, or another.
    pub(super) fn renew_request(&mut self, myself: &ActorRef<HumanTaskProxyMessage>, id: GoalId) {
        let mut asks = self.roles.values_mut().filter_map(|job| job.request.as_mut());
        let Some(asked) = asks.find(|asked| asked.id() == id) else { return };
        asked.renew();
        send_person_request(&self.settings, &mut self.tasks, myself, asked.id(), Some(asked.request()));
    }

    /// The ledger knows how far a role has come in this branch, or that there is no more to do.
    pub(super) async fn handle_report_reply(
        &mut self,
        myself: &ActorRef<HumanTaskProxyMessage>,
        key: &RoleKey,
        branch: Branch,
        answer: ReportReply,
    ) {
        let Some(job) = self.roles.get_mut(key).filter(|job| job.branch == branch) else { return };
        match answer {
            ReportReply::Ended { .. } => self.put_down(myself, key),
            ReportReply::Renewed { ended, signals: told, .. } => {
                job.sequencer.set_recorded(&ended);
                job.sequencer.receive_recorded(&told);
                self.advance(myself, key).await;
            }
            ReportReply::NotCoordinator { .. } => {}
        }
    }

    /// Does whatever the plan has next, until it has to wait.
    async fn advance(&mut self, myself: &ActorRef<HumanTaskProxyMessage>, key: &RoleKey) {
        let (mission, role) = key;
        let mut moved = false;
        while let Some(job) = self.roles.get_mut(key).filter(|job| job.failure.is_none()) {
            let Some(next) = job.sequencer.next_action() else { break };
            moved = true;
            match next {
                SequencerAction::StartTask { step: spot, task, spec } => {
                    let (cluster, branch, holders) = (job.cluster, job.branch, job.sequencer.holders().clone());
                    let (mission, role) = (mission.clone(), role.clone());
                    let began =
                        EventKind::TaskBegan { mission: mission.clone(), role: role.clone(), task: task.clone() };
                    let asked = OpenRequest::first(
                        spot,
                        RequestSubject { cluster, mission, branch, role, task, spec, holders },
                    );
                    self.settings.events.publish(began);
                    send_person_request(&self.settings, &mut self.tasks, myself, asked.id(), Some(asked.request()));
                    job.request = Some(asked);
                }
                SequencerAction::SendSignal(signal) => {
                    self.signals.send(mission, &signal).await;
                    self.settings.events.publish(EventKind::Sent { mission: mission.clone(), signal });
                }
                SequencerAction::SignalReceived(signal) => {
                    self.settings.events.publish(EventKind::Heard { mission: mission.clone(), signal });
                }
            }
        }
        if moved {
            self.report(myself, key);
        }
    }

    /// Lets the ledger know how far the role has come.
    pub(super) fn report(&mut self, myself: &ActorRef<HumanTaskProxyMessage>, key: &RoleKey) {
        let (Some(job), Some(beacon)) = (self.roles.get(key), &self.coordinator) else { return };
        if job.sequencer.ended().is_empty() && job.failure.is_none() {
            return; // nothing that the ledger does not know
        }
        let (mission, role) = key.clone();
        let report = Report {
            robot: RobotId::from(self.settings.node.clone()),
            incarnation: 0,
            mission: mission.clone(),
            role: role.clone(),
            epoch: Epoch::default(),
            branch: job.branch,
            ended: job.sequencer.ended().clone(),
            current_task: job.sequencer.current_task().cloned(),
            place: None,
            from_checkpoint: false,
            failure: job.failure.clone(),
        };
        let to_node = self.settings.keys.write(&Key::Report(beacon.node.clone()));
        let (bus, limit, to, branch) =
            (self.settings.bus.clone(), self.settings.tick_interval, myself.clone(), job.branch);
        self.tasks.spawn(async move {
            match send_report(bus, &to_node, &report, limit).await {
                // An attendant that has stopped needs no answer.
                Some(answer) => drop(to.cast(HumanTaskProxyMessage::ReportReplied(mission, role, branch, answer))),
                None => debug!(%mission, %role, "a report was not answered; the next beat repeats it"),
            }
        });
    }

    fn put_down(&mut self, myself: &ActorRef<HumanTaskProxyMessage>, key: &RoleKey) {
        let Some(job) = self.roles.remove(key) else { return };
        self.signals.end_role(&key.0, &key.1);
        if let Some(asked) = job.request {
            self.dismiss(myself, asked.id());
        }
    }

    /// Calls an ask off. Each beat repeats it until it is answered, lest somebody serve it in the next mission.
    fn dismiss(&mut self, myself: &ActorRef<HumanTaskProxyMessage>, id: GoalId) {
        self.cancellations.add(id);
        send_person_request(&self.settings, &mut self.tasks, myself, id, None);
    }
}

fn key_of(live: &ActivePlan) -> RoleKey {
    (live.mission.clone(), live.plan.role.clone())
}

/// Asks those from whom something is awaited what they have said.
pub(super) fn query_signals(
    talk: &SignalExchange,
    tasks: &mut Tasks,
    myself: &ActorRef<HumanTaskProxyMessage>,
    mission: &MissionId,
    sequencer: &Sequencer,
) {
    let to = myself.clone();
    talk.query_history(mission, &sequencer.awaited_signals(), tasks, move |said| {
        // An attendant that has stopped needs no answer.
        let _ = to.cast(HumanTaskProxyMessage::SignalHistory(said));
    });
}

/// Asks for a thing, or calls it off.
pub(super) fn send_person_request(
    settings: &HumanTaskProxySettings,
    tasks: &mut Tasks,
    myself: &ActorRef<HumanTaskProxyMessage>,
    id: GoalId,
    ask: Option<PersonRequest>,
) {
    let bytes = match codec::encode(&PersonCommand { id, request: ask }) {
        Ok(bytes) => Bytes::from(bytes),
        Err(problem) => return warn!(%problem, "an ask does not fit a message"),
    };
    let (bus, key, to) = (settings.bus.clone(), settings.keys.write(&Key::People(PeopleCall::Ask)), myself.clone());
    tasks.spawn(async move {
        let Ok(mut replies) = bus.query(&key, bytes, Duration::from_millis(500)).await else { return };
        while let Some(reply) = replies.recv().await {
            match reply.payload.map(|bytes| codec::decode::<PersonRequestState>(&bytes)) {
                // An attendant that has stopped needs no answer.
                Ok(Ok(state)) => drop(to.cast(HumanTaskProxyMessage::RequestReplied(id, state))),
                other => debug!(?other, "an ask was not answered"),
            }
        }
    });
}
