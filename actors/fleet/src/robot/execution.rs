//! Execution of a plan: next step, skills, failures and signals.

use super::active_plan::TaskAttempt;
use super::actor::{RobotMessage, RobotState};
use super::checkpoint_writer::PendingOutput;
use super::energy_check::{EnergyForecast, pricing_context};
use super::recovery_policy::{AttemptFailure, RecoveryAction};
use super::release::PendingRelease;
use super::sequencer::{SequencerAction, StaleSignal, StepRef};
use super::settings::RobotSettings;
use super::skill_runner::{SkillOutcome, SkillRun, SkillRunner};
use super::task_timeout::TaskTimer;
use consort_protocol::event::EventKind;
use consort_protocol::ids::TaskId;
use consort_protocol::message::{FailureKind, SignalHistory, TaskFailure};
use consort_protocol::mission::TaskSpec;
use consort_protocol::units::NodeTime;
use consort_skills::actions::RobotActions;
use consort_skills::descriptor::EstimateContext;
use consort_skills::library::SkillContext;
use ractor::{Actor, ActorProcessingErr, ActorRef};
use std::time::Duration;
use tracing::warn;

/// Interval at which the remaining plan is priced while a task is running.
const PRICED_EVERY: Duration = Duration::from_secs(1);

impl RobotState {
    /// The sequencing process: performs all steps that are possible now. Ended steps are
    /// checkpointed before the next task starts or a signal is sent.
    pub(super) async fn advance(&mut self, myself: &ActorRef<RobotMessage>) -> Result<(), ActorProcessingErr> {
        let mut moved = false;
        loop {
            let now = self.settings.clock.now();
            if !self.role_lease.may_act(now) {
                break;
            }
            let Some(active) = self.active_plan.as_mut() else { break };
            let outputs = active.checkpoint_writer.take_ready();
            if !outputs.is_empty() {
                moved = true;
                self.emit_outputs(outputs).await;
                continue;
            }
            if active.pending_release.is_some() || !active.checkpoint_writer.is_idle() || now < active.retry_at {
                break;
            }
            let Some(next) = active.sequencer.next_action() else { break };
            match next {
                SequencerAction::StartTask { step, task, spec } => {
                    moved = true;
                    self.start_task(myself, step, &task, &spec).await?;
                }
                SequencerAction::SendSignal(signal) => active.checkpoint_writer.queue(PendingOutput::Signal(signal)),
                SequencerAction::SignalReceived(signal) => {
                    moved = true;
                    let mission = active.award.mission.clone();
                    self.emit_event(EventKind::Received { mission, signal });
                }
            }
        }
        self.write_checkpoint(myself);
        if moved {
            self.report(myself);
        }
        Ok(())
    }

    /// Sends outputs after their steps were stored in the checkpoint.
    pub(super) async fn emit_outputs(&mut self, outputs: Vec<PendingOutput>) {
        let Some(mission) = self.active_plan.as_ref().map(|active| active.award.mission.clone()) else { return };
        for output in outputs {
            match output {
                PendingOutput::Event(event) => self.emit_event(event),
                PendingOutput::Signal(signal) => {
                    self.signals.send(&mission, &signal).await;
                    self.emit_event(EventKind::Sent { mission: mission.clone(), signal });
                }
            }
        }
    }

