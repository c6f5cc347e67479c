//! The robot actor: mailbox, timers and bus around the values that decide.

use super::active_plan::ActivePlan;
use super::bidder::{BidContext, Bidder};
use super::checkpoint::Checkpoint;
use super::recovery_policy::AttemptFailure;
use super::settings::RobotSettings;
use super::signals::SignalExchange;
use super::skill_runner::SkillOutcome;
use crate::bus::{Query, Sample};
use crate::reply;
use crate::tasks::Tasks;
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

/// To a robot.
pub enum RobotMessage {
    /// Time to look after everything.
    Tick,
    /// The coordinator says that it is there.
    Beacon(Sample),
    /// The coordinator asks for bids.
    CallForBids(Query),
    /// The coordinator tells of an award, or of its end.
    AwardNotice(Query),
    /// A report was answered, or not.
    ReportReplied {
        /// When it had been sent.
        sent: NodeTime,
        /// What was answered.
        reply: Option<ReportReply>,
    },
    /// A skill ended.
    SkillEnded {
        /// Which start of a skill it was.
        run: u64,
        /// How.
        outcome: SkillOutcome,
    },
    /// Another role of the mission said something.
    Signal(Sample),
    /// Another role answered what it has said.
    SignalHistory(SignalHistory),
    /// The notebook's page was written, or not.
    CheckpointWritten(io::Result<()>),
    /// The robot is to leave the fleet for good: it takes nothing new, and gives up what it holds. Answered once it holds
    /// nothing (true), or when the time allowed has passed (false); whoever asked then ends the node. A node that is only
    /// stopped for a while is not told to leave: its robot goes on with its role when it is back in time.
    Decommission {
        /// How long the coordinator may take to say that the role is put down: lease and grace will do.
        timeout: Duration,
        /// Whether the robot holds nothing now.
        done: RpcReplyPort<bool>,
    },
    /// The time allowed for leaving has passed.
    DecommissionTimeout,
}

/// The actor.
pub struct Robot;

