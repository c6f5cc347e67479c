//! Carrying a plan out: the next step, skills, setbacks and signals.

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

/// How often the rest of the plan is priced while a task is under way.
const PRICED_EVERY: Duration = Duration::from_secs(1);

impl RobotState {
    /// The sequencing process: as many steps as can be taken now. What has ended is written down before anything new is
    /// begun or told.
    pub(super) async fn advance(&mut self, myself: &ActorRef<RobotMessage>) -> Result<(), ActorProcessingErr> {
        let mut moved = false;
        loop {
            let now = self.settings.clock.now();
            if !self.role_lease.may_act(now) {
                break;
            }
            let Some(job) = self.active_plan.as_mut() else { break };
            let written = job.checkpoint_writer.take_ready();
            if !written.is_empty() {
                moved = true;
                self.emit_outputs(written).await;
                continue;
            }
            if job.pending_release.is_some() || !job.checkpoint_writer.is_idle() || now < job.retry_at {
                break;
            }
            let Some(next) = job.sequencer.next_action() else { break };
            match next {
                SequencerAction::StartTask { step: spot, task, spec } => {
                    moved = true;
                    self.begin_task(myself, spot, &task, &spec).await?;
                }
                SequencerAction::SendSignal(signal) => job.checkpoint_writer.queue(PendingOutput::Signal(signal)),
                SequencerAction::SignalReceived(signal) => {
                    moved = true;
                    let mission = job.award.mission.clone();
                    self.emit_event(EventKind::Heard { mission, signal });
                }
            }
        }
        self.write_checkpoint(myself);
        if moved {
            self.report(myself);
        }
        Ok(())
    }

    /// Tells what has been written down.
    pub(super) async fn emit_outputs(&mut self, written: Vec<PendingOutput>) {
        let Some(mission) = self.active_plan.as_ref().map(|job| job.award.mission.clone()) else { return };
        for telling in written {
            match telling {
                PendingOutput::Event(what) => self.emit_event(what),
                PendingOutput::Signal(signal) => {
                    self.signals.send(&mission, &signal).await;
                    self.emit_event(EventKind::Sent { mission: mission.clone(), signal });
                }
            }
        }
    }

