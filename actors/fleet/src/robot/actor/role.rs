//! The robot actor performs its role: awards, replies to reports, start and end of the plan.

use super::message::{EndedReport, RobotMessage};
use super::state::{RobotState, leaving};
use crate::robot::active_plan::{ActivePlan, PlanStart};
use crate::robot::checkpoint_writer::PendingOutput;
use crate::robot::leader_poll::Standing;
use crate::robot::lease_client::Renewal;
use crate::robot::recovery_policy::AttemptFailure;
use consort_bus::Query;
use consort_bus::reply;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RoleId};
use consort_protocol::keys::Key;
use consort_protocol::lease::{Action, Award, EndReason, Epoch, Event, RoleHolder};
use consort_protocol::ledger::Resource;
use consort_protocol::message::{AwardNotice, FailureKind, ReportReply};
use consort_protocol::mission::TaskOutcomes;
use consort_protocol::plan::{Signal, StepIndex};
use consort_protocol::units::NodeTime;
use ractor::ActorProcessingErr;
use std::collections::{BTreeMap, BTreeSet};
use tracing::{debug, info, warn};

impl RobotState {
    pub(super) async fn handle_award_notice(&mut self, query: Query) -> Result<(), ActorProcessingErr> {
        let Some((query, notice)) = reply::decode_or_refuse_in::<AwardNotice>(&mut self.tasks, query) else {
            return Ok(());
        };
        match self.confirm_notice(query, notice) {
            Some((query, notice)) => self.perform_notice(query, notice).await,
            None => Ok(()),
        }
    }

    /// Performs a notice of the coordinator.
    pub(super) async fn perform_notice(&mut self, query: Query, notice: AwardNotice) -> Result<(), ActorProcessingErr> {
        let now = self.now();
        let (mut give_way, mut returned, mut orders, mut leased) = (None, None, None, None);
        match &notice {
            AwardNotice::GiveWay { epoch, to, for_now } => give_way = Some((*epoch, to.clone(), *for_now)),
            AwardNotice::Orders(latest) => orders = Some(latest.clone()),
            AwardNotice::Return { epoch, repeat, cause } => returned = Some((*epoch, *repeat, cause.clone())),
            AwardNotice::Leased { resource, epoch } => leased = Some((resource.clone(), epoch.index)),
            AwardNotice::Awarded(_) | AwardNotice::Revoked { .. } => {}
        }
        let (reply, event) = self.lease.answer(notice, self.decommission.is_leaving());
        let key = self.settings.links.keys.write(&Key::Award(self.settings.robot.clone()));
        reply::wire_in(&mut self.tasks, query, key, reply);
        if let Some((epoch, to, for_now)) = give_way {
            self.give_way(epoch, &to, for_now).await?;
        }
        if let Some((epoch, repeat, cause)) = returned {
            self.return_role(epoch, repeat, cause).await?;
        }
        if let Some(orders) = orders {
            self.follow_orders(*orders, now);
            self.perform_actions(vec![]).await?;
        }
        match leased {
            Some((Resource::Charger(charger), lease)) => self.receive_charger_lease(charger, lease, now),
            Some((Resource::Device(device), lease)) => self.receive_device_lease(&device, lease, now),
            None => {}
        }
        match event {
            Some(event) => self.handle_lease_event(event, now).await,
            None => Ok(()),
        }
    }

    /// Returns a role in which the robot has not acted to a mission that waits for the robot. For an earlier iteration of
    /// a loop of the same mission it also returns a role in which it waits and has signalled no other role.
    async fn give_way(&mut self, epoch: Epoch, to: &MissionId, for_now: bool) -> Result<(), ActorProcessingErr> {
        let may_give_way = |active: &mut ActivePlan| {
            let only_waits = active.attempt.is_none() && active.sequencer.can_be_restarted();
            active.award.epoch == epoch
                && (active.sequencer.is_untouched() || (active.award.mission == *to && only_waits))
        };
        if self.execution.continuing_plan().is_some_and(may_give_way) {
            let kind = if for_now { FailureKind::Postponed } else { FailureKind::GaveWay };
            let cause = format!("it gives way to {to}");
            self.handle_failure(AttemptFailure::new(kind, cause)).await?;
        }
        Ok(())
    }