    async fn start_task(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        step: StepRef,
        task: &TaskId,
        spec: &TaskSpec,
    ) -> Result<(), ActorProcessingErr> {
        self.check_energy(myself);
        let estimate_context =
            EstimateContext { pose: Some(self.worker.pose), ..pricing_context(&self.worker, self.closed_lanes()) };
        let Some(active) = self.active_plan.as_mut().filter(|active| active.pending_release.is_none()) else {
            return Ok(());
        };
        let (mission, role) = active.mission_and_role();
        self.settings.events.publish(EventKind::TaskBegan { mission, role, task: task.clone() });
        self.skill_runs += 1;
        let run = self.skill_runs;
        let skill_context = SkillContext { holders: active.sequencer.holder_robots() };
        let to = myself.clone();
        let ended = move |outcome| {
            // A stopped robot needs no outcome.
            let _ = to.cast(RobotMessage::SkillEnded { run, outcome });
        };
        match self.settings.library.load(spec, &skill_context) {
            Ok(skill) => {
                self.settings.driver.begin_attempt(active.first_goal);
                let (driver, period) = (self.settings.driver.clone(), self.settings.skill_tick_interval);
                let skill_run = SkillRun { skill, driver, period, on_end: Box::new(ended) };
                let (runner, _) = Actor::spawn_linked(None, SkillRunner, skill_run, myself.get_cell()).await?;
                let estimate =
                    self.settings.estimator.estimate(spec, &estimate_context).ok().map(|estimate| estimate.time);
                let timer = TaskTimer::new(&self.settings.task_timeout, spec, estimate);
                active.attempt = Some(TaskAttempt { run, step, runner, timer });
            }
            Err(problem) => {
                let (kind, cause) = (FailureKind::Task, problem.to_string());
                self.recover(myself, AttemptFailure { kind, cause, permanent: true });
            }
        }
        Ok(())
    }

    pub(super) async fn skill_ended(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        run: u64,
        outcome: SkillOutcome,
    ) -> Result<(), ActorProcessingErr> {
        let Some(active) = self.active_plan.as_mut() else { return Ok(()) };
        let Some(attempt) = active.attempt.take_if(|attempt| attempt.run == run) else {
            return Ok(()); // the skill was halted meanwhile
        };
        match outcome {
            SkillOutcome::Succeeded => {
                let Some(task) = active.sequencer.current_task().cloned() else { return Ok(()) };
                let (mission, role) = active.mission_and_role();
                active.sequencer.end_task(attempt.step);
                active.first_goal = self.settings.driver.next_goal();
                active.checkpoint_writer.queue(PendingOutput::Event(EventKind::TaskEnded { mission, role, task }));
                self.advance(myself).await
            }
            SkillOutcome::Failed(cause) => {
                self.settings.driver.refresh();
                let stranded = self.settings.driver.telemetry().is_some_and(|report| !report.able);
                let kind = if stranded { FailureKind::Battery } else { FailureKind::Task };
                self.handle_failure(myself, AttemptFailure { kind, cause, permanent: false }).await
            }
        }
    }

    /// Handles a failure of the current task or of the whole plan: the recovery policy selects the
    /// next action.
    pub(super) async fn handle_failure(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        failure: AttemptFailure,
    ) -> Result<(), ActorProcessingErr> {
        self.recover(myself, failure);
        self.report(myself);
        self.advance(myself).await
    }

    pub(super) fn recover(&mut self, myself: &ActorRef<RobotMessage>, failure: AttemptFailure) {
        let now = self.settings.clock.now();
        let Some(active) = self.active_plan.as_mut().filter(|active| active.pending_release.is_none()) else { return };
        active.stop();
        let ((mission, role), task) = (active.mission_and_role(), active.sequencer.current_task().cloned());
        let cause = failure.cause.clone();
        warn!(robot = %self.settings.robot, %mission, ?task, ?failure, "attempt failed");
        match (active.recovery_policy.next_action(failure, &mut active.sequencer), task) {
            (RecoveryAction::ReleaseRole(failure), _) => self.release_role(failure),
            (RecoveryAction::Retry { attempt }, Some(task)) => {
                active.retry_at = now + self.settings.retry_delay;
                self.tasks.send_after(self.settings.retry_delay, myself, RobotMessage::Tick);
                self.emit_event(EventKind::TaskRetried { mission, role, task, attempt, cause });
            }
            (RecoveryAction::UseAlternative { alternative }, Some(task)) => {
                let tasks = active.sequencer.alternative_tasks(alternative);
                let event = EventKind::Alternative { mission, role, task, alternative, tasks, cause };
                active.checkpoint_writer.queue(PendingOutput::Event(event));
            }
            // Retry and alternative require a current task.
            (RecoveryAction::Retry { .. } | RecoveryAction::UseAlternative { .. }, None) => {}
        }
    }

