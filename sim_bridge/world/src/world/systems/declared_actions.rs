//! Actions that domain files declare: each takes a random time, and may fail at its end.

use crate::world::components::SimRobot;
use crate::world::preconditions::action_error;
use crate::world::setup::WorldSetup;
use crate::world::sim_state::SimState;
use crate::world::system::System;
use crate::world::system_access::{ComponentType, component_types};
use consort_protocol::ids::ActionName;
use consort_skills::actions::{ActionError, ErrorCode, Goal};
use consort_skills::domain_file::SimulatedAction;
use hecs::Entity;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
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

    fn finish_goal(&self, state: &mut SimState, robot: Entity, goal: &Goal) -> Result<(), ActionError> {
        let Goal::Declared(goal) = goal else { return Ok(()) };
        let fails = {
            let mut models = state.resource_mut::<ActionModels>();
            let rate = models.actions.get(&goal.action).map_or(0.0, |action| action.failure_rate);
            models.chance.random_bool(rate)
        };
        match fails {
            true => {
                Err(action_error(ErrorCode::Failed, format!("{} failed at {}", state.robot_id(robot), goal.action)))
            }
            false => Ok(()),
        }
    }
}