    /// Returns a role that a person has reassigned, if another robot can do it from its start. The ledger may lack what
    /// this robot has done since the request.
    async fn return_role(&mut self, epoch: Epoch, repeat: bool, cause: String) -> Result<(), ActorProcessingErr> {
        let driver = &self.driver;
        let may_return = |active: &mut ActivePlan| {
            let ActivePlan { award, sequencer, .. } = &*active;
            let has_no_item = !sequencer.may_receive_item() && driver.moved_nothing(active.first_goal());
            let can_be_repeated = sequencer.can_be_restarted() && (repeat || !sequencer.has_ended_task());
            award.epoch == epoch && has_no_item && can_be_repeated
        };
        if self.execution.continuing_plan().is_some_and(may_return) {
            self.handle_failure(AttemptFailure::new(FailureKind::Reassigned, cause)).await?;
        }
        Ok(())
    }

    /// Handles an event of the lease.
    pub(super) async fn handle_lease_event(&mut self, event: Event, now: NodeTime) -> Result<(), ActorProcessingErr> {
        let actions = self.lease.handle(event, now);
        self.perform_actions(actions).await
    }

    /// Handles the end of a report. A reply counts only once the voters have had the time to confirm its author.
    pub(super) async fn handle_report_reply(&mut self, report: EndedReport) -> Result<(), ActorProcessingErr> {
        let now = self.now();
        let standing = self.leader_check.standing(&report.recipient, report.position(), now);
        if report.has_effect() && standing == Standing::Unconfirmed {
            self.await_poll_for_reply(report, now);
            return Ok(());
        }
        self.end_report(report, standing).await
    }

    /// Ends a report: renews the lease, or ends the role. The reply of a refuted node is dropped.
    pub(super) async fn end_report(
        &mut self,
        report: EndedReport,
        standing: Standing,
    ) -> Result<(), ActorProcessingErr> {
        let now = self.now();
        let EndedReport { recipient, sent, reply } = report;
        let reply = reply.filter(|_| standing != Standing::Refuted);
        let answered = !matches!(reply, None | Some(ReportReply::NotCoordinator { .. }));
        self.lease.end_report(&recipient, answered, now);
        let actions = match reply {
            Some(ReportReply::Renewed { epoch, ended, holders, signals, outcomes, answer, orders }) => {
                self.follow_orders_of(standing, *orders, now);
                answer.into_iter().for_each(|answer| self.driver.question().receive(epoch, answer));
                self.update_plan(epoch, &ended, &holders, &signals, outcomes);
                self.lease.renew(Renewal { epoch, sent, ended, holders }, now)
            }
            Some(ReportReply::Ended { epoch, reason: EndReason::Over, .. }) => self.settle(epoch, now).await,
            Some(ReportReply::Ended { epoch, reason, .. }) => self.lease.handle(Event::Revoked { epoch, reason }, now),
            Some(ReportReply::NotCoordinator { coordinator }) => {
                debug!(robot = %self.settings.robot, ?coordinator, "reported to a node that is not the coordinator");
                vec![]
            }
            None => vec![],
        };
        self.perform_actions(actions).await?;
        if self.lease.take_queued_report() {
            self.report();
        }
        self.advance().await
    }

    /// Updates the plan of a renewed award from the ledger.
    fn update_plan(
        &mut self,
        epoch: Epoch,
        ended: &BTreeSet<StepIndex>,
        holders: &BTreeMap<RoleId, RoleHolder>,
        signals: &BTreeSet<Signal>,
        outcomes: TaskOutcomes,
    ) {
        let Some(active) = self.execution.plan_of(epoch) else { return };
        active.sequencer.set_recorded(ended);
        let discarded = active.sequencer.set_holders(holders.clone());
        active.sequencer.receive_recorded(signals);
        active.sequencer.set_recorded_outcomes(outcomes);
        if discarded {
            self.query_signals();
        }
    }

    /// Ends the plan of a role that is over and has no successor. Every step in the ledger counts
    /// as sent, so pending outputs are sent now, with or without a checkpoint.
    async fn settle(&mut self, epoch: Epoch, now: NodeTime) -> Vec<Action> {
        let unsent = self.execution.plan_of(epoch).map(ActivePlan::take_pending);
        self.emit_outputs(unsent.unwrap_or_default());
        self.end_plan(epoch, EndReason::Over);
        self.lease.handle(Event::Settled { epoch }, now)
    }

