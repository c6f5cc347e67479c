//! Actions and readings that domain files declare. An action takes a random time, in which its feedback passes through
//! its values. At its end it fails, or returns random results, changes the readings of its robot, and moves, creates or
//! consumes an item. People do declared tasks in the same way, without feedback and without changes of readings and
//! items.

use crate::component_types;
use crate::world::components::{CoPresence, DepartureCount, DrawerOpen, PersonInfo, SampleLabel, SimRobot};
use crate::world::declared_moves::ItemChange;
use crate::world::goal_history::GoalHistory;
use crate::world::location::RobotLocation;
use crate::world::preconditions::action_error;
use crate::world::samples::{Custody, HandoverCount, PayloadData};
use crate::world::setup::{RobotSetup, WorldSetup};
use crate::world::sim_state::SimState;
use crate::world::system::System;
use crate::world::system_access::ComponentType;
use consort_protocol::ids::{ActionName, TaskType};
use consort_protocol::scalar::Scalar;
use consort_skills::actions::{ActionError, ErrorCode, Feedback, Goal, GoalResult};
use consort_skills::domain_file::{
    ActionForm, Addition, Distribution, ParameterForm, ReadingForm, SimulatedDuration, SimulatedEffect, SimulatedResult,
};
use hecs::Entity;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::json;
use std::collections::BTreeMap;

/// See the [module](self).
pub(crate) struct DeclaredActions;

/// The declared actions and readings, with the generator of durations, failures and values.
pub(crate) struct ActionModels {
    actions: BTreeMap<ActionName, ActionForm>,
    tasks: BTreeMap<TaskType, ActionForm>,
    readings: BTreeMap<String, ReadingForm>,
    chance: ChaCha8Rng,
}

impl ActionModels {
    /// Returns the action that a person plays for a task; `None` if no domain declares the task.
    pub(crate) fn of_task(&self, task: &TaskType) -> Option<&ActionForm> {
        self.tasks.get(task)
    }

    /// Returns a value in the type of a declared reading, and within its range.
    pub(crate) fn fit_reading(&self, name: &str, value: Scalar) -> Option<Scalar> {
        of_type(&self.readings.get(name)?.value, Some(value))
    }
}

/// Current readings of a robot, by name.
pub(crate) struct Readings(pub(crate) BTreeMap<String, Scalar>);

impl System for DeclaredActions {
    fn name(&self) -> &'static str {
        "declared_actions"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![CoPresence, SimRobot, DepartureCount, DrawerOpen, RobotLocation, PersonInfo, GoalHistory]
    }

    fn writes(&self) -> Vec<ComponentType> {
        component_types![ActionModels, Readings, Custody, HandoverCount, PayloadData, SampleLabel]
    }

    fn init_world(&self, state: &mut SimState, setup: &WorldSetup) {
        let chance = ChaCha8Rng::seed_from_u64(setup.seed ^ 0xac_7105);
        let (actions, tasks, readings) = (setup.actions.clone(), setup.tasks.clone(), setup.readings.clone());
        state.insert_resource(ActionModels { actions, tasks, readings, chance });
    }

    fn init_robot(&self, state: &mut SimState, robot: Entity, _body: &RobotSetup) {
        let readings = {
            let mut models = state.resource_mut::<ActionModels>();
            let ActionModels { readings, chance, .. } = &mut *models;
            let first =
                readings.iter().map(|(name, form)| (name, of_type(&form.value, draw(&form.simulated(), chance))));
            first.filter_map(|(name, value)| Some((name.clone(), value?))).collect()
        };
        state.insert(robot, Readings(readings));
    }

    fn begin_goal(&self, state: &mut SimState, robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        let now = state.now;
        let mut models = state.resource_mut::<ActionModels>();
        let action = models.actions.get(&goal.action)?;
        let duration = declared_duration(action)?;
        if let Err(error) = state.declared_move(robot, goal, action) {
            return Some(Err(error));
        }
        Some(Ok(now + draw_duration_s(duration, &mut models.chance)))
    }

    fn finish_goal(&self, state: &mut SimState, robot: Entity, goal: &Goal) -> Result<GoalResult, ActionError> {
        let (results, change) = state.end_declared_goal(robot, goal)?;
        if let Some(change) = change {
            state.change_item(change);
        }
        Ok(results)
    }

    fn feedback(&self, state: &SimState, robot: Entity, goal: &Goal, usual: Feedback) -> Feedback {
        let models = state.resource::<ActionModels>();
        let Some(action) = models.actions.get(&goal.action) else { return usual };
        let share = state.get::<GoalHistory>(robot).elapsed_share(state.now);
        let value = |(name, simulated): (&String, &SimulatedResult)| {
            let value = of_type(action.feedback.get(name)?, value_at(simulated, share))?;
            Some((name.clone(), value))
        };
        Feedback { values: action.simulate.feedback.iter().filter_map(value).collect(), ..usual }
    }
}

