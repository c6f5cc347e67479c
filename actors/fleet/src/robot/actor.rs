//! The robot actor: mailbox, timers and bus around the values that make the decisions.

use super::active_plan::ActivePlan;
use super::bidder::{BidContext, Bidder};
use super::checkpoint::Checkpoint;
use super::recovery_policy::AttemptFailure;
use super::settings::RobotSettings;
use super::signals::SignalExchange;
use super::skill_runner::SkillOutcome;
use consort_bus::reply;
use consort_bus::tasks::Tasks;
use consort_bus::{Query, Sample};
use consort_protocol::auction::CallForBids;
use consort_protocol::codec;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{NodeId, PlaceId, RoleId};
use consort_protocol::keys::Key;
use consort_protocol::knowledge::{Availability, RobotKnowledge};
use consort_protocol::lease::{Epoch, Event, RoleHolder, RoleLease};
use consort_protocol::message::{Beacon, FailureKind, ReportReply, SignalHistory};
use consort_protocol::units::NodeTime;
use consort_skills::actions::RobotActions;
use ractor::{Actor, ActorProcessingErr, ActorRef, RpcReplyPort, SupervisionEvent};
use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::time::Duration;
use tracing::{debug, info, warn};

/// Message for the robot actor.
pub enum RobotMessage {
    /// Periodic timer: update the knowledge record, the lease and the task.
    Tick,
    /// Beacon of the coordinator.
    Beacon(Sample),
    /// Call for bids of the coordinator.
    CallForBids(Query),
    /// Award of a role, or its end, from the coordinator.
    AwardNotice(Query),
    /// The query of a report has ended, with or without a reply.
    ReportReplied {
        /// Time at which the report was sent.
        sent: NodeTime,
        /// Reply of the coordinator; `None` without a reply.
        reply: Option<ReportReply>,
    },
    /// A skill has ended.
    SkillEnded {
        /// Number of the skill run.
        run: u64,
        /// Its outcome.
        outcome: SkillOutcome,
    },
    /// Signal of another role of the mission.
    Signal(Sample),
    /// Signal history of another role, in reply to a query.
    SignalHistory(SignalHistory),
    /// Result of writing the checkpoint.
    CheckpointWritten(io::Result<()>),
    /// Decommission: the robot takes no new role and releases the role it holds. The reply is true
    /// once it holds no role, and false when the timeout has passed. The caller then ends the node.
    /// A node that only stops for a while does not send this: its robot continues its role if it is
    /// back in time.
    Decommission {
        /// Time for the coordinator to confirm the release. Lease plus grace time is enough.
        timeout: Duration,
        /// Reply port: true if the robot holds no role.
        done: RpcReplyPort<bool>,
    },
    /// The time for the decommission has passed.
    DecommissionTimeout,
}

/// The robot actor.
pub struct Robot;

/// State of [`Robot`].
pub struct RobotState {
    pub(super) settings: RobotSettings,
    bidder: Bidder,
    pub(super) worker: RobotKnowledge,
    /// The worker as last sent to gossip since the start of this actor.
    published: Option<RobotKnowledge>,
    sensed_at: NodeTime,
    pub(super) role_lease: RoleLease,
    /// Checkpoint of the previous incarnation, until the coordinator has replied.
    pub(super) restored: Option<Checkpoint>,
    /// The award that was restored from the checkpoint.
    pub(super) resumed_epoch: Option<Epoch>,
    /// Holders of the mission's roles, from the latest report reply for this award.
    pub(super) latest_holders: Option<(Epoch, BTreeMap<RoleId, RoleHolder>)>,
    pub(super) active_plan: Option<ActivePlan>,
    pub(super) signals: SignalExchange,
    pub(super) coordinator: Option<Beacon>,
    pub(super) report_in_flight: bool,
    pub(super) report_queued: bool,
    pub(super) reported_at: NodeTime,
    pub(super) signals_queried_at: NodeTime,
    pub(super) priced_at: NodeTime,
    pub(super) skill_runs: u64,
    /// A write of the checkpoint is in progress.
    pub(super) checkpoint_in_flight: bool,
    /// The store contains a checkpoint, or may contain it.
    pub(super) checkpoint_exists: bool,
    /// Error of the last checkpoint write, if it failed.
    pub(super) checkpoint_error: Option<String>,
    /// Time of the last checkpoint write.
    pub(super) checkpoint_tried_at: NodeTime,
    /// Reply ports of pending decommission requests; `Some` once the first request has arrived.
    pub(super) decommission_waiters: Option<Vec<RpcReplyPort<bool>>>,
    pub(super) tasks: Tasks,
}