    async fn begin_task(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        spot: StepRef,
        task: &TaskId,
        spec: &TaskSpec,
    ) -> Result<(), ActorProcessingErr> {
        self.look_after_charge(myself);
        let here =
            EstimateContext { pose: Some(self.worker.pose), ..pricing_context(&self.worker, self.closed_lanes()) };
        let Some(job) = self.active_plan.as_mut().filter(|job| job.pending_release.is_none()) else { return Ok(()) };
        let (mission, role) = job.mission_and_role();
        self.settings.events.publish(EventKind::TaskBegan { mission, role, task: task.clone() });
        self.skill_runs += 1;
        let run = self.skill_runs;
        let skill_context = SkillContext { holders: job.sequencer.holder_robots() };
        let to = myself.clone();
        let ended = move |outcome| {
            // A robot that has stopped needs no outcome.
            let _ = to.cast(RobotMessage::SkillEnded { run, outcome });
        };
        match self.settings.library.load(spec, &skill_context) {
            Ok(skill) => {
                self.settings.driver.begin_attempt(job.first_goal);
                let (body, period) = (self.settings.driver.clone(), self.settings.skill_tick_interval);
                let run_it = SkillRun { skill, driver: body, period, on_end: Box::new(ended) };
                let (runner, _) = Actor::spawn_linked(None, SkillRunner, run_it, myself.get_cell()).await?;
                let estimate = self.settings.estimator.estimate(spec, &here).ok().map(|estimate| estimate.time);
                let watch = TaskTimer::new(&self.settings.task_timeout, spec, estimate);
                job.attempt = Some(TaskAttempt { run, step: spot, runner, timer: watch });
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
        let Some(job) = self.active_plan.as_mut() else { return Ok(()) };
        let Some(attempt) = job.attempt.take_if(|attempt| attempt.run == run) else {
            return Ok(()); // one that was halted meanwhile
        };
        match outcome {
            SkillOutcome::Succeeded => {
                let Some(task) = job.sequencer.current_task().cloned() else { return Ok(()) };
                let (mission, role) = job.mission_and_role();
                job.sequencer.end_task(attempt.step);
                job.first_goal = self.settings.driver.next_goal();
                job.checkpoint_writer.queue(PendingOutput::Event(EventKind::TaskEnded { mission, role, task }));
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

    /// The task under way, or the whole plan, has met with a setback: the ladder says what follows.
    pub(super) async fn handle_failure(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        setback: AttemptFailure,
    ) -> Result<(), ActorProcessingErr> {
        self.recover(myself, setback);
        self.report(myself);
        self.advance(myself).await
    }

    pub(super) fn recover(&mut self, myself: &ActorRef<RobotMessage>, setback: AttemptFailure) {
        let now = self.settings.clock.now();
        let Some(job) = self.active_plan.as_mut().filter(|job| job.pending_release.is_none()) else { return };
        job.stop();
        let ((mission, role), task) = (job.mission_and_role(), job.sequencer.current_task().cloned());
        let cause = setback.cause.clone();
        warn!(robot = %self.settings.robot, %mission, ?task, ?setback, "met with a setback");
        match (job.recovery_policy.next_action(setback, &mut job.sequencer), task) {
            (RecoveryAction::ReleaseRole(failure), _) => self.release_role(failure),
            (RecoveryAction::Retry { attempt }, Some(task)) => {
                job.retry_at = now + self.settings.retry_delay;
                self.tasks.send_after(self.settings.retry_delay, myself, RobotMessage::Tick);
                self.emit_event(EventKind::TaskRetried { mission, role, task, attempt, cause });
            }
            (RecoveryAction::UseAlternative { alternative }, Some(task)) => {
                let tasks = job.sequencer.alternative_tasks(alternative);
                let what = EventKind::Alternative { mission, role, task, alternative, tasks, cause };
                job.checkpoint_writer.queue(PendingOutput::Event(what));
            }
            // Only a task under way is tried again or done otherwise.
            (RecoveryAction::Retry { .. } | RecoveryAction::UseAlternative { .. }, None) => {}
        }
    }

    /// From now on the robot only waits for the coordinator to take the role from it.
    pub(super) fn release_role(&mut self, failure: TaskFailure) {
        let now = self.settings.clock.now();
        let Some(job) = self.active_plan.as_mut() else { return };
        let ((mission, role), TaskFailure { task, cause, kind }) = (job.mission_and_role(), failure.clone());
        job.pending_release = Some(PendingRelease::new(failure, now));
        match (kind, task) {
            (FailureKind::Task | FailureKind::Crash | FailureKind::NoProgress, Some(task)) => {
                self.emit_event(EventKind::TaskFailed { mission, role, task, cause });
            }
            _ => self.emit_event(EventKind::GaveUp { mission, role, kind, cause }),
        }
    }

    /// Looks whether the task under way takes too long, and whether the battery lasts.
    pub(super) async fn check_progress(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        now: NodeTime,
    ) -> Result<(), ActorProcessingErr> {
        let silent_for = self.settings.driver.silent_for();
        let world = self.settings.driver.telemetry().map(|report| report.time);
        let Some(attempt) = self.active_plan.as_mut().and_then(|job| job.attempt.as_mut()) else { return Ok(()) };
        if let Some(cause) = attempt.timer.check(world, silent_for) {
            let kind = FailureKind::NoProgress;
            return self.handle_failure(myself, AttemptFailure { kind, cause, permanent: false }).await;
        }
        if now.since(self.priced_at) >= PRICED_EVERY {
            self.look_after_charge(myself);
        }
        Ok(())
    }

    /// Prices the rest of the plan with the charge there is. A robot that would be stranded gives the role up while another
    /// can still take it over, unless it may have something in its hands: then giving up helps nobody.
    fn look_after_charge(&mut self, myself: &ActorRef<RobotMessage>) {
        let now = self.settings.clock.now();
        self.priced_at = now;
        self.update_worker(now);
        let Some(job) = self.active_plan.as_mut().filter(|job| job.pending_release.is_none()) else { return };
        if self.settings.driver.telemetry().is_none() {
            return;
        }
        let RobotSettings { estimator, limits, .. } = &self.settings;
        let closed = self.settings.driver.telemetry().map_or(&[][..], |report| &report.closed);
        let forecast = EnergyForecast::new(estimator, &job.sequencer.remaining_plan(), &self.worker, closed, limits);
        let Some(cause) = forecast.ok().and_then(|forecast| forecast.shortfall()) else { return };
        if job.sequencer.may_have_custody() {
            if !std::mem::replace(&mut job.energy_warning_sent, true) {
                let (mission, role) = job.mission_and_role();
                self.emit_event(EventKind::ChargeShort { mission, role, cause });
            }
            return;
        }
        self.recover(myself, AttemptFailure { kind: FailureKind::Battery, cause, permanent: true });
        self.report(myself);
    }

    pub(super) async fn receive_signals(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        said: &SignalHistory,
    ) -> Result<(), ActorProcessingErr> {
        let Some(job) = self.active_plan.as_mut().filter(|job| job.award.mission == said.mission) else {
            return Ok(());
        };
        let mut news = false;
        for signal in said.signals.iter().filter(|signal| signal.to == job.award.role) {
            match job.sequencer.receive_signal(signal, said.epoch) {
                Ok(new) => news |= new,
                Err(StaleSignal { current: known }) => {
                    let told = self.signals.record_stale(&mut job.stale_signals, said, signal, known);
                    told.into_iter().for_each(|what| self.settings.events.publish(what));
                }
            }
        }
        if news { self.advance(myself).await } else { Ok(()) }
    }

    /// Every now and then, asks those from whom a signal is awaited: it may have been lost.
    pub(super) fn query_signals_if_due(&mut self, myself: &ActorRef<RobotMessage>, now: NodeTime) {
        if now.since(self.signals_queried_at) >= Duration::from_secs(1) {
            self.signals_queried_at = now;
            self.query_signals(myself);
        }
    }

    pub(super) fn query_signals(&mut self, myself: &ActorRef<RobotMessage>) {
        let Some(job) = &self.active_plan else { return };
        let to = myself.clone();
        self.signals.query_history(
            &job.award.mission,
            &job.sequencer.awaited_signals(),
            &mut self.tasks,
            move |said| {
                // A robot that has stopped needs no answer.
                let _ = to.cast(RobotMessage::SignalHistory(said));
            },
        );
    }
}
