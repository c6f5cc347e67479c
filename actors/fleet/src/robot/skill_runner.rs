//! Execution of a single skill: an actor ticks the behavior tree until it ends. A panic in the
//! skill ends only this actor.

use crate::robot_driver::RobotDriver;
use consort_bus::tasks::{Forwarded, Tasks};
use consort_protocol::cause::CauseClass;
use consort_protocol::scalar::Scalar;
use consort_skills::actions::ErrorCode;
use consort_skills::library::{ActiveSkill, SkillStatus};
use ractor::{Actor, ActorCell, ActorId, ActorProcessingErr, ActorRef, SpawnErr};
use std::collections::BTreeMap;
use std::time::Duration;

/// Outcome of a skill.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum SkillOutcome {
    /// The skill has reached its goal, with the results of the task.
    Succeeded(BTreeMap<String, Scalar>),
    /// The skill has failed.
    Failed {
        /// Cause, as text.
        cause: String,
        /// Class of the cause.
        class: CauseClass,
        /// Code of the failed goal, if a goal is the cause.
        code: Option<ErrorCode>,
    },
}

/// Message for a skill runner.
pub(super) enum RunnerMessage {
    /// Tick the tree, periodically or since the driver has sent a state.
    Tick(Option<Forwarded<()>>),
    /// Stop the robot safely, and end.
    Halt,
}

/// Arguments of a skill runner.
pub(super) struct SkillRun {
    /// Number of the skill run.
    pub(super) run: u64,
    pub(super) skill: ActiveSkill,
    pub(super) driver: RobotDriver,
    /// Tick interval while the driver sends no state (thesis: 100 ms).
    pub(super) period: Duration,
    /// Called once, when the skill has ended by itself.
    pub(super) on_end: Box<dyn FnOnce(SkillOutcome) + Send + Sync>,
}

/// Handle of a running skill.
pub(super) struct RunningSkill {
    run: u64,
    runner: ActorRef<RunnerMessage>,
}

impl RunningSkill {
    /// Starts a skill under a supervisor.
    ///
    /// # Errors
    /// The supervisor has ended.
    pub(super) async fn start(skill: SkillRun, supervisor: ActorCell) -> Result<RunningSkill, SpawnErr> {
        let run = skill.run;
        let (runner, _) = Actor::spawn_linked(None, SkillRunner, skill, supervisor).await?;
        Ok(RunningSkill { run, runner })
    }

    /// Returns the number of the skill run.
    pub(super) fn run(&self) -> u64 {
        self.run
    }

    /// Checks whether this actor executes the skill.
    pub(super) fn is_executed_by(&self, actor: ActorId) -> bool {
        self.runner.get_id() == actor
    }

    /// Stops the robot safely and ends the skill.
    pub(super) fn halt(&self) {
        // A skill that has just ended ignores this.
        let _ = self.runner.cast(RunnerMessage::Halt);
    }
}

/// The skill runner actor.
struct SkillRunner;

/// State of [`SkillRunner`].
struct RunnerState {
    started: bool,
    skill: ActiveSkill,
    driver: RobotDriver,
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
        tasks.on_change(run.driver.changes(), &myself, |changed| RunnerMessage::Tick(Some(changed)));
        tasks.send_every(run.period, &myself, || RunnerMessage::Tick(None));
        myself.cast(RunnerMessage::Tick(None))?;
        Ok(RunnerState { started: false, skill: run.skill, driver: run.driver, done: Some(run.on_end), _tasks: tasks })
    }

    async fn handle(
        &self,
        myself: ActorRef<Self::Msg>,
        message: Self::Msg,
        state: &mut Self::State,
    ) -> Result<(), ActorProcessingErr> {
        state.driver.refresh();
        state.started |= state.driver.is_idle();
        let outcome = match message {
            // A goal of an earlier attempt, perhaps of a previous incarnation, must end first: the
            // driver executes a single goal at a time.
            RunnerMessage::Tick(_) if !state.started => return Ok(()),
            RunnerMessage::Tick(changed) => {
                drop(changed); // later states are a message of their own
                match state.skill.tick(&mut state.driver) {
                    SkillStatus::Running => return Ok(()),
                    SkillStatus::Succeeded(results) => Some(SkillOutcome::Succeeded(results)),
                    SkillStatus::Failed { cause, class } => {
                        Some(SkillOutcome::Failed { cause, class, code: state.skill.failure_code() })
                    }
                }
            }
            RunnerMessage::Halt => {
                state.skill.halt(&mut state.driver);
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
