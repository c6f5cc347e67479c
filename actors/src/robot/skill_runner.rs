//! Runs one skill: an actor that ticks its tree until it ends, so that a panic in a skill ends this actor alone.

use crate::robot_driver::RobotDriver;
use crate::tasks::Tasks;
use consort_skills::library::{ActiveSkill, SkillStatus};
use ractor::{Actor, ActorProcessingErr, ActorRef};
use std::time::Duration;

/// How a skill ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SkillOutcome {
    /// As asked.
    Succeeded,
    /// For good, and why.
    Failed(String),
}

/// To a runner.
pub(super) enum RunnerMessage {
    /// Pass control to the tree.
    Tick,
    /// Stop the body safely, and end.
    Halt,
}

/// What a runner runs.
pub(super) struct SkillRun {
    pub(super) skill: ActiveSkill,
    pub(super) driver: RobotDriver,
    /// How often the tree is ticked while nothing is heard from the body (thesis: 100 ms).
    pub(super) period: Duration,
    /// Told once, when the skill has ended by itself.
    pub(super) on_end: Box<dyn FnOnce(SkillOutcome) + Send + Sync>,
}

/// The actor.
pub(super) struct SkillRunner;

/// State of [`SkillRunner`].
pub(super) struct RunnerState {
    begun: bool,
    skill: ActiveSkill,
    body: RobotDriver,
    done: Option<Box<dyn FnOnce(SkillOutcome) + Send + Sync>>,
    _tasks: Tasks,
}

#[ractor::async_trait]
impl Actor for SkillRunner {
    type Msg = RunnerMessage;
    type State = RunnerState;
    type Arguments = SkillRun;

    async fn pre_start(&self, myself: ActorRef<Self::Msg>, run: SkillRun) -> Result<Self::State, ActorProcessingErr> {
        let mut tasks = Tasks::default();
        tasks.on_change(run.driver.changes(), &myself, || RunnerMessage::Tick);
        tasks.send_every(run.period, &myself, || RunnerMessage::Tick);
        myself.cast(RunnerMessage::Tick)?;
        Ok(RunnerState { begun: false, skill: run.skill, body: run.driver, done: Some(run.on_end), _tasks: tasks })
    }

    async fn handle(
        &self,
        myself: ActorRef<Self::Msg>,
        message: Self::Msg,
        state: &mut Self::State,
    ) -> Result<(), ActorProcessingErr> {
        state.body.refresh();
        state.begun |= state.body.is_idle();
        let outcome = match message {
            // What was under way before, perhaps in another life of this node, has to come to rest first: the body does one
            // thing at a time.
            RunnerMessage::Tick if !state.begun => return Ok(()),
            RunnerMessage::Tick => match state.skill.tick(&mut state.body) {
                SkillStatus::Running => return Ok(()),
                SkillStatus::Succeeded => Some(SkillOutcome::Succeeded),
                SkillStatus::Failed { cause } => Some(SkillOutcome::Failed(cause)),
            },
            RunnerMessage::Halt => {
                state.skill.halt(&mut state.body);
                None
            }
        };
        if let (Some(outcome), Some(done)) = (outcome, state.done.take()) {
            done(outcome);
        }
        state.done = None;
        myself.stop(None);
        Ok(())
    }
}
