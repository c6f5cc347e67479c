//! The held role: awards, reports and replies, release, decommission.

use super::active_plan::ActivePlan;
use super::actor::{RobotMessage, RobotState};
use super::checkpoint_writer::{CheckpointWriter, PendingOutput};
use super::recovery_policy::{AttemptFailure, RecoveryPolicy};
use super::sequencer::Sequencer;
use super::signals::StaleSignals;
use bytes::Bytes;
use consort_bus::reply;
use consort_bus::tasks::Tasks;
use consort_bus::{BusError, Query, SharedBus};
use consort_protocol::codec;
use consort_protocol::event::EventKind;
use consort_protocol::keys::Key;
use consort_protocol::lease::{Action, Award, DeclineReason, EndReason, Epoch, Event};
use consort_protocol::ledger::Branch;
use consort_protocol::message::{AwardNotice, AwardReply, FailureKind, Report, ReportReply, TaskFailure};
use consort_protocol::plan::StepIndex;
use consort_protocol::units::NodeTime;
use consort_skills::actions::RobotActions;
use ractor::{ActorProcessingErr, ActorRef, RpcReplyPort};
use std::collections::BTreeSet;
use std::time::Duration;
use tracing::{debug, info, warn};

impl RobotState {
    pub(super) async fn handle_award_notice(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        query: &Query,
    ) -> Result<(), ActorProcessingErr> {
        let Some(notice) = reply::decode_or_refuse::<AwardNotice>(query).await else { return Ok(()) };
        let now = self.settings.clock.now();
        let (reply, event) = match notice {
            AwardNotice::Awarded(_) if self.decommission_waiters.is_some() => {
                (AwardReply::Declined(DeclineReason::Leaving), None)
            }
            AwardNotice::Awarded(award) => match self.role_lease.check_award(&award) {
                Ok(()) => (AwardReply::Acknowledged, Some(Event::AwardReceived(award))),
                Err(why) => (AwardReply::Declined(why), None),
            },
            AwardNotice::Revoked { epoch, reason } => {
                (AwardReply::Acknowledged, Some(Event::Revoked { epoch, reason }))
            }
        };
        let key = self.settings.keys.write(&Key::Award(self.settings.robot.clone()));
        reply::wire(query, &key, &reply).await;
        if let Some(event) = event {
            let actions = self.role_lease.handle(event, now);
            self.perform_actions(myself, actions).await?;
        }
        Ok(())
    }

    pub(super) async fn handle_report_reply(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        sent: NodeTime,
        reply: Option<ReportReply>,
    ) -> Result<(), ActorProcessingErr> {
        self.report_in_flight = false;
        let now = self.settings.clock.now();
        let actions = match reply {
            Some(ReportReply::Renewed { epoch, ended, holders, signals }) => {
                if let Some(active) = self.active_plan.as_mut().filter(|active| active.award.epoch == epoch) {
                    active.sequencer.set_recorded(&ended);
                    let changed = active.sequencer.set_holders(holders.clone());
                    active.sequencer.receive_recorded(&signals);
                    if changed {
                        self.query_signals(myself);
                    }
                }
                self.latest_holders = Some((epoch, holders));
                self.role_lease.handle(Event::Renewed { epoch, sent, ended }, now)
            }
            Some(ReportReply::Ended { epoch, reason: EndReason::Over, .. }) => {
                // The role has no successor. Every step in the ledger counts as sent, so pending
                // outputs are sent now, with or without a checkpoint.
                let active = self.active_plan.as_mut().filter(|active| active.award.epoch == epoch);
                let unsent = active.map(|active| std::mem::take(&mut active.checkpoint_writer).into_pending());
                self.emit_outputs(unsent.unwrap_or_default()).await;
                self.end_plan(epoch, EndReason::Over);
                self.role_lease.handle(Event::Settled { epoch }, now)
            }
            Some(ReportReply::Ended { epoch, reason, .. }) => {
                self.role_lease.handle(Event::Revoked { epoch, reason }, now)
            }
            Some(ReportReply::NotCoordinator { coordinator }) => {
                debug!(robot = %self.settings.robot, ?coordinator, "reported to a node that is not the coordinator");
                vec![]
            }
            None => vec![],
        };
        self.perform_actions(myself, actions).await?;
        if std::mem::take(&mut self.report_queued) {
            self.report(myself);
        }
        self.advance(myself).await
    }

