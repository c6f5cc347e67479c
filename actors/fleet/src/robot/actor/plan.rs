//! The robot actor performs its plan: next step, skills, failures, checkpoints and signals.

use super::message::RobotMessage;
use super::state::RobotState;
use crate::robot::active_plan::{PlanAction, RecoveryEffect, ShortfallEffect, TaskAttempt};
use crate::robot::alarm_drive::AlarmDestination;
use crate::robot::charging::ChargeControl;
use crate::robot::device_access::DeviceAccess;
use crate::robot::energy_check::EnergyForecast;
use crate::robot::own_tasks::OwnTask;
use crate::robot::recovery_policy::AttemptFailure;
use crate::robot::sequencer::{SignalEffect, StaleSignal, StepRef};
use crate::robot::settings::{PricingSettings, RobotSettings};
use crate::robot::signals::ReceivedSignals;
use crate::robot::skill_runner::{RunningSkill, SkillOutcome, SkillRun};
use crate::robot::task_timeout::{TaskTimer, is_closed_by_people};
use consort_protocol::cause::CauseClass;
use consort_protocol::event::EventKind;
use consort_protocol::ids::TaskId;
use consort_protocol::message::FailureKind;
use consort_protocol::mission::TaskSpec;
use consort_protocol::plan::Signal;
use consort_protocol::units::NodeTime;
use consort_skills::descriptor::EstimateContext;
use consort_skills::library::ActiveSkill;
use consort_skills::skill::SkillContext;
use ractor::{ActorId, ActorProcessingErr};
use std::io;
use tracing::{debug, warn};

impl RobotState {
    /// The sequencing process: performs all steps that are possible now.
    pub(super) async fn advance(&mut self) -> Result<(), ActorProcessingErr> {
        let mut moved = false;
        while let Some(next) = self.next_action() {
            moved = true;
            match next {
                PlanAction::Emit(outputs) => self.emit_outputs(outputs),
                PlanAction::StartTask { step, task, spec } => self.start_task(step, &task, &spec).await?,
                PlanAction::ReportReceived(signal) => self.emit_received(signal),
                PlanAction::ReturnTo(place) => {
                    self.start_alarm_drive(AlarmDestination::Return(place), self.now()).await?;
                }
                PlanAction::Fail(failure) => self.recover(failure),
            }
        }
        self.write_checkpoint();
        if moved {
            self.report();
        }
        Ok(())
    }

    fn next_action(&mut self) -> Option<PlanAction> {
        let now = self.now();
        let may_act = self.lease.may_act(now) && !self.orders.is_held(now) && self.alarm_drive.lets_plan_act(now);
        if may_act { self.execution.next_action(now) } else { None }
    }

    fn emit_received(&self, signal: Signal) {
        if let Some(mission) = self.execution.plan.as_ref().map(|active| active.award.mission.clone()) {
            self.emit_event(EventKind::Received { mission, signal });
        }
    }

    async fn start_task(&mut self, step: StepRef, task: &TaskId, spec: &TaskSpec) -> Result<(), ActorProcessingErr> {
        self.check_energy();
        let estimate_context = self.driver.estimate_context();
        let Some(active) = self.execution.continuing_plan() else { return Ok(()) };
        let ((mission, role), epoch) = (active.mission_and_role(), active.award.epoch);
        let (first_goal, holders) = (active.first_goal(), active.sequencer.holder_robots());
        self.emit_event(EventKind::TaskBegan { mission, role, task: task.clone() });
        let skill = match self.settings.execution.library.load(spec, &SkillContext { holders }) {
            Ok(skill) => skill,
            Err(problem) => {
                let (kind, cause) = (FailureKind::Task, problem.to_string());
                let class = CauseClass::Precondition;
                self.recover(AttemptFailure { class, ..AttemptFailure::new(kind, cause) });
                return Ok(());
            }
        };
        self.driver.begin_attempt(first_goal);
        self.driver.question().begin_attempt(epoch, task);
        let (skill, timer) = self.start_skill(spec, skill, &estimate_context).await?;
        if let Some(active) = &mut self.execution.plan {
            active.attempt = Some(TaskAttempt { step, skill, timer });
        }
        Ok(())
    }

    /// Starts a task that belongs to no plan. Returns the problem of a task that cannot start.
    pub(super) async fn start_own_task(
        &mut self,
        task: &TaskSpec,
    ) -> Result<Result<OwnTask, String>, ActorProcessingErr> {
        let skill = match self.settings.execution.library.load(task, &SkillContext::default()) {
            Ok(skill) => skill,
            Err(problem) => return Ok(Err(problem.to_string())),
        };
        let context = self.driver.estimate_context();
        self.driver.begin_attempt(self.driver.next_goal());
        let (skill, timer) = self.start_skill(task, skill, &context).await?;
        Ok(Ok(OwnTask { spec: task.clone(), skill, timer }))
    }

