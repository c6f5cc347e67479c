//! The robot actor: mailbox, timers and bus around the values that make the decisions.
//!
//! `state` holds the values and performs single effects, `plan`, `role`, `coordinator`, `alarm` and `charging`
//! perform the decisions about the plan, the role, the coordinator and its orders, alarms, and the charge, and this
//! file dispatches messages.

mod alarm;
mod charging;
mod coordinator;
mod devices;
mod message;
mod plan;
mod role;
mod state;

pub(crate) use message::RobotMessage;

use super::alarm_drive::AlarmDrive;
use super::bidder::{BidContext, Bidder, PresentWork, lacks_charge, plans_stop};
use super::charging::ChargeControl;
use super::checkpoint::Checkpoint;
use super::checkpoint_storage::CheckpointStorage;
use super::device_access::DeviceAccess;
use super::driver_link::DriverLink;
use super::execution::Execution;
use super::leader_poll::LeaderCheck;
use super::lease_client::LeaseClient;
use super::recovery_policy::AttemptFailure;
use super::settings::{RobotLinks, RobotSettings, RobotStart};
use super::signals::SignalExchange;
use super::standing_orders::StandingOrders;
use super::worker_record::WorkerRecord;
use crate::robot::signals::ReceivedSignals;
use consort_bus::reply;
use consort_bus::tasks::Tasks;
use consort_bus::{Query, Sample};
use consort_protocol::auction::CallForBids;
use consort_protocol::codec;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::Key;
use consort_protocol::lease::Event;
use consort_protocol::message::{Beacon, TaskFailure};
use consort_protocol::units::NodeTime;
use ractor::{Actor, ActorProcessingErr, ActorRef, RpcReplyPort, SupervisionEvent};
use state::{DecommissionRequests, RobotState, leaving};
use std::sync::Arc;
use std::time::Duration;
use tracing::{info, warn};

/// The robot actor.
pub(crate) struct Robot;

#[ractor::async_trait]
impl Actor for Robot {
    type Msg = RobotMessage;
    type State = RobotState;
    type Arguments = RobotStart;

    async fn pre_start(
        &self,
        myself: ActorRef<Self::Msg>,
        RobotStart { settings, worker, driver }: RobotStart,
    ) -> Result<Self::State, ActorProcessingErr> {
        let (robot, RobotLinks { keys, bus, .. }) = (&settings.robot, &settings.links);
        let restored = read_checkpoint(&settings).await;
        let mut tasks = Tasks::default();
        tasks.forward_samples(bus.subscribe(&keys.write(&Key::Beacon)).await?, &myself, RobotMessage::Beacon);
        let calls = bus.serve(&keys.write(&Key::Bid(robot.clone()))).await?;
        tasks.forward_queries(calls, &myself, RobotMessage::CallForBids);
        let notices = bus.serve(&keys.write(&Key::Award(robot.clone()))).await?;
        tasks.forward_queries(notices, &myself, RobotMessage::AwardNotice);
        let (now, report_timeout) = (settings.links.clock.now(), settings.execution.task_timeout.report_timeout);
        let record = WorkerRecord::new(worker, settings.motion_scope.clone(), now);
        let driver = DriverLink::new(driver, record, report_timeout);
        let (mut changes, to) = (driver.changes(), myself.clone());
        let interval = settings.update_interval;
        tasks.spawn(async move {
            // The first report of the driver is published at once; later reports wait for the
            // timer. The role needs attention even if the driver reports nothing.
            let _ = tokio::time::timeout(Duration::from_secs(1), changes.changed()).await;
            while to.cast(RobotMessage::Tick).is_ok() {
                tokio::time::sleep(interval).await;
            }
        });
        let mut state = RobotState {
            lease: LeaseClient::new(robot.clone(), settings.lease_terms, restored.as_ref(), now),
            execution: Execution::new(now),
            checkpoint: CheckpointStorage::new(restored, now),
            driver,
            signals: SignalExchange::new(bus.clone(), keys.clone()),
            charging: settings.charging.clone().map(ChargeControl::new),
            devices: settings.devices.clone().map(DeviceAccess::new),
            decommission: DecommissionRequests::default(),
            orders: StandingOrders::new(now),
            alarm_drive: AlarmDrive::default(),
            leader_check: LeaderCheck::default(),
            unconfirmed_notices: vec![],
            unconfirmed_reply: None,
            tasks,
            myself,
            settings,
        };
        if state.checkpoint.restored().is_some() {
            state.sense(now);
        } else {
            state.write_checkpoint();
        }
        Ok(state)
    }

    async fn handle(
        &self,
        _: ActorRef<Self::Msg>,
        message: Self::Msg,
        state: &mut Self::State,
    ) -> Result<(), ActorProcessingErr> {
        match message {
            RobotMessage::Tick => state.tick().await,
            RobotMessage::Beacon(sample) => {
                state.follow_coordinator(&sample);
                Ok(())
            }
            RobotMessage::CallForBids(query) => {
                state.bid(query);
                Ok(())
            }
            RobotMessage::AwardNotice(query) => state.handle_award_notice(query).await,
            RobotMessage::ReportReplied(report) => state.handle_report_reply(report).await,
            RobotMessage::LeaderPolled(poll) => state.handle_leader_poll(poll).await,
            RobotMessage::SkillEnded { run, outcome } => state.skill_ended(run, outcome).await,
            RobotMessage::Signal(sample) => match ReceivedSignals::of(sample.into_inner()) {
                Some(received) => state.receive_signals(&received).await,
                None => Ok(()),
            },
            RobotMessage::SignalHistory(received) => state.receive_signals(&received).await,
            RobotMessage::CheckpointWritten(result) => state.handle_checkpoint_written(result).await,
            RobotMessage::Decommission { timeout, done } => state.decommission(timeout, done).await,
            RobotMessage::DecommissionTimeout => {
                state.decommission.reply(false);
                Ok(())
            }
        }
    }

