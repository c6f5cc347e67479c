//! Carrying a plan out: the next step, skills, setbacks and signals.

use super::actor::{RobotMessage, RobotState};
use super::forecast::{Forecast, context};
use super::job::Attempt;
use super::ladder::{Rung, Setback};
use super::patience::Stopwatch;
use super::pen::Telling;
use super::sequencer::{Move, Outdated, Spot};
use super::settings::RobotSettings;
use super::skill_runner::{Run, SkillOutcome, SkillRunner};
use super::surrender::Surrender;
use consort_protocol::event::Happening;
use consort_protocol::ids::TaskId;
use consort_protocol::message::{FailureKind, Said, TaskFailure};
use consort_protocol::mission::TaskSpec;
use consort_protocol::units::NodeTime;
use consort_skills::actions::RobotActions;
use consort_skills::descriptor::Context;
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
            if !self.tenure.may_act(now) {
                break;
            }
            let Some(job) = self.job.as_mut() else { break };
            let written = job.pen.take_written();
            if !written.is_empty() {
                moved = true;
                self.speak(written).await;
                continue;
            }
            if job.surrender.is_some() || !job.pen.is_idle() || now < job.rests_until {
                break;
            }
            let Some(next) = job.sequencer.next_move() else { break };
            match next {
                Move::Perform { spot, task, spec } => {
                    moved = true;
                    self.begin_task(myself, spot, &task, &spec).await?;
                }
                Move::Tell(signal) => job.pen.note(Telling::Signal(signal)),
                Move::Heard(signal) => {
                    moved = true;
                    let mission = job.award.mission.clone();
                    self.tell(Happening::Heard { mission, signal });
                }
            }
        }
        self.write_down(myself);
        if moved {
            self.report(myself);
        }
        Ok(())
    }

    /// Tells what has been written down.
    pub(super) async fn speak(&mut self, written: Vec<Telling>) {
        let Some(mission) = self.job.as_ref().map(|job| job.award.mission.clone()) else { return };
        for telling in written {
            match telling {
                Telling::Event(what) => self.tell(what),
                Telling::Signal(signal) => {
                    self.talk.say(&mission, &signal).await;
                    self.tell(Happening::Sent { mission: mission.clone(), signal });
                }
            }
        }
    }

    async fn begin_task(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        spot: Spot,
        task: &TaskId,
        spec: &TaskSpec,
    ) -> Result<(), ActorProcessingErr> {
        self.look_after_charge(myself);
        let here = Context { pose: Some(self.worker.pose), ..context(&self.worker, self.closed()) };
        let Some(job) = self.job.as_mut().filter(|job| job.surrender.is_none()) else { return Ok(()) };
        let (mission, role) = job.of();
        self.settings.events.tell(Happening::TaskBegan { mission, role, task: task.clone() });
        self.runs += 1;
        let run = self.runs;
        let skill_context = SkillContext { holders: job.sequencer.robots() };
        let to = myself.clone();
        let ended = move |outcome| {
            // A robot that has stopped needs no outcome.
            let _ = to.cast(RobotMessage::SkillEnded { run, outcome });
        };
        match self.settings.library.load(spec, &skill_context) {
            Ok(skill) => {
                self.settings.body.begin_attempt(job.first_goal);
                let (body, period) = (self.settings.body.clone(), self.settings.tick);
                let run_it = Run { skill, body, period, done: Box::new(ended) };
                let (runner, _) = Actor::spawn_linked(None, SkillRunner, run_it, myself.get_cell()).await?;
                let estimate = self.settings.estimator.estimate(spec, &here).ok().map(|estimate| estimate.time);
                let watch = Stopwatch::new(&self.settings.patience, spec, estimate);
                job.attempt = Some(Attempt { run, spot, runner, watch });
            }
            Err(problem) => {
                let (kind, cause) = (FailureKind::Task, problem.to_string());
                self.fall_back(myself, Setback { kind, cause, lasting: true });
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
        let Some(job) = self.job.as_mut() else { return Ok(()) };
        let Some(attempt) = job.attempt.take_if(|attempt| attempt.run == run) else {
            return Ok(()); // one that was halted meanwhile
        };
        match outcome {
            SkillOutcome::Succeeded => {
                let Some(task) = job.sequencer.at().cloned() else { return Ok(()) };
                let (mission, role) = job.of();
                job.sequencer.end(attempt.spot);
                job.first_goal = self.settings.body.next_goal();
                job.pen.note(Telling::Event(Happening::TaskEnded { mission, role, task }));
                self.advance(myself).await
            }
            SkillOutcome::Failed(cause) => {
                self.settings.body.refresh();
                let stranded = self.settings.body.telemetry().is_some_and(|report| !report.able);
                let kind = if stranded { FailureKind::Battery } else { FailureKind::Task };
                self.set_back(myself, Setback { kind, cause, lasting: false }).await
            }
        }
    }

    /// The task under way, or the whole plan, has met with a setback: the ladder says what follows.
    pub(super) async fn set_back(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        setback: Setback,
    ) -> Result<(), ActorProcessingErr> {
        self.fall_back(myself, setback);
        self.report(myself);
        self.advance(myself).await
    }

    pub(super) fn fall_back(&mut self, myself: &ActorRef<RobotMessage>, setback: Setback) {
        let now = self.settings.clock.now();
        let Some(job) = self.job.as_mut().filter(|job| job.surrender.is_none()) else { return };
        job.stop();
        let ((mission, role), task) = (job.of(), job.sequencer.at().cloned());
        let cause = setback.cause.clone();
        warn!(robot = %self.settings.robot, %mission, ?task, ?setback, "met with a setback");
        match (job.ladder.climb(setback, &mut job.sequencer), task) {
            (Rung::GiveUp(failure), _) => self.give_up(failure),
            (Rung::Again { attempt }, Some(task)) => {
                job.rests_until = now + self.settings.pause;
                self.tasks.after(self.settings.pause, myself, RobotMessage::Beat);
                self.tell(Happening::TaskRetried { mission, role, task, attempt, cause });
            }
            (Rung::Aside { alternative }, Some(task)) => {
                let tasks = job.sequencer.tasks_of(alternative);
                let what = Happening::Alternative { mission, role, task, alternative, tasks, cause };
                job.pen.note(Telling::Event(what));
            }
            // Only a task under way is tried again or done otherwise.
            (Rung::Again { .. } | Rung::Aside { .. }, None) => {}
        }
    }

    /// From now on the robot only waits for the coordinator to take the role from it.
    pub(super) fn give_up(&mut self, failure: TaskFailure) {
        let now = self.settings.clock.now();
        let Some(job) = self.job.as_mut() else { return };
        let ((mission, role), TaskFailure { task, cause, kind }) = (job.of(), failure.clone());
        job.surrender = Some(Surrender::new(failure, now));
        match (kind, task) {
            (FailureKind::Task | FailureKind::Crash | FailureKind::NoProgress, Some(task)) => {
                self.tell(Happening::TaskFailed { mission, role, task, cause });
            }
            _ => self.tell(Happening::GaveUp { mission, role, kind, cause }),
        }
    }

    /// Looks whether the task under way takes too long, and whether the battery lasts.
    pub(super) async fn look_after_work(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        now: NodeTime,
    ) -> Result<(), ActorProcessingErr> {
        let silent_for = self.settings.body.silent_for();
        let world = self.settings.body.telemetry().map(|report| report.time);
        let Some(attempt) = self.job.as_mut().and_then(|job| job.attempt.as_mut()) else { return Ok(()) };
        if let Some(cause) = attempt.watch.check(world, silent_for) {
            let kind = FailureKind::NoProgress;
            return self.set_back(myself, Setback { kind, cause, lasting: false }).await;
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
        self.sense(now);
        let Some(job) = self.job.as_mut().filter(|job| job.surrender.is_none()) else { return };
        if self.settings.body.telemetry().is_none() {
            return;
        }
        let RobotSettings { estimator, limits, .. } = &self.settings;
        let closed = self.settings.body.telemetry().map_or(&[][..], |report| &report.closed);
        let forecast = Forecast::new(estimator, &job.sequencer.rest(), &self.worker, closed, limits);
        let Some(cause) = forecast.ok().and_then(|forecast| forecast.shortfall()) else { return };
        if job.sequencer.may_have_custody() {
            if !std::mem::replace(&mut job.told_of_charge, true) {
                let (mission, role) = job.of();
                self.tell(Happening::ChargeShort { mission, role, cause });
            }
            return;
        }
        self.fall_back(myself, Setback { kind: FailureKind::Battery, cause, lasting: true });
        self.report(myself);
    }

    pub(super) async fn hear(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        said: &Said,
    ) -> Result<(), ActorProcessingErr> {
        let Some(job) = self.job.as_mut().filter(|job| job.award.mission == said.mission) else { return Ok(()) };
        let mut news = false;
        for signal in said.signals.iter().filter(|signal| signal.to == job.award.role) {
            match job.sequencer.hear(signal, said.epoch) {
                Ok(new) => news |= new,
                Err(Outdated { known }) => {
                    let told = self.talk.note_outdated(&mut job.outdated, said, signal, known);
                    told.into_iter().for_each(|what| self.settings.events.tell(what));
                }
            }
        }
        if news { self.advance(myself).await } else { Ok(()) }
    }

    /// Every now and then, asks those from whom a signal is awaited: it may have been lost.
    pub(super) fn ask_around(&mut self, myself: &ActorRef<RobotMessage>, now: NodeTime) {
        if now.since(self.asked_at) >= Duration::from_secs(1) {
            self.asked_at = now;
            self.ask(myself);
        }
    }

    pub(super) fn ask(&mut self, myself: &ActorRef<RobotMessage>) {
        let Some(job) = &self.job else { return };
        let to = myself.clone();
        self.talk.ask(&job.award.mission, &job.sequencer.awaiting(), &mut self.tasks, move |said| {
            // A robot that has stopped needs no answer.
            let _ = to.cast(RobotMessage::Said(said));
        });
    }
}