/// State of [`Robot`].
pub struct RobotState {
    pub(super) settings: RobotSettings,
    bidder: Bidder,
    pub(super) worker: RobotKnowledge,
    /// The worker as this life of the actor last told others of it.
    told: Option<RobotKnowledge>,
    sensed_at: NodeTime,
    pub(super) role_lease: RoleLease,
    /// What a former life had written down, until the coordinator has spoken.
    pub(super) restored: Option<Checkpoint>,
    /// The award that this life took up from a former one.
    pub(super) resumed_epoch: Option<Epoch>,
    /// Who holds the mission's roles, by the latest answer about this award.
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
    /// Whether the notebook is being written.
    pub(super) checkpoint_in_flight: bool,
    /// Whether there is, or may be, a page in the notebook.
    pub(super) checkpoint_exists: bool,
    /// Why the notebook could not be written the last time, if it could not.
    pub(super) checkpoint_error: Option<String>,
    /// When it was tried.
    pub(super) checkpoint_tried_at: NodeTime,
    /// Those who wait for the robot to have left; `Some` from when it was told to.
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
        let recalled = recall(&settings).await;
        let mut tasks = Tasks::default();
        tasks.forward(bus.subscribe(&keys.write(&Key::Beacon)).await?, &myself, RobotMessage::Beacon);
        tasks.forward(bus.serve(&keys.write(&Key::Bid(robot.clone()))).await?, &myself, RobotMessage::CallForBids);
        tasks.forward(bus.serve(&keys.write(&Key::Award(robot.clone()))).await?, &myself, RobotMessage::AwardNotice);
        let (mut changes, to) = (settings.driver.changes(), myself.clone());
        let beat = settings.update_interval;
        tasks.spawn(async move {
            // The first report of the body is worth telling at once; later ones can wait for the beat. A robot whose body
            // says nothing has to look after its role all the same.
            let _ = tokio::time::timeout(Duration::from_secs(1), changes.changed()).await;
            while to.cast(RobotMessage::Tick).is_ok() {
                tokio::time::sleep(beat).await;
            }
        });
        let now = settings.clock.now();
        let tenure = match &recalled {
            Some(page) => RoleLease::restore(robot.clone(), settings.lease_terms, page.award.clone()),
            None => RoleLease::new(robot.clone(), settings.lease_terms),
        };
        let mut state = RobotState {
            bidder: Bidder::new(robot.clone(), Arc::clone(&settings.estimator)),
            worker: settings.worker.clone(),
            told: None,
            sensed_at: now,
            role_lease: tenure,
            resumed_epoch: recalled.as_ref().map(|page| page.award.epoch),
            restored: recalled,
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
            // Whatever stands there and is not taken up is torn out.
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
            RobotMessage::Tick => state.beat(&myself).await?,
            RobotMessage::Beacon(sample) => state.follow_coordinator(&myself, &sample),
            RobotMessage::CallForBids(query) => state.bid(&query).await,
            RobotMessage::AwardNotice(query) => state.handle_award_notice(&myself, &query).await?,
            RobotMessage::ReportReplied { sent, reply: answer } => {
                state.handle_report_reply(&myself, sent, answer).await?
            }
            RobotMessage::SkillEnded { run, outcome } => state.skill_ended(&myself, run, outcome).await?,
            RobotMessage::Signal(sample) => match codec::decode::<SignalHistory>(&sample.payload) {
                Ok(said) => state.receive_signals(&myself, &said).await?,
                Err(problem) => warn!(key = sample.key, %problem, "a signal that cannot be read"),
            },
            RobotMessage::SignalHistory(said) => state.receive_signals(&myself, &said).await?,
            RobotMessage::CheckpointWritten(result) => state.handle_checkpoint_written(&myself, result).await?,
            RobotMessage::Decommission { timeout: within, done } => state.decommission(&myself, within, done).await?,
            RobotMessage::DecommissionTimeout => state.answer_decommission(false),
        }
        Ok(())
    }

    async fn handle_supervisor_evt(
        &self,
        myself: ActorRef<Self::Msg>,
        event: SupervisionEvent,
        state: &mut Self::State,
    ) -> Result<(), ActorProcessingErr> {
        if let SupervisionEvent::ActorFailed(who, problem) = event {
            let of_job = state
                .active_plan
                .as_mut()
                .filter(|job| job.attempt.as_ref().is_some_and(|attempt| attempt.runner.get_id() == who.get_id()));
            if let Some(job) = of_job {
                job.attempt = None;
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

/// What a former life wrote down, if it can be read.
async fn recall(settings: &RobotSettings) -> Option<Checkpoint> {
    let robot = &settings.robot;
    let bytes = match settings.checkpoint_store.read().await {
        Ok(bytes) => bytes?,
        Err(problem) => {
            warn!(%robot, %problem, "its notebook cannot be read: it has forgotten whatever it held");
            return None;
        }
    };
    match Checkpoint::decode(&bytes, robot) {
        Ok(page) => {
            info!(%robot, mission = %page.award.mission, role = %page.award.role, epoch = %page.award.epoch, "recalls");
            Some(page)
        }
        Err(problem) => {
            warn!(%robot, %problem, "a page of its notebook was torn out: it has forgotten whatever it held");
            None
        }
    }
}

/// Others hear of charge in steps of this size: a guess. Bids and the robot itself count with the exact one.
const CHARGE_TOLD: f64 = 0.02;

/// Whether others need to hear what a robot has become: an idle one loses a little charge every second, which changes
/// nobody's mind.
fn is_news(told: &RobotKnowledge, now: &RobotKnowledge) -> bool {
    let lost = (told.battery.get() - now.battery.get()).abs() >= CHARGE_TOLD;
    let useful = |worker: &RobotKnowledge| worker.battery >= worker.useful_charge;
    lost || useful(told) != useful(now) || RobotKnowledge { battery: told.battery, ..now.clone() } != *told
}

impl RobotState {
    async fn beat(&mut self, myself: &ActorRef<RobotMessage>) -> Result<(), ActorProcessingErr> {
        let now = self.settings.clock.now();
        self.update_worker(now);
        let actions = self.role_lease.handle(Event::Tick, now);
        self.perform_actions(myself, actions).await?;
        let held_up =
            self.active_plan.as_ref().is_some_and(|job| job.pending_release.is_none() && job.sequencer.awaits_ledger());
        let owes = self.active_plan.as_ref().and_then(|job| job.pending_release.as_ref());
        let owes = owes.is_some_and(|surrender| surrender.must_report(self.settings.driver.is_idle(), now));
        if held_up || owes || now.since(self.reported_at) >= self.settings.lease_terms.lease / 4 {
            self.report(myself);
        }
        self.query_signals_if_due(myself, now);
        self.check_progress(myself, now).await?;
        self.advance(myself).await
    }

    /// The ways that the body has found closed.
    pub(super) fn closed_lanes(&self) -> &[(PlaceId, PlaceId)] {
        self.settings.driver.telemetry().map_or(&[], |report| &report.closed)
    }

    /// Properties sensing (thesis, Listing 3.1): takes in what the body reports and lets others know.
    pub(super) fn update_worker(&mut self, now: NodeTime) {
        self.settings.driver.refresh();
        let holding = self.role_lease.award().map(|award| Availability::Holding {
            mission: award.mission.clone(),
            role: award.role.clone(),
            suspended: self.role_lease.is_suspended(),
        });
        let mut worker = self.worker.clone();
        let silent = || Some("its body does not answer".to_owned());
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
            // What it would hold it could not write down, and would have forgotten after a crash.
            problem = Some(format!("its notebook cannot be written: {why}"));
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
        let now_is = &self.worker;
        let urgent = |told: &RobotKnowledge| told.availability != now_is.availability || told.place != now_is.place;
        let due = now.since(self.sensed_at) >= Duration::from_secs(1);
        if self.told.as_ref().is_none_or(|told| urgent(told) || due && is_news(told, now_is)) {
            self.sensed_at = now;
            let worker = self.worker.clone();
            self.told = Some(worker.clone());
            if self.settings.gossip.update_with(move |knowledge| knowledge.robot = Some(worker)).is_err() {
                debug!(robot = %self.settings.robot, "gossip has stopped");
            }
        }
    }

    fn follow_coordinator(&mut self, myself: &ActorRef<RobotMessage>, sample: &Sample) {
        match codec::decode::<Beacon>(&sample.payload) {
            Ok(beacon) => {
                if !beacon.supersedes(self.coordinator.as_ref()) {
                    return; // one that does not know that it no longer coordinates
                }
                let abroad = self.coordinator.as_ref().is_some_and(|known| beacon.is_other_cluster(known));
                let new = beacon.is_other_leader_session(self.coordinator.as_ref());
                if abroad {
                    info!(robot = %self.settings.robot, node = %beacon.node, "follows the coordinator of another cluster");
                    self.role_lease.clear_latest_epochs();
                }
                self.coordinator = Some(beacon);
                if new {
                    self.report(myself);
                }
            }
            Err(problem) => warn!(%problem, "a beacon that cannot be read"),
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
        let circumstance = BidContext { worker: &self.worker, closed_lanes: self.closed_lanes(), age_ms, membership };
        let tender = self.bidder.respond(&call, &circumstance);
        let key = self.settings.keys.write(&Key::Bid(self.settings.robot.clone()));
        reply::wire(query, &key, &tender).await;
    }

    /// Something has happened to the plan under way.
    pub(super) fn emit_event(&self, what: EventKind) {
        self.settings.events.publish(what);
    }
}