    /// Starts a skill, and the timer of its task. The end of the skill is a message to this actor.
    async fn start_skill(
        &mut self,
        spec: &TaskSpec,
        skill: ActiveSkill,
        context: &EstimateContext,
    ) -> Result<(RunningSkill, TaskTimer), ActorProcessingErr> {
        let (run, to) = (self.execution.next_run(), self.myself.clone());
        let on_end = Box::new(move |outcome| {
            // A stopped robot needs no outcome.
            let _ = to.cast(RobotMessage::SkillEnded { run, outcome });
        });
        let period = self.settings.execution.skill_tick_interval;
        let skill_run = SkillRun { run, skill, driver: self.driver.driver(), period, on_end };
        let skill = RunningSkill::start(skill_run, self.myself.get_cell()).await?;
        Ok((skill, task_timer(&self.settings, spec, context)))
    }

    /// Gives the task in progress the time that it needs now, since the speed limits on its way have changed. It has no
    /// less time than before: the robot drives its present leg as slowly as it began.
    pub(super) fn extend_timers(&mut self) {
        let (context, world) = (self.driver.estimate_context(), self.driver.world_time());
        let RobotState { settings, execution, alarm_drive, charging, .. } = self;
        if let Some(active) = &mut execution.plan
            && let Some((.., spec)) = active.sequencer.current_step()
        {
            let timer = task_timer(settings, spec, &context);
            active.extend_timer(timer, world);
        }
        let own_tasks = [alarm_drive.task_mut(), charging.as_mut().and_then(ChargeControl::task_mut)];
        for task in own_tasks.into_iter().flatten() {
            task.timer.extend(task_timer(settings, &task.spec, &context), world);
        }
    }

    pub(super) async fn skill_ended(&mut self, run: u64, outcome: SkillOutcome) -> Result<(), ActorProcessingErr> {
        let Some(outcome) = self.end_charging_task(run, outcome) else { return Ok(()) };
        let Some(outcome) = self.end_alarm_drive(run, outcome) else { return self.advance().await };
        let Some(active) = self.execution.plan.as_mut() else { return Ok(()) };
        let Some(attempt) = active.take_attempt(run) else {
            return Ok(()); // the skill was halted meanwhile
        };
        match outcome {
            SkillOutcome::Succeeded(results) => {
                let Some(task) = active.sequencer.current_task().cloned() else { return Ok(()) };
                active.end_task(attempt.step, task, results, self.driver.next_goal());
                self.advance().await
            }
            SkillOutcome::Failed { cause, class, code } => {
                let is_able = self.driver.is_able();
                self.handle_failure(AttemptFailure::of_skill(cause, class, code, is_able)).await
            }
        }
    }

    /// Handles the failure of an actor: if it executed the current skill, the attempt has failed.
    pub(super) async fn skill_crashed(&mut self, actor: ActorId, problem: String) -> Result<(), ActorProcessingErr> {
        if self.crash_charging_task(actor, &problem) || self.crash_alarm_drive(actor, &problem) {
            return Ok(());
        }
        let attempt = self.execution.plan.as_mut().map(|active| &mut active.attempt);
        if attempt.and_then(|attempt| attempt.take_if(|attempt| attempt.skill.is_executed_by(actor))).is_none() {
            return Ok(());
        }
        self.driver.stop();
        let cause = format!("the skill crashed: {problem}");
        self.handle_failure(AttemptFailure::new(FailureKind::Crash, cause)).await
    }

    /// Handles a failure of the current task or of the whole plan.
    pub(super) async fn handle_failure(&mut self, failure: AttemptFailure) -> Result<(), ActorProcessingErr> {
        self.recover(failure);
        self.report();
        self.advance().await
    }

    fn recover(&mut self, failure: AttemptFailure) {
        let (now, delay) = (self.now(), self.settings.execution.retry_delay);
        let Some(active) = self.execution.plan.as_mut() else { return };
        let moved_nothing = self.driver.moved_nothing(active.first_goal());
        let effect = active.recover(AttemptFailure { moved_nothing, ..failure }, delay, now);
        self.update_permission();
        match effect {
            Some(RecoveryEffect::Retry(delay, event)) => {
                self.tasks.send_after(delay, &self.myself, RobotMessage::Tick);
                self.emit_event(event);
            }
            Some(RecoveryEffect::Release(event)) => self.emit_event(event),
            Some(RecoveryEffect::Alternative) | None => {}
        }
    }