#[ractor::async_trait]
impl Actor for Robot {
    type Msg = RobotMessage;
    type State = RobotState;
    type Arguments = RobotSettings;

    async fn pre_start(
        &self,
        myself: ActorRef<Self::Msg>,
        settings: RobotSettings,
    ) -> Result<Self::State, ActorProcessingErr> {
        let RobotSettings { robot, keys, bus, .. } = &settings;
        let restored = read_checkpoint(&settings).await;
        let mut tasks = Tasks::default();
        tasks.forward(bus.subscribe(&keys.write(&Key::Beacon)).await?, &myself, RobotMessage::Beacon);
        tasks.forward(bus.serve(&keys.write(&Key::Bid(robot.clone()))).await?, &myself, RobotMessage::CallForBids);
        tasks.forward(bus.serve(&keys.write(&Key::Award(robot.clone()))).await?, &myself, RobotMessage::AwardNotice);
        let (mut changes, to) = (settings.driver.changes(), myself.clone());
        let interval = settings.update_interval;
        tasks.spawn(async move {
            // The first report of the driver is published at once; later reports wait for the
            // timer. The role needs attention even if the driver reports nothing.
            let _ = tokio::time::timeout(Duration::from_secs(1), changes.changed()).await;
            while to.cast(RobotMessage::Tick).is_ok() {
                tokio::time::sleep(interval).await;
            }
        });
        let now = settings.clock.now();
        let role_lease = match &restored {
            Some(checkpoint) => RoleLease::restore(robot.clone(), settings.lease_terms, checkpoint.award.clone()),
            None => RoleLease::new(robot.clone(), settings.lease_terms),
        };
        let mut state = RobotState {
            bidder: Bidder::new(robot.clone(), Arc::clone(&settings.estimator)),
            worker: settings.worker.clone(),
            published: None,
            sensed_at: now,
            role_lease,
            resumed_epoch: restored.as_ref().map(|checkpoint| checkpoint.award.epoch),
            restored,
            latest_holders: None,
            active_plan: None,
            signals: SignalExchange::new(bus.clone(), keys.clone()),
            coordinator: None,
            report_in_flight: false,
            report_queued: false,
            reported_at: now,
            signals_queried_at: now,
            priced_at: now,
            skill_runs: 0,
            checkpoint_in_flight: false,
            // A stored checkpoint that is not restored is deleted.
            checkpoint_exists: true,
            checkpoint_error: None,
            checkpoint_tried_at: now,
            decommission_waiters: None,
            tasks,
            settings,
        };
        if state.restored.is_some() {
            state.update_worker(now);
        } else {
            state.write_checkpoint(&myself);
        }
        Ok(state)
    }

    async fn handle(
        &self,
        myself: ActorRef<Self::Msg>,
        message: Self::Msg,
        state: &mut Self::State,
    ) -> Result<(), ActorProcessingErr> {
        match message {
            RobotMessage::Tick => state.tick(&myself).await?,
            RobotMessage::Beacon(sample) => state.follow_coordinator(&myself, &sample),
            RobotMessage::CallForBids(query) => state.bid(&query).await,
            RobotMessage::AwardNotice(query) => state.handle_award_notice(&myself, &query).await?,
            RobotMessage::ReportReplied { sent, reply } => state.handle_report_reply(&myself, sent, reply).await?,
            RobotMessage::SkillEnded { run, outcome } => state.skill_ended(&myself, run, outcome).await?,
            RobotMessage::Signal(sample) => match codec::decode::<SignalHistory>(&sample.payload) {
                Ok(history) => state.receive_signals(&myself, &history).await?,
                Err(problem) => warn!(key = sample.key, %problem, "signal cannot be decoded"),
            },
            RobotMessage::SignalHistory(history) => state.receive_signals(&myself, &history).await?,
            RobotMessage::CheckpointWritten(result) => state.handle_checkpoint_written(&myself, result).await?,
            RobotMessage::Decommission { timeout, done } => state.decommission(&myself, timeout, done).await?,
            RobotMessage::DecommissionTimeout => state.reply_to_decommission(false),
        }
        Ok(())
    }