    /// Performs the actions of the lease, and then all steps of the plan that are possible.
    pub(super) async fn perform_actions(&mut self, actions: Vec<Action>) -> Result<(), ActorProcessingErr> {
        for action in actions {
            match action {
                Action::Report => self.report(),
                Action::Start(award, ended) => self.start(*award, &ended),
                Action::Suspend { until } => self.suspend(until),
                Action::Resume => self.resume(),
                Action::Halt(reason) => self.halt(reason),
            }
        }
        self.end_obsolete_drive(self.now());
        self.update_permission();
        if self.lease.award().is_none() {
            self.decommission.reply(true);
        }
        self.sense(self.now());
        self.advance().await
    }

    fn start(&mut self, award: Award, recorded: &BTreeSet<StepIndex>) {
        let (mission, role, epoch) = (award.mission.clone(), award.role.clone(), award.epoch);
        let holders = self.lease.take_holders(&award);
        let restored = self.checkpoint.take_restored_for(epoch);
        info!(robot = %self.settings.robot, %mission, %role, %epoch, resumes = restored.is_some(), "starts its role");
        let event = match restored.is_some() {
            true => EventKind::Resumed { mission: mission.clone(), role: role.clone() },
            false => EventKind::Started { mission: mission.clone(), role: role.clone(), epoch },
        };
        let next_goal = self.driver.next_goal();
        let start = PlanStart { award, recorded, holders, restored, next_goal };
        let Some((mut active, failure)) = ActivePlan::start(start) else { return };
        let links = &self.settings.links;
        let key = links.keys.write(&Key::Signal(mission.clone(), role.clone()));
        active.subscriptions.subscribe(links.bus.clone(), key, &self.myself, RobotMessage::Signal);
        self.signals.start_role(&mission, &role, epoch, active.sequencer.sent_signals().clone());
        self.emit_event(event);
        // A robot that was asked to leave after the award was received starts no task.
        let failure = failure.or_else(|| self.decommission.is_leaving().then(leaving));
        let release = failure.map(|failure| active.release(failure, self.now()));
        self.execution.plan = Some(active);
        release.into_iter().for_each(|event| self.emit_event(event));
        // Signals that were sent before the subscription are queried.
        self.query_signals();
    }

    /// Suspends the plan, whose lease ends at this time.
    fn suspend(&mut self, until: NodeTime) {
        let lease_left_ms = u64::try_from(until.since(self.now()).as_millis()).unwrap_or(u64::MAX);
        let Some(active) = self.execution.plan.as_mut() else { return };
        active.suspend();
        let mission = &active.award.mission;
        warn!(robot = %self.settings.robot, %mission, lease_left_ms, "lease not renewed in time: suspended");
        let (mission, role) = active.mission_and_role();
        self.emit_event(EventKind::Suspended { mission, role, lease_left_ms });
    }

    fn resume(&mut self) {
        if let Some((mission, role)) = self.execution.plan.as_ref().map(ActivePlan::mission_and_role) {
            self.emit_event(EventKind::Resumed { mission, role });
        }
    }

    fn halt(&mut self, reason: EndReason) {
        let held = self.execution.plan.as_ref().map(|active| active.award.epoch);
        let restored = self.checkpoint.restored().map(|checkpoint| checkpoint.award.epoch);
        if let Some(epoch) = held.or(restored) {
            self.end_plan(epoch, reason);
        }
    }

    /// Ends the plan of the award `epoch`, whether active or restored from a checkpoint. Its sent
    /// signals can still be queried.
    fn end_plan(&mut self, epoch: Epoch, reason: EndReason) {
        let mut may_have_item = false;
        if let Some(mut active) = self.execution.take_plan(epoch) {
            active.stop();
            may_have_item = active.sequencer.may_have_custody();
            self.signals.end_role(&active.award.mission, &active.award.role);
            // The events have happened and are published. Signals that were not sent are left to
            // the next holder.
            for output in active.take_pending() {
                if let PendingOutput::Event(event) = output {
                    self.emit_event(event);
                }
            }
            self.emit_halted(&active.award, reason);
        }
        if let Some(checkpoint) = self.checkpoint.take_restored_if(epoch) {
            may_have_item = true;
            self.emit_halted(&checkpoint.award, reason);
        }
        if may_have_item && reason != EndReason::Over {
            self.orders.await_notice(self.now());
        }
    }

    fn emit_halted(&self, award: &Award, reason: EndReason) {
        info!(robot = %self.settings.robot, mission = %award.mission, ?reason, "ends its role");
        let (mission, role) = (award.mission.clone(), award.role.clone());
        self.emit_event(EventKind::Halted { mission, role, reason });
    }
}
