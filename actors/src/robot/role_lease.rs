//! Holding a role: awards, reports and their answers, putting down, leaving.

use super::active_plan::ActivePlan;
use super::actor::{RobotMessage, RobotState};
use super::checkpoint_writer::{CheckpointWriter, PendingOutput};
use super::recovery_policy::{AttemptFailure, RecoveryPolicy};
use super::sequencer::Sequencer;
use super::signals::StaleSignals;
use crate::bus::{BusError, Query, SharedBus};
use crate::reply;
use crate::tasks::Tasks;
use bytes::Bytes;
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
        let (said, event) = match notice {
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
        reply::wire(query, &key, &said).await;
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
        answer: Option<ReportReply>,
    ) -> Result<(), ActorProcessingErr> {
        self.report_in_flight = false;
        let now = self.settings.clock.now();
        let actions = match answer {
            Some(ReportReply::Renewed { epoch, ended, holders, signals }) => {
                if let Some(job) = self.active_plan.as_mut().filter(|job| job.award.epoch == epoch) {
                    job.sequencer.set_recorded(&ended);
                    let changed = job.sequencer.set_holders(holders.clone());
                    job.sequencer.receive_recorded(&signals);
                    if changed {
                        self.query_signals(myself);
                    }
                }
                self.latest_holders = Some((epoch, holders));
                self.role_lease.handle(Event::Renewed { epoch, sent, ended }, now)
            }
            Some(ReportReply::Ended { epoch, reason: EndReason::Over, .. }) => {
                // Nobody takes over: what the ledger counts as said is said now, whether or not the disk has it.
                let job = self.active_plan.as_mut().filter(|job| job.award.epoch == epoch);
                let untold = job.map(|job| std::mem::take(&mut job.checkpoint_writer).into_pending());
                self.emit_outputs(untold.unwrap_or_default()).await;
                self.put_down(epoch, EndReason::Over);
                self.role_lease.handle(Event::Settled { epoch }, now)
            }
            Some(ReportReply::Ended { epoch, reason, .. }) => {
                self.role_lease.handle(Event::Revoked { epoch, reason }, now)
            }
            Some(ReportReply::NotCoordinator { coordinator }) => {
                debug!(robot = %self.settings.robot, ?coordinator, "reported to one who does not coordinate");
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
                    let held = self.active_plan.as_ref().map(|job| job.award.epoch);
                    let recalled = self.restored.as_ref().map(|page| page.award.epoch);
                    if let Some(epoch) = held.or(recalled) {
                        self.put_down(epoch, reason);
                    }
                }
            }
        }
        if self.role_lease.award().is_none() {
            self.answer_decommission(true);
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
        let recalled = self.restored.take().filter(|page| page.award.epoch == epoch);
        info!(robot = %self.settings.robot, %mission, %role, %epoch, resumes = recalled.is_some(), "begins");
        let begins = match recalled.is_some() {
            true => EventKind::Resumed { mission: mission.clone(), role: role.clone() },
            false => EventKind::Started { mission: mission.clone(), role: role.clone(), epoch },
        };
        let up_to_date = recalled.as_ref().filter(|page| !page.misses_ended_task(ended));
        let first_goal = up_to_date.map_or_else(|| self.settings.driver.next_goal(), |page| page.first_goal);
        let on_record = recalled.is_some();
        let (own, detours) = recalled.map(|page| (page.ended, page.alternatives)).unwrap_or_default();
        let taken_up = Sequencer::resume(plan.clone(), ended, &own, detours, holders.clone());
        let failure = taken_up.as_ref().err().map(|problem| TaskFailure {
            task: None,
            cause: problem.to_string(),
            kind: FailureKind::Plan,
        });
        let Ok(sequencer) = taken_up.or_else(|_| Sequencer::new(plan, &BTreeSet::new(), holders)) else {
            return Ok(());
        };
        let mut hearing = Tasks::default();
        let signals = self.settings.keys.write(&Key::Signal(mission.clone(), role.clone()));
        hearing.forward(self.settings.bus.subscribe(&signals).await?, myself, RobotMessage::Signal);
        self.signals.start_role(&mission, &role, epoch, sequencer.sent_signals().clone()).await?;
        self.emit_event(begins);
        let mut pen = CheckpointWriter::default();
        pen.mark_outdated();
        self.active_plan = Some(ActivePlan {
            award,
            sequencer,
            recovery_policy: RecoveryPolicy::default(),
            checkpoint_writer: pen,
            attempt: None,
            retry_at: NodeTime::ZERO,
            has_checkpoint: on_record,
            pending_release: None,
            first_goal,
            energy_warning_sent: false,
            stale_signals: StaleSignals::new(),
            _subscriptions: hearing,
        });
        if let Some(failure) = failure {
            self.release_role(failure);
        }
        // Whoever spoke before this robot listened is asked.
        self.query_signals(myself);
        Ok(())
    }

    fn suspend(&mut self) {
        let Some(job) = self.active_plan.as_mut() else { return };
        job.stop();
        job.sequencer.abort_task();
        warn!(robot = %self.settings.robot, mission = %job.award.mission, "lease ran out: suspended");
        let (mission, role) = job.mission_and_role();
        self.emit_event(EventKind::Suspended { mission, role });
    }

    fn resume(&mut self) {
        if let Some((mission, role)) = self.active_plan.as_ref().map(ActivePlan::mission_and_role) {
            self.emit_event(EventKind::Resumed { mission, role });
        }
    }

    /// Stops and forgets the plan held under `epoch`, or recalled from a former life. What was said in it can still be
    /// asked for.
    fn put_down(&mut self, epoch: Epoch, reason: EndReason) {
        if let Some(mut job) = self.active_plan.take_if(|job| job.award.epoch == epoch) {
            job.stop();
            self.signals.end_role(&job.award.mission, &job.award.role);
            // What has happened has happened; what was not said yet is said by whoever takes over.
            let untold = job.checkpoint_writer.into_pending();
            let happened = untold.into_iter().filter_map(|telling| match telling {
                PendingOutput::Event(what) => Some(what),
                PendingOutput::Signal(_) => None,
            });
            happened.for_each(|what| self.emit_event(what));
            self.halted(&job.award, reason);
        }
        if let Some(page) = self.restored.take_if(|page| page.award.epoch == epoch) {
            self.halted(&page.award, reason);
        }
    }

    fn halted(&self, award: &Award, reason: EndReason) {
        info!(robot = %self.settings.robot, mission = %award.mission, ?reason, "puts its role down");
        let (mission, role) = (award.mission.clone(), award.role.clone());
        self.emit_event(EventKind::Halted { mission, role, reason });
    }

    /// Reports to the coordinator; one report at a time, and another at once if there was news meanwhile.
    pub(super) fn report(&mut self, myself: &ActorRef<RobotMessage>) {
        let (Some(award), Some(beacon)) = (self.role_lease.award(), &self.coordinator) else { return };
        if self.report_in_flight {
            self.report_queued = true;
            return;
        }
        let leaving = || TaskFailure { task: None, cause: LEAVES.to_owned(), kind: FailureKind::Leaving };
        let (at_rest, sent) = (self.settings.driver.is_idle(), self.settings.clock.now());
        let job = self.active_plan.as_mut().filter(|job| job.award.epoch == award.epoch);
        let failure = match job.and_then(|job| job.pending_release.as_mut()) {
            Some(surrender) => surrender.take_report(at_rest, sent),
            None => self.decommission_waiters.is_some().then(leaving),
        };
        let job = self.active_plan.as_ref().filter(|job| job.award.epoch == award.epoch);
        let recalled = self.restored.as_ref().filter(|page| page.award.epoch == award.epoch);
        let ended = job.map(|job| job.sequencer.ended()).or_else(|| recalled.map(|page| &page.ended));
        let report = Report {
            robot: self.settings.robot.clone(),
            incarnation: self.settings.incarnation,
            mission: award.mission.clone(),
            role: award.role.clone(),
            epoch: award.epoch,
            branch: Branch::default(),
            ended: ended.cloned().unwrap_or_default(),
            current_task: job.and_then(|job| job.sequencer.current_task().cloned()),
            place: self.settings.driver.telemetry().map(|report| report.place.clone()),
            from_checkpoint: self.resumed_epoch == Some(award.epoch),
            failure,
        };
        let key = self.settings.keys.write(&Key::Report(beacon.node.clone()));
        self.report_in_flight = true;
        self.reported_at = sent;
        let (bus, limit, to) = (self.settings.bus.clone(), self.settings.lease_terms.lease / 4, myself.clone());
        self.tasks.spawn(async move {
            let answer = send_report(bus, &key, &report, limit).await;
            // A robot that has stopped needs no answer.
            let _ = to.cast(RobotMessage::ReportReplied { sent, reply: answer });
        });
    }

    /// Takes nothing new, and gives up what is held.
    pub(super) async fn decommission(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        within: Duration,
        done: RpcReplyPort<bool>,
    ) -> Result<(), ActorProcessingErr> {
        self.decommission_waiters.get_or_insert_default().push(done);
        self.tasks.send_after(within, myself, RobotMessage::DecommissionTimeout);
        if self.active_plan.as_ref().is_some_and(|job| job.pending_release.is_none()) {
            let (kind, cause) = (FailureKind::Leaving, LEAVES.to_owned());
            self.handle_failure(myself, AttemptFailure { kind, cause, permanent: true }).await?;
        }
        self.report(myself);
        self.perform_actions(myself, vec![]).await
    }

    /// Answers those who wait for the robot to have left.
    pub(super) fn answer_decommission(&mut self, free: bool) {
        for done in self.decommission_waiters.iter_mut().flat_map(std::mem::take) {
            // Whoever no longer waits needs no answer.
            let _ = done.send(free);
        }
    }
}

const LEAVES: &str = "it leaves the fleet";

/// Reports to one coordinator, and gives its answer.
pub(crate) async fn send_report(bus: SharedBus, key: &str, report: &Report, limit: Duration) -> Option<ReportReply> {
    let bytes = Bytes::from(codec::encode(report).expect("a report fits a message"));
    let mut replies = bus.query(key, bytes, limit).await.ok()?;
    match codec::decode(&replies.recv().await?.payload.ok()?) {
        Ok(answer) => Some(answer),
        Err(problem) => {
            warn!(%problem, "an answer to a report that cannot be read");
            None
        }
    }
}