    async fn handle_supervisor_evt(
        &self,
        myself: ActorRef<Self::Msg>,
        event: SupervisionEvent,
        state: &mut Self::State,
    ) -> Result<(), ActorProcessingErr> {
        if let SupervisionEvent::ActorFailed(actor, problem) = event {
            let active = state.active_plan.as_mut().filter(|active| {
                active.attempt.as_ref().is_some_and(|attempt| attempt.runner.get_id() == actor.get_id())
            });
            if let Some(active) = active {
                active.attempt = None;
                state.settings.driver.stop();
                let cause = format!("the skill crashed: {problem}");
                state
                    .handle_failure(&myself, AttemptFailure { kind: FailureKind::Crash, cause, permanent: false })
                    .await?;
            }
        }
        Ok(())
    }
}

/// Reads the checkpoint of the previous incarnation. Returns `None` if there is none or it cannot
/// be decoded.
async fn read_checkpoint(settings: &RobotSettings) -> Option<Checkpoint> {
    let robot = &settings.robot;
    let bytes = match settings.checkpoint_store.read().await {
        Ok(bytes) => bytes?,
        Err(problem) => {
            warn!(%robot, %problem, "checkpoint store cannot be read: the robot has lost its role");
            return None;
        }
    };
    match Checkpoint::decode(&bytes, robot) {
        Ok(checkpoint) => {
            let award = &checkpoint.award;
            info!(%robot, mission = %award.mission, role = %award.role, epoch = %award.epoch, "checkpoint restored");
            Some(checkpoint)
        }
        Err(problem) => {
            warn!(%robot, %problem, "checkpoint discarded: the robot has lost its role");
            None
        }
    }
}

/// Change of charge that is published through gossip: a guess. Bids and the robot itself use the
/// exact charge.
const CHARGE_STEP: f64 = 0.02;

/// Checks whether a change of the worker is worth publishing. An idle robot loses a little charge
/// every second, which affects no decision.
fn is_worth_publishing(published: &RobotKnowledge, now: &RobotKnowledge) -> bool {
    let lost = (published.battery.get() - now.battery.get()).abs() >= CHARGE_STEP;
    let useful = |worker: &RobotKnowledge| worker.battery >= worker.useful_charge;
    lost || useful(published) != useful(now)
        || RobotKnowledge { battery: published.battery, ..now.clone() } != *published
}

impl RobotState {
    async fn tick(&mut self, myself: &ActorRef<RobotMessage>) -> Result<(), ActorProcessingErr> {
        let now = self.settings.clock.now();
        self.update_worker(now);
        let actions = self.role_lease.handle(Event::Tick, now);
        self.perform_actions(myself, actions).await?;
        let waits_for_ledger = self
            .active_plan
            .as_ref()
            .is_some_and(|active| active.pending_release.is_none() && active.sequencer.awaits_ledger());
        let must_report_release = self.active_plan.as_ref().and_then(|active| active.pending_release.as_ref());
        let must_report_release =
            must_report_release.is_some_and(|release| release.must_report(self.settings.driver.is_idle(), now));
        if waits_for_ledger || must_report_release || now.since(self.reported_at) >= self.settings.lease_terms.lease / 4
        {
            self.report(myself);
        }
        self.query_signals_if_due(myself, now);
        self.check_progress(myself, now).await?;
        self.advance(myself).await
    }

    /// Lanes that the driver has found closed.
    pub(super) fn closed_lanes(&self) -> &[(PlaceId, PlaceId)] {
        self.settings.driver.telemetry().map_or(&[], |report| &report.closed)
    }