    /// Stops the plan. From now on the robot only waits until the coordinator has released the
    /// role.
    pub(super) fn release_role(&mut self, failure: TaskFailure) {
        let now = self.settings.clock.now();
        let Some(active) = self.active_plan.as_mut() else { return };
        let ((mission, role), TaskFailure { task, cause, kind }) = (active.mission_and_role(), failure.clone());
        active.pending_release = Some(PendingRelease::new(failure, now));
        match (kind, task) {
            (FailureKind::Task | FailureKind::Crash | FailureKind::NoProgress, Some(task)) => {
                self.emit_event(EventKind::TaskFailed { mission, role, task, cause });
            }
            _ => self.emit_event(EventKind::GaveUp { mission, role, kind, cause }),
        }
    }

    /// Checks the current task against its timeout, and the battery against the remaining plan.
    pub(super) async fn check_progress(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        now: NodeTime,
    ) -> Result<(), ActorProcessingErr> {
        let silent_for = self.settings.driver.silent_for();
        let world = self.settings.driver.telemetry().map(|report| report.time);
        let Some(attempt) = self.active_plan.as_mut().and_then(|active| active.attempt.as_mut()) else { return Ok(()) };
        if let Some(cause) = attempt.timer.check(world, silent_for) {
            let kind = FailureKind::NoProgress;
            return self.handle_failure(myself, AttemptFailure { kind, cause, permanent: false }).await;
        }
        if now.since(self.priced_at) >= PRICED_EVERY {
            self.check_energy(myself);
        }
        Ok(())
    }

    /// Prices the remaining plan with the current charge. A robot that would strand releases the
    /// role while another robot can still take over. Exception: if it may carry an item, it
    /// continues, because a release would not help.
    fn check_energy(&mut self, myself: &ActorRef<RobotMessage>) {
        let now = self.settings.clock.now();
        self.priced_at = now;
        self.update_worker(now);
        let Some(active) = self.active_plan.as_mut().filter(|active| active.pending_release.is_none()) else { return };
        if self.settings.driver.telemetry().is_none() {
            return;
        }
        let RobotSettings { estimator, limits, .. } = &self.settings;
        let closed = self.settings.driver.telemetry().map_or(&[][..], |report| &report.closed);
        let forecast = EnergyForecast::new(estimator, &active.sequencer.remaining_plan(), &self.worker, closed, limits);
        let Some(cause) = forecast.ok().and_then(|forecast| forecast.shortfall()) else { return };
        if active.sequencer.may_have_custody() {
            if !std::mem::replace(&mut active.energy_warning_sent, true) {
                let (mission, role) = active.mission_and_role();
                self.emit_event(EventKind::LowCharge { mission, role, cause });
            }
            return;
        }
        self.recover(myself, AttemptFailure { kind: FailureKind::Battery, cause, permanent: true });
        self.report(myself);
    }

    pub(super) async fn receive_signals(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        history: &SignalHistory,
    ) -> Result<(), ActorProcessingErr> {
        let Some(active) = self.active_plan.as_mut().filter(|active| active.award.mission == history.mission) else {
            return Ok(());
        };
        let mut has_new = false;
        for signal in history.signals.iter().filter(|signal| signal.to == active.award.role) {
            match active.sequencer.receive_signal(signal, history.epoch) {
                Ok(new) => has_new |= new,
                Err(StaleSignal { current: known }) => {
                    let event = self.signals.record_stale(&mut active.stale_signals, history, signal, known);
                    event.into_iter().for_each(|event| self.settings.events.publish(event));
                }
            }
        }
        if has_new { self.advance(myself).await } else { Ok(()) }
    }

    /// Queries awaited signals at most once per second, because a published signal may have been
    /// lost.
    pub(super) fn query_signals_if_due(&mut self, myself: &ActorRef<RobotMessage>, now: NodeTime) {
        if now.since(self.signals_queried_at) >= Duration::from_secs(1) {
            self.signals_queried_at = now;
            self.query_signals(myself);
        }
    }

    pub(super) fn query_signals(&mut self, myself: &ActorRef<RobotMessage>) {
        let Some(active) = &self.active_plan else { return };
        let to = myself.clone();
        self.signals.query_history(
            &active.award.mission,
            &active.sequencer.awaited_signals(),
            &mut self.tasks,
            move |history| {
                // A stopped robot needs no reply.
                let _ = to.cast(RobotMessage::SignalHistory(history));
            },
        );
    }
}