    pub(super) async fn perform_actions(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        actions: Vec<Action>,
    ) -> Result<(), ActorProcessingErr> {
        for action in actions {
            match action {
                Action::Report => self.report(myself),
                Action::Start(award, ended) => self.start(myself, *award, &ended).await?,
                Action::Suspend => self.suspend(),
                Action::Resume => self.resume(),
                Action::Halt(reason) => {
                    let held = self.active_plan.as_ref().map(|active| active.award.epoch);
                    let restored = self.restored.as_ref().map(|checkpoint| checkpoint.award.epoch);
                    if let Some(epoch) = held.or(restored) {
                        self.end_plan(epoch, reason);
                    }
                }
            }
        }
        if self.role_lease.award().is_none() {
            self.reply_to_decommission(true);
        }
        let now = self.settings.clock.now();
        self.update_worker(now);
        self.advance(myself).await
    }

    async fn start(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        award: Award,
        ended: &BTreeSet<StepIndex>,
    ) -> Result<(), BusError> {
        let Award { mission, role, epoch, plan, .. } = award.clone();
        let holders = self.latest_holders.take().filter(|(of, _)| *of == epoch);
        let holders = holders.map_or_else(|| award.holders.clone(), |(_, holders)| holders);
        let restored = self.restored.take().filter(|checkpoint| checkpoint.award.epoch == epoch);
        info!(robot = %self.settings.robot, %mission, %role, %epoch, resumes = restored.is_some(), "starts its role");
        let event = match restored.is_some() {
            true => EventKind::Resumed { mission: mission.clone(), role: role.clone() },
            false => EventKind::Started { mission: mission.clone(), role: role.clone(), epoch },
        };
        let up_to_date = restored.as_ref().filter(|checkpoint| !checkpoint.misses_ended_task(ended));
        let first_goal =
            up_to_date.map_or_else(|| self.settings.driver.next_goal(), |checkpoint| checkpoint.first_goal);
        let has_checkpoint = restored.is_some();
        let (own, alternatives) =
            restored.map(|checkpoint| (checkpoint.ended, checkpoint.alternatives)).unwrap_or_default();
        let resumed = Sequencer::resume(plan.clone(), ended, &own, alternatives, holders.clone());
        let failure = resumed.as_ref().err().map(|problem| TaskFailure {
            task: None,
            cause: problem.to_string(),
            kind: FailureKind::Plan,
        });
        let Ok(sequencer) = resumed.or_else(|_| Sequencer::new(plan, &BTreeSet::new(), holders)) else {
            return Ok(());
        };
        let mut subscriptions = Tasks::default();
        let signals = self.settings.keys.write(&Key::Signal(mission.clone(), role.clone()));
        subscriptions.forward(self.settings.bus.subscribe(&signals).await?, myself, RobotMessage::Signal);
        self.signals.start_role(&mission, &role, epoch, sequencer.sent_signals().clone()).await?;
        self.emit_event(event);
        let mut checkpoint_writer = CheckpointWriter::default();
        checkpoint_writer.mark_outdated();
        self.active_plan = Some(ActivePlan {
            award,
            sequencer,
            recovery_policy: RecoveryPolicy::default(),
            checkpoint_writer,
            attempt: None,
            retry_at: NodeTime::ZERO,
            has_checkpoint,
            pending_release: None,
            first_goal,
            energy_warning_sent: false,
            stale_signals: StaleSignals::new(),
            _subscriptions: subscriptions,
        });
        if let Some(failure) = failure {
            self.release_role(failure);
        }
        // Signals that were sent before the subscription are queried.
        self.query_signals(myself);
        Ok(())
    }

    fn suspend(&mut self) {
        let Some(active) = self.active_plan.as_mut() else { return };
        active.stop();
        active.sequencer.abort_task();
        warn!(robot = %self.settings.robot, mission = %active.award.mission, "lease expired: suspended");
        let (mission, role) = active.mission_and_role();
        self.emit_event(EventKind::Suspended { mission, role });
    }

    fn resume(&mut self) {
        if let Some((mission, role)) = self.active_plan.as_ref().map(ActivePlan::mission_and_role) {
            self.emit_event(EventKind::Resumed { mission, role });
        }
    }

    /// Ends the plan of the award `epoch`, whether active or restored from a checkpoint. Its sent
    /// signals can still be queried.
    fn end_plan(&mut self, epoch: Epoch, reason: EndReason) {
        if let Some(mut active) = self.active_plan.take_if(|active| active.award.epoch == epoch) {
            active.stop();
            self.signals.end_role(&active.award.mission, &active.award.role);
            // The events have happened and are published. Signals that were not sent are left to
            // the next holder.
            let unsent = active.checkpoint_writer.into_pending();
            let events = unsent.into_iter().filter_map(|output| match output {
                PendingOutput::Event(event) => Some(event),
                PendingOutput::Signal(_) => None,
            });
            events.for_each(|event| self.emit_event(event));
            self.emit_halted(&active.award, reason);
        }
        if let Some(checkpoint) = self.restored.take_if(|checkpoint| checkpoint.award.epoch == epoch) {
            self.emit_halted(&checkpoint.award, reason);
        }
    }