    /// Checks the current task against its timeout, and the battery against the remaining plan.
    pub(super) async fn check_progress(&mut self, now: NodeTime) -> Result<(), ActorProcessingErr> {
        let (world, silent_for) = (self.driver.world_time(), self.driver.silent_for());
        let waits = self.waits_for_opening(now);
        let Some(active) = self.execution.plan.as_mut().filter(|active| active.attempt.is_some()) else {
            return Ok(());
        };
        if waits || self.driver.question().is_open() {
            active.restart_timer();
        }
        if let Some(failure) = active.check_timer(world, silent_for) {
            return self.handle_failure(failure).await;
        }
        if self.execution.is_pricing_due(now) {
            self.check_energy();
        }
        Ok(())
    }

    /// Checks whether the robot waits for a device of the building, or whether people or unavailable devices have closed
    /// every route of the current task: then it waits until a route is open.
    fn waits_for_opening(&self, now: NodeTime) -> bool {
        let devices = self.devices.as_ref();
        if devices.is_some_and(DeviceAccess::is_waiting) {
            return true;
        }
        let are_closed = devices.is_some_and(|devices| !devices.closed().is_empty());
        let active = self.execution.plan.as_ref().filter(|_| are_closed || !self.orders.closed(now).is_empty());
        let task = active.and_then(|active| active.sequencer.current_step()).map(|(.., task)| task);
        task.is_some_and(|task| {
            let (estimator, context) = (&self.settings.pricing.estimator, self.driver.estimate_context());
            is_closed_by_people(estimator, task, &context, self.driver.found_closed())
        })
    }

    /// Prices the remaining plan with the current charge. A robot that would strand releases the
    /// role while another robot can still take over.
    fn check_energy(&mut self) {
        let now = self.now();
        self.execution.set_priced(now);
        self.sense(now);
        let Some(active) = self.execution.continuing_plan().filter(|_| self.driver.telemetry().is_some()) else {
            return;
        };
        let PricingSettings { estimator, limits, .. } = &self.settings.pricing;
        let (rest, context) = (active.remaining_plan(), self.driver.estimate_context());
        let forecast = EnergyForecast::new(estimator, &rest, self.driver.worker(), &context, limits);
        let Some(cause) = forecast.ok().and_then(|forecast| forecast.shortfall()) else { return };
        match active.handle_shortfall(cause) {
            ShortfallEffect::Fail(failure) => {
                self.recover(failure);
                self.report();
            }
            ShortfallEffect::Continue(event) => event.into_iter().for_each(|event| self.emit_event(event)),
        }
    }

    /// Handles the end of a checkpoint write.
    pub(super) async fn handle_checkpoint_written(&mut self, result: io::Result<()>) -> Result<(), ActorProcessingErr> {
        match &result {
            Ok(()) => debug!(robot = %self.settings.robot, "checkpoint written"),
            Err(problem) => warn!(robot = %self.settings.robot, %problem, "checkpoint was not written"),
        }
        if let Some(failure) = self.checkpoint.finish_write(result, self.execution.plan.as_mut()) {
            self.recover(failure);
            self.report();
        }
        self.sense(self.now());
        self.advance().await
    }

    /// Receives the signals of another role.
    pub(super) async fn receive_signals(&mut self, received: &ReceivedSignals) -> Result<(), ActorProcessingErr> {
        let ReceivedSignals { history, author } = received;
        let active = self.execution.plan.as_mut().filter(|active| active.award.mission == history.mission);
        let Some(active) = active else { return Ok(()) };
        let (mut has_new, mut unconfirmed) = (false, false);
        for signal in history.signals.iter().filter(|signal| signal.to == active.award.role) {
            match active.sequencer.receive_signal(signal, history.epoch, author) {
                Ok(effect) => {
                    has_new |= effect == SignalEffect::Received;
                    unconfirmed |= effect == SignalEffect::AwaitsConfirmation;
                }
                Err(StaleSignal { current: known }) => {
                    let event = self.signals.record_stale(&mut active.stale_signals, history, signal, known);
                    event.into_iter().for_each(|event| self.settings.links.events.publish(event));
                }
            }
        }
        if unconfirmed {
            // The reply contains the present holders.
            self.report();
        }
        if has_new { self.advance().await } else { Ok(()) }
    }
}

fn task_timer(settings: &RobotSettings, spec: &TaskSpec, context: &EstimateContext) -> TaskTimer {
    let estimate = settings.pricing.estimator.estimate(spec, context);
    let estimate = estimate.ok().map(|estimate| estimate.time);
    TaskTimer::new(&settings.execution.task_timeout, spec, estimate)
}
