//! State of the robot actor, and the effects that it performs: events, reports, checkpoint writes
//! and queries.

use super::message::{EndedReport, RobotMessage};
use crate::robot::alarm_drive::AlarmDrive;
use crate::robot::charging::ChargeControl;
use crate::robot::checkpoint_storage::{CheckpointStorage, CheckpointWrite};
use crate::robot::checkpoint_writer::PendingOutput;
use crate::robot::device_access::DeviceAccess;
use crate::robot::driver_link::DriverLink;
use crate::robot::execution::Execution;
use crate::robot::leader_poll::LeaderCheck;
use crate::robot::lease_client::{LeaseClient, ReportHeader};
use crate::robot::release::{DriverActivity, PendingRelease};
use crate::robot::report::send_report;
use crate::robot::sequencer::Sequencer;
use crate::robot::settings::RobotSettings;
use crate::robot::signals::SignalExchange;
use crate::robot::standing_orders::StandingOrders;
use crate::robot::worker_record::Publication;
use consort_bus::Query;
use consort_bus::tasks::Tasks;
use consort_protocol::event::EventKind;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::Key;
use consort_protocol::message::{AwardNotice, FailureKind, Report, TaskFailure};
use consort_protocol::units::NodeTime;
use ractor::{ActorRef, RpcReplyPort};
use std::time::Duration;
use tracing::debug;

/// Time for which a free robot may act, in node time, counted from the latest check of its charge or of the alarms.
/// Raised: the body of a robot whose node fails drives on for longer. It covers some intervals of the check.
const FREE_PERMISSION: Duration = Duration::from_secs(2);

/// Cause of a release because of a decommission.
const DECOMMISSION_CAUSE: &str = "it leaves the fleet";

/// State of the robot actor, by concern.
pub(crate) struct RobotState {
    pub(super) settings: RobotSettings,
    /// The actor itself: recipient of replies and results.
    pub(super) myself: ActorRef<RobotMessage>,
    pub(super) lease: LeaseClient,
    pub(super) execution: Execution,
    pub(super) checkpoint: CheckpointStorage,
    pub(super) driver: DriverLink,
    pub(super) signals: SignalExchange,
    pub(super) charging: Option<ChargeControl>,
    /// Access to devices of the building; `None` if the fleet has none.
    pub(super) devices: Option<DeviceAccess>,
    pub(super) decommission: DecommissionRequests,
    pub(super) orders: StandingOrders,
    pub(super) alarm_drive: AlarmDrive,
    pub(super) leader_check: LeaderCheck,
    /// Notices by nodes that a poll may confirm, in the order of their arrival.
    pub(super) unconfirmed_notices: Vec<UnconfirmedNotice>,
    /// Reply to the report in flight, by a node that a poll may confirm.
    pub(super) unconfirmed_reply: Option<EndedReport>,
    pub(super) tasks: Tasks,
}

/// A notice that waits for the result of a poll.
pub(super) struct UnconfirmedNotice {
    pub(super) author: NodeId,
    pub(super) notice: AwardNotice,
    pub(super) query: Query,
}

/// Decommission of the robot; `Some` once the first request has arrived.
#[derive(Default)]
pub(super) struct DecommissionRequests(Option<Decommission>);

struct Decommission {
    /// Pending requests.
    requests: Vec<RpcReplyPort<bool>>,
    /// Release of an award without an active plan.
    release: PendingRelease,
}

impl DecommissionRequests {
    /// Checks whether a decommission was requested.
    pub(super) fn is_leaving(&self) -> bool {
        self.0.is_some()
    }

    pub(super) fn add(&mut self, done: RpcReplyPort<bool>, now: NodeTime) {
        let decommission = self
            .0
            .get_or_insert_with(|| Decommission { requests: vec![], release: PendingRelease::new(leaving(), now) });
        decommission.requests.push(done);
    }

    /// Returns the reason to release an award without an active plan, once the body is at rest: a
    /// previous incarnation may have started a goal.
    fn take_report(&mut self, driver: DriverActivity, now: NodeTime) -> Option<TaskFailure> {
        self.0.as_mut()?.release.take_report(driver, now)
    }

    /// Replies to all pending requests.
    pub(super) fn reply(&mut self, is_free: bool) {
        for done in self.0.iter_mut().flat_map(|decommission| std::mem::take(&mut decommission.requests)) {
            // The caller may have stopped waiting.
            let _ = done.send(is_free);
        }
    }
}

/// Returns the failure that releases the role of a leaving robot.
pub(super) fn leaving() -> TaskFailure {
    TaskFailure::new(FailureKind::Leaving, DECOMMISSION_CAUSE)
}

impl RobotState {
    pub(super) fn now(&self) -> NodeTime {
        self.settings.links.clock.now()
    }

    /// Lets the driver act until the end of the lease, while the plan continues, and while the robot charges or obeys
    /// an alarm without a role. While the robot is held it only drives to an assembly place.
    pub(super) fn update_permission(&mut self) {
        let now = self.now();
        let until = self.lease.acts_until().filter(|_| self.execution.continuing_plan().is_some());
        let charges = self.charging.as_ref().is_some_and(ChargeControl::is_acting);
        let acts_alone = (charges || self.alarm_drive.is_driving()) && self.lease.award().is_none();
        let until = until.or_else(|| acts_alone.then(|| now + FREE_PERMISSION));
        let may_move = !self.orders.is_held(now) || self.alarm_drive.is_assembling();
        self.driver.allow_until(until.filter(|_| may_move));
    }