    /// Properties sensing (thesis, Listing 3.1): reads the latest driver report and publishes the
    /// worker through gossip.
    pub(super) fn update_worker(&mut self, now: NodeTime) {
        self.settings.driver.refresh();
        let holding = self.role_lease.award().map(|award| Availability::Holding {
            mission: award.mission.clone(),
            role: award.role.clone(),
            suspended: self.role_lease.is_suspended(),
        });
        let mut worker = self.worker.clone();
        let silent = || Some("its driver does not reply".to_owned());
        let mut problem = silent();
        if let Some(report) = self.settings.driver.telemetry() {
            worker.place = report.place.clone();
            worker.pose = report.pose;
            worker.battery = report.battery;
            problem = match () {
                () if !report.able => Some("its battery is too low to move".to_owned()),
                () if self.settings.driver.silent_for() >= self.settings.task_timeout.report_timeout => silent(),
                () => None,
            };
        }
        if let Some(why) = &self.checkpoint_error {
            // An award could not be checkpointed and would be lost in a crash.
            problem = Some(format!("its checkpoint cannot be written: {why}"));
        }
        if self.decommission_waiters.is_some() {
            problem = Some("it leaves the fleet".to_owned());
        }
        worker.availability = match (problem, holding) {
            (_, Some(holding)) => holding,
            (Some(problem), None) => Availability::OutOfService { problem },
            (None, None) => Availability::Free,
        };
        self.worker = worker;
        let current = &self.worker;
        let urgent = |published: &RobotKnowledge| {
            published.availability != current.availability || published.place != current.place
        };
        let due = now.since(self.sensed_at) >= Duration::from_secs(1);
        if self
            .published
            .as_ref()
            .is_none_or(|published| urgent(published) || due && is_worth_publishing(published, current))
        {
            self.sensed_at = now;
            let worker = self.worker.clone();
            self.published = Some(worker.clone());
            if self.settings.gossip.update_with(move |knowledge| knowledge.robot = Some(worker)).is_err() {
                debug!(robot = %self.settings.robot, "gossip has stopped");
            }
        }
    }

    fn follow_coordinator(&mut self, myself: &ActorRef<RobotMessage>, sample: &Sample) {
        match codec::decode::<Beacon>(&sample.payload) {
            Ok(beacon) => {
                if !beacon.supersedes(self.coordinator.as_ref()) {
                    return; // stale beacon of a node that no longer coordinates
                }
                let other_cluster = self.coordinator.as_ref().is_some_and(|known| beacon.is_other_cluster(known));
                let new = beacon.is_other_leader_session(self.coordinator.as_ref());
                if other_cluster {
                    info!(robot = %self.settings.robot, node = %beacon.node, "follows the coordinator of another cluster");
                    self.role_lease.clear_latest_epochs();
                }
                self.coordinator = Some(beacon);
                if new {
                    self.report(myself);
                }
            }
            Err(problem) => warn!(%problem, "beacon cannot be decoded"),
        }
    }

    async fn bid(&mut self, query: &Query) {
        let Some(call) = reply::decode_or_refuse::<CallForBids>(query).await else { return };
        let now = self.settings.clock.now();
        self.update_worker(now);
        let me = NodeId::from(self.settings.robot.clone());
        let coordinator = self.coordinator.as_ref().map_or_else(|| me.clone(), |beacon| beacon.node.clone());
        let membership =
            self.settings.knowledge.read(|base| self.settings.ensemble.membership_of(&me, &coordinator, base, now));
        let age_ms = self.settings.driver.telemetry_age_ms();
        let context = BidContext { worker: &self.worker, closed_lanes: self.closed_lanes(), age_ms, membership };
        let response = self.bidder.respond(&call, &context);
        let key = self.settings.keys.write(&Key::Bid(self.settings.robot.clone()));
        reply::wire(query, &key, &response).await;
    }

    /// Publishes an event about the active plan.
    pub(super) fn emit_event(&self, event: EventKind) {
        self.settings.events.publish(event);
    }
}