impl SimState {
    /// Draws the end of a goal and changes the readings of its robot. Returns the results, and what the goal does with an
    /// item.
    fn end_declared_goal(&self, robot: Entity, goal: &Goal) -> Result<(GoalResult, Option<ItemChange>), ActionError> {
        let mut models = self.resource_mut::<ActionModels>();
        let ActionModels { actions, readings, chance, .. } = &mut *models;
        let Some(action) = actions.get(&goal.action) else { return Ok((GoalResult::default(), None)) };
        let change = self.declared_move(robot, goal, action)?;
        let results = draw_end(action, chance, || format!("{} failed at {}", self.robot_id(robot), goal.action))?;
        let results = GoalResult(results.into_iter().map(|(name, value)| (name, json!(value))).collect());
        let current = &mut self.get_mut::<Readings>(robot).0;
        for (name, effect) in &action.simulate.effects {
            let Some(form) = readings.get(name) else { continue };
            let value = match effect {
                SimulatedEffect::Set(value) => draw(value, chance),
                SimulatedEffect::Add(Addition { add }) => {
                    current.get(name).and_then(number).map(|now| Scalar::Number(now + add))
                }
            };
            if let Some(value) = of_type(&form.value, value) {
                current.insert(name.clone(), value);
            }
        }
        Ok((results, change))
    }

    /// Returns a reading of a robot, if a domain declares it. No declaration of components is necessary.
    pub fn reading(&self, robot: Entity, name: &str) -> Option<Scalar> {
        self.peek::<Readings>(robot)?.0.get(name).cloned()
    }

    /// Sets a reading of a robot, in the type and within the range that its domain declares: a sensor. Returns
    /// false if no domain declares it, or if the value does not fit. No declaration of components is necessary.
    pub fn set_reading(&mut self, robot: Entity, name: &str, value: Scalar) -> bool {
        let Some(models) = self.peek::<ActionModels>(self.resource_entity()) else { return false };
        let Some(value) = models.fit_reading(name, value) else { return false };
        let Some(mut readings) = self.poke::<Readings>(robot) else { return false };
        readings.0.insert(name.to_owned(), value);
        true
    }
}

/// Returns the duration of an action; `None` if another system determines it.
pub(crate) fn declared_duration(action: &ActionForm) -> Option<SimulatedDuration> {
    action.simulate.system.is_none().then_some(action.simulate.duration_s)
}

/// Draws a duration in seconds.
pub(crate) fn draw_duration_s(duration: SimulatedDuration, chance: &mut ChaCha8Rng) -> f64 {
    match duration {
        SimulatedDuration::Range([least, greatest]) => chance.random_range(least..=greatest),
        SimulatedDuration::Distributed(distribution) => draw_number(&distribution, chance),
    }
}

fn draw_number(distribution: &Distribution, chance: &mut ChaCha8Rng) -> f64 {
    distribution.number([chance.random_range(0.0..1.0), chance.random_range(0.0..1.0)])
}

/// Draws the end of an action: its results, or a failure with this message.
pub(crate) fn draw_end(
    action: &ActionForm,
    chance: &mut ChaCha8Rng,
    failed: impl Fn() -> String,
) -> Result<BTreeMap<String, Scalar>, ActionError> {
    let declared = action.simulate.failures.iter().map(|(reason, share)| (Some(reason), *share));
    let mut drawn = chance.random_range(0.0..1.0);
    for (reason, share) in declared.chain([(None, action.simulate.failure_rate)]) {
        if drawn < share {
            let message = failed();
            let error = reason.and_then(|reason| action.failure(reason, &message));
            return Err(error.unwrap_or_else(|| action_error(ErrorCode::Failed, message)));
        }
        drawn -= share;
    }
    let result = |(name, simulated): (&String, &SimulatedResult)| {
        let value = of_type(action.results.get(name)?, draw(simulated, chance))?;
        Some((name.clone(), value))
    };
    Ok(action.simulate.results.iter().filter_map(result).collect())
}

/// Draws a value.
fn draw(simulated: &SimulatedResult, chance: &mut ChaCha8Rng) -> Option<Scalar> {
    match simulated {
        SimulatedResult::Range([least, greatest]) => Some(Scalar::Number(chance.random_range(*least..=*greatest))),
        SimulatedResult::OneOf(values) => values.choose(chance).cloned(),
        SimulatedResult::Value(value) => Some(value.clone()),
        SimulatedResult::Distributed(distribution) => Some(Scalar::Number(draw_number(distribution, chance))),
    }
}

/// Returns the value of a feedback after a share of the goal's time: a range and a list are passed through evenly.
fn value_at(simulated: &SimulatedResult, share: f64) -> Option<Scalar> {
    match simulated {
        SimulatedResult::Range([first, last]) => Some(Scalar::Number(first + share * (last - first))),
        SimulatedResult::OneOf(values) => {
            let passed = (share * values.len() as f64) as usize;
            values.get(passed.min(values.len().saturating_sub(1))).cloned()
        }
        SimulatedResult::Value(value) => Some(value.clone()),
        SimulatedResult::Distributed(_) => None, // the check of domains rejects it
    }
}

/// Returns a value in the type of a reading, a result or a feedback, and within its range.
fn of_type(form: &ParameterForm, drawn: Option<Scalar>) -> Option<Scalar> {
    let drawn = drawn?;
    number(&drawn).and_then(|number| form.nearest(number)).or_else(|| form.value_kind().accept(&drawn))
}

fn number(value: &Scalar) -> Option<f64> {
    match value {
        Scalar::Number(number) => Some(*number),
        Scalar::Integer(number) => Some(*number as f64),
        Scalar::Bool(_) | Scalar::Text(_) => None,
    }
}