    /// Publishes an event of the robot.
    pub(super) fn emit_event(&self, event: EventKind) {
        self.settings.links.events.publish(event);
    }

    /// Sends outputs after their steps were stored in the checkpoint.
    pub(super) fn emit_outputs(&mut self, outputs: Vec<PendingOutput>) {
        let Some(mission) = self.execution.plan.as_ref().map(|active| active.award.mission.clone()) else { return };
        for output in outputs {
            match output {
                PendingOutput::Event(event) => self.emit_event(event),
                PendingOutput::Signal(signal) => {
                    self.signals.send(&mission, &signal);
                    self.emit_event(EventKind::Sent { mission: mission.clone(), signal });
                }
            }
        }
    }

    /// Reads the latest driver report, and publishes the worker without its private attributes through
    /// gossip if it has changed.
    pub(super) fn sense(&mut self, now: NodeTime) {
        let leaving = self.decommission.is_leaving().then(|| DECOMMISSION_CAUSE.to_owned());
        let ordered = || self.orders.problem(now).map(str::to_owned);
        let problem = leaving.or_else(|| self.checkpoint.problem()).or_else(ordered);
        let holding = self.lease.holding();
        if holding.is_some() || problem.is_some() {
            self.stop_charging();
        }
        let charging = self.charging.as_ref().and_then(ChargeControl::published);
        let limits = self.driver.speed_limits();
        self.follow_devices(now);
        self.update_map_orders(now);
        let publication = self.driver.sense(holding, problem, charging, now);
        if self.driver.speed_limits() != limits {
            self.extend_timers();
        }
        let gossip = &self.settings.links.gossip;
        let published = match publication {
            Some(Publication::Record(worker)) => {
                let worker = self.settings.pricing.ensembles.published(*worker);
                gossip.update_with(move |knowledge| knowledge.robot = Some(worker))
            }
            Some(Publication::Motion(motion)) => gossip.move_robot(motion),
            None => return,
        };
        if published.is_err() {
            debug!(robot = %self.settings.robot, "gossip has stopped");
        }
    }

    /// Sends a report to the coordinator. At most 1 report is in flight; another follows at once if
    /// this is called meanwhile.
    pub(super) fn report(&mut self) {
        let (sent, limit) = (self.now(), self.settings.lease_terms.lease / 4);
        let Some(header) = self.lease.begin_report(sent) else { return };
        let recipient = header.coordinator.clone();
        let key = self.settings.links.keys.write(&Key::Report(recipient.clone()));
        let report = self.report_content(header, sent);
        let (bus, to) = (self.settings.links.bus.clone(), self.myself.clone());
        self.tasks.spawn(async move {
            let reply = send_report(bus, &key, &report, limit).await;
            // A stopped robot needs no reply.
            let _ = to.cast(RobotMessage::ReportReplied(EndedReport { recipient, sent, reply }));
        });
    }

    fn report_content(&mut self, header: ReportHeader, now: NodeTime) -> Report {
        let ReportHeader { mission, role, epoch, from_checkpoint, .. } = header;
        let driver = self.driver.activity();
        let failure = match self.execution.plan_of(epoch) {
            Some(active) => active.pending_release().and_then(|release| release.take_report(driver, now)),
            None => self.decommission.take_report(driver, now),
        };
        let active = self.execution.plan_of(epoch).map(|active| &active.sequencer);
        let restored = self.checkpoint.restored().filter(|checkpoint| checkpoint.award.epoch == epoch);
        let ended = active.map(|sequencer| sequencer.ended()).or(restored.map(|checkpoint| &checkpoint.own.ended));
        let outcomes = active.map(Sequencer::own_outcomes).or(restored.map(|checkpoint| &checkpoint.own.outcomes));
        Report {
            robot: self.settings.robot.clone(),
            incarnation: self.settings.incarnation,
            mission,
            role,
            epoch,
            ended: ended.cloned().unwrap_or_default(),
            outcomes: outcomes.cloned().unwrap_or_default(),
            current_task: active.and_then(|sequencer| sequencer.current_task().cloned()),
            place: self.driver.place(),
            from_checkpoint,
            failure,
            question: self.driver.question().take_report(epoch),
        }
    }

    /// Writes the checkpoint if it is outdated. The mailbox does not wait for the disk: a lease may
    /// expire meanwhile.
    pub(super) fn write_checkpoint(&mut self) {
        let now = self.now();
        let Some(CheckpointWrite(content)) = self.checkpoint.start_write(self.execution.plan.as_mut(), now) else {
            return;
        };
        let (store, to) = (self.settings.links.checkpoint_store.clone(), self.myself.clone());
        self.tasks.spawn(async move {
            let result = store.write(content).await;
            // A stopped robot needs no result.
            let _ = to.cast(RobotMessage::CheckpointWritten(result));
        });
    }

    /// Queries the signal histories of all roles with an awaited signal.
    pub(super) fn query_signals(&mut self) {
        let Some(active) = &self.execution.plan else { return };
        let (to, awaited) = (self.myself.clone(), active.sequencer.awaited_signals());
        self.signals.query_history(&active.award.mission, &awaited, &mut self.tasks, move |history| {
            // A stopped robot needs no reply.
            let _ = to.cast(RobotMessage::SignalHistory(history));
        });
    }
}