    fn emit_halted(&self, award: &Award, reason: EndReason) {
        info!(robot = %self.settings.robot, mission = %award.mission, ?reason, "ends its role");
        let (mission, role) = (award.mission.clone(), award.role.clone());
        self.emit_event(EventKind::Halted { mission, role, reason });
    }

    /// Sends a report to the coordinator. At most 1 report is in flight; another follows at once if
    /// this is called meanwhile.
    pub(super) fn report(&mut self, myself: &ActorRef<RobotMessage>) {
        let (Some(award), Some(beacon)) = (self.role_lease.award(), &self.coordinator) else { return };
        if self.report_in_flight {
            self.report_queued = true;
            return;
        }
        let leaving = || TaskFailure { task: None, cause: DECOMMISSION_CAUSE.to_owned(), kind: FailureKind::Leaving };
        let (is_idle, sent) = (self.settings.driver.is_idle(), self.settings.clock.now());
        let active = self.active_plan.as_mut().filter(|active| active.award.epoch == award.epoch);
        let failure = match active.and_then(|active| active.pending_release.as_mut()) {
            Some(release) => release.take_report(is_idle, sent),
            None => self.decommission_waiters.is_some().then(leaving),
        };
        let active = self.active_plan.as_ref().filter(|active| active.award.epoch == award.epoch);
        let restored = self.restored.as_ref().filter(|checkpoint| checkpoint.award.epoch == award.epoch);
        let ended =
            active.map(|active| active.sequencer.ended()).or_else(|| restored.map(|checkpoint| &checkpoint.ended));
        let report = Report {
            robot: self.settings.robot.clone(),
            incarnation: self.settings.incarnation,
            mission: award.mission.clone(),
            role: award.role.clone(),
            epoch: award.epoch,
            branch: Branch::default(),
            ended: ended.cloned().unwrap_or_default(),
            current_task: active.and_then(|active| active.sequencer.current_task().cloned()),
            place: self.settings.driver.telemetry().map(|report| report.place.clone()),
            from_checkpoint: self.resumed_epoch == Some(award.epoch),
            failure,
        };
        let key = self.settings.keys.write(&Key::Report(beacon.node.clone()));
        self.report_in_flight = true;
        self.reported_at = sent;
        let (bus, limit, to) = (self.settings.bus.clone(), self.settings.lease_terms.lease / 4, myself.clone());
        self.tasks.spawn(async move {
            let reply = send_report(bus, &key, &report, limit).await;
            // A stopped robot needs no reply.
            let _ = to.cast(RobotMessage::ReportReplied { sent, reply });
        });
    }

    /// Refuses new roles and releases the held role.
    pub(super) async fn decommission(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        timeout: Duration,
        done: RpcReplyPort<bool>,
    ) -> Result<(), ActorProcessingErr> {
        self.decommission_waiters.get_or_insert_default().push(done);
        self.tasks.send_after(timeout, myself, RobotMessage::DecommissionTimeout);
        if self.active_plan.as_ref().is_some_and(|active| active.pending_release.is_none()) {
            let (kind, cause) = (FailureKind::Leaving, DECOMMISSION_CAUSE.to_owned());
            self.handle_failure(myself, AttemptFailure { kind, cause, permanent: true }).await?;
        }
        self.report(myself);
        self.perform_actions(myself, vec![]).await
    }

    /// Replies to all pending decommission requests.
    pub(super) fn reply_to_decommission(&mut self, free: bool) {
        for done in self.decommission_waiters.iter_mut().flat_map(std::mem::take) {
            // The caller may have stopped waiting.
            let _ = done.send(free);
        }
    }
}

const DECOMMISSION_CAUSE: &str = "it leaves the fleet";

/// Sends a report to a coordinator and returns the reply.
pub(crate) async fn send_report(bus: SharedBus, key: &str, report: &Report, limit: Duration) -> Option<ReportReply> {
    let bytes = Bytes::from(codec::encode(report).expect("a report fits a message"));
    let mut replies = bus.query(key, bytes, limit).await.ok()?;
    match codec::decode(&replies.recv().await?.payload.ok()?) {
        Ok(reply) => Some(reply),
        Err(problem) => {
            warn!(%problem, "reply to a report cannot be decoded");
            None
        }
    }
}
