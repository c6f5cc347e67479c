//! Actions that domain files declare: each takes a random time, and at its end fails, or returns random
//! results.

use crate::world::components::SimRobot;
use crate::world::preconditions::action_error;
use crate::world::setup::WorldSetup;
use crate::world::sim_state::SimState;
use crate::world::system::System;
use crate::world::system_access::{ComponentType, component_types};
use consort_protocol::ids::ActionName;
use consort_skills::actions::{ActionError, ErrorCode, Goal, GoalResult};
use consort_skills::domain_file::{SimulatedAction, SimulatedResult};
use hecs::Entity;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use std::collections::BTreeMap;

/// See the [module](self).
pub(crate) struct DeclaredActions;

/// The declared actions, with the generator of durations and failures.
pub(crate) struct ActionModels {
    actions: BTreeMap<ActionName, SimulatedAction>,
    chance: ChaCha8Rng,
}

impl System for DeclaredActions {
    fn name(&self) -> &'static str {
        "declared_actions"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![SimRobot]
    }

    fn writes(&self) -> Vec<ComponentType> {
        component_types![ActionModels]
    }

    fn init_world(&self, state: &mut SimState, setup: &WorldSetup) {
        let chance = ChaCha8Rng::seed_from_u64(setup.seed ^ 0xac_7105);
        state.insert_resource(ActionModels { actions: setup.actions.clone(), chance });
    }

    fn begin_goal(&self, state: &mut SimState, _robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        let Goal::Declared(goal) = goal else { return None };
        let now = state.now;
        let mut models = state.resource_mut::<ActionModels>();
        let (least, greatest) = models.actions.get(&goal.action)?.duration_s;
        Some(Ok(now + models.chance.random_range(least..=greatest)))
    }

    fn finish_goal(&self, state: &mut SimState, robot: Entity, goal: &Goal) -> Result<GoalResult, ActionError> {
        let Goal::Declared(goal) = goal else { return Ok(GoalResult::default()) };
        let mut models = state.resource_mut::<ActionModels>();
        let ActionModels { actions, chance } = &mut *models;
        let Some(action) = actions.get(&goal.action) else { return Ok(GoalResult::default()) };
        if chance.random_bool(action.failure_rate) {
            let problem = format!("{} failed at {}", state.robot_id(robot), goal.action);
            return Err(action_error(ErrorCode::Failed, problem));
        }
        let results = action.results.iter().map(|(name, result)| (name.clone(), draw(result, chance)));
        Ok(GoalResult(results.collect()))
    }
}

/// Draws a result.
fn draw(result: &SimulatedResult, chance: &mut ChaCha8Rng) -> Value {
    let value = match result {
        SimulatedResult::Range([least, greatest]) => return chance.random_range(*least..=*greatest).into(),
        SimulatedResult::OneOf(values) => values.choose(chance),
        SimulatedResult::Value(value) => Some(value),
    };
    serde_json::to_value(value).expect("a value serializes to JSON")
}