    async fn handle_supervisor_evt(
        &self,
        _: ActorRef<Self::Msg>,
        event: SupervisionEvent,
        state: &mut Self::State,
    ) -> Result<(), ActorProcessingErr> {
        match event {
            SupervisionEvent::ActorFailed(actor, problem) => {
                state.skill_crashed(actor.get_id(), problem.to_string()).await
            }
            _ => Ok(()),
        }
    }
}

/// Reads the checkpoint of the previous incarnation. Returns `None` if there is none or it cannot
/// be decoded.
async fn read_checkpoint(settings: &RobotSettings) -> Option<Checkpoint> {
    let robot = &settings.robot;
    let bytes = match settings.links.checkpoint_store.read().await {
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

impl RobotState {
    async fn tick(&mut self) -> Result<(), ActorProcessingErr> {
        let now = self.now();
        self.sense(now);
        // The role is suspended when the permission of the goals in progress ends.
        let lead = self.lease.acts_until().map_or(Duration::ZERO, |_| self.driver.stop_lead());
        self.handle_lease_event(Event::Tick, now + lead).await?;
        let driver = self.driver.activity();
        let needs_report = self.execution.plan.as_ref().is_some_and(|active| active.needs_report(driver, now));
        let asks = self.execution.plan.is_some() && self.driver.question().must_report();
        if needs_report || asks || self.lease.is_report_due(now) {
            self.report();
        }
        if self.execution.take_signal_query(now) {
            self.query_signals();
        }
        self.check_progress(now).await?;
        self.charge(now).await?;
        self.obey_alarm(now).await?;
        self.advance().await
    }

    fn follow_coordinator(&mut self, sample: &Sample) {
        let beacon = match codec::decode::<Beacon>(&sample.payload) {
            Ok(beacon) => beacon,
            Err(problem) => return warn!(%problem, "beacon cannot be decoded"),
        };
        let node = beacon.node.clone();
        let now = self.now();
        if !self.hear_beacon(&beacon, &sample.author, now) {
            return;
        }
        let Some(change) = self.lease.follow(beacon, now) else { return };
        if change.other_cluster {
            info!(robot = %self.settings.robot, %node, "follows the coordinator of another cluster");
            if !self.leader_check.has_certificates() {
                self.change_cluster(now);
            }
        }
        if change.new_session {
            self.report();
        }
    }

    fn bid(&mut self, query: Query) {
        let Some((query, call)) = reply::decode_or_refuse_in::<CallForBids>(&mut self.tasks, query) else { return };
        let now = self.now();
        self.sense(now);
        let RobotSettings { robot, links, pricing, .. } = &self.settings;
        let me = NodeId::from(robot.clone());
        let coordinator = self.lease.coordinator().unwrap_or(&me);
        let membership =
            links.knowledge.read(|base| pricing.ensembles.membership_of(&call.ensembles, &me, coordinator, base, now));
        let present = self.present_work(now);
        let RobotSettings { robot, links, pricing, .. } = &self.settings;
        let (age_ms, closed_lanes) = (self.driver.telemetry_age_ms(), self.driver.closed_lanes());
        let (worker, readings) = (self.driver.worker(), self.driver.telemetry().map(|report| &report.readings));
        let (found_closed, mut closures) = (self.driver.found_closed(), self.orders.closure_texts(now));
        closures.extend(self.devices.iter().flat_map(DeviceAccess::problems));
        let context = BidContext {
            worker,
            closed_lanes,
            found_closed: &found_closed,
            closures: &closures,
            speed_limits: self.driver.speed_limits(),
            readings,
            age_ms,
            membership,
            present,
        };
        let limits = pricing.limits;
        let chargers = self.charging.as_ref().map(|own| own.reserve(limits));
        let bidder = Bidder::new(robot.clone(), Arc::clone(&pricing.estimator)).with_chargers(chargers);
        let response = bidder.respond(&call, &context);
        if response.replies.iter().any(|reply| lacks_charge(reply, &limits)) {
            self.charging.iter_mut().for_each(ChargeControl::note_lack);
        }
        if response.replies.iter().any(plans_stop) {
            self.charging.iter_mut().for_each(ChargeControl::note_stop);
        }
        let key = links.keys.write(&Key::Bid(robot.clone()));
        reply::wire_in(&mut self.tasks, query, key, response);
    }

    /// Returns the role that the robot performs, unless it is leaving, may lose the role, or must not take another.
    fn present_work(&mut self, now: NodeTime) -> Option<PresentWork> {
        if self.decommission.is_leaving() || self.orders.problem(now).is_some() || !self.lease.may_act(now) {
            return None;
        }
        let context = self.driver.estimate_context();
        let active = self.execution.continuing_plan()?;
        let rest = active.remaining_plan();
        PresentWork::of(&active.award, &rest, &self.settings.pricing.estimator, &context)
    }

    /// Refuses new roles and releases the held role.
    async fn decommission(&mut self, timeout: Duration, done: RpcReplyPort<bool>) -> Result<(), ActorProcessingErr> {
        self.decommission.add(done, self.now());
        self.tasks.send_after(timeout, &self.myself, RobotMessage::DecommissionTimeout);
        if self.execution.continuing_plan().is_some() {
            let TaskFailure { kind, cause, .. } = leaving();
            self.handle_failure(AttemptFailure::new(kind, cause)).await?;
        }
        self.report();
        self.perform_actions(vec![]).await
    }
}
