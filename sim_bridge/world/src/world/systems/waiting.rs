//! Waiting at standstill.

use crate::component_types;
use crate::world::sim_state::SimState;
use crate::world::system::System;
use crate::world::system_access::ComponentType;
use consort_skills::actions::{ActionError, ActionParameters as _, Goal, Wait};
use hecs::Entity;

/// See the [module](self).
pub(crate) struct Waiting;

impl System for Waiting {
    fn name(&self) -> &'static str {
        "waiting"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![]
    }

    fn writes(&self) -> Vec<ComponentType> {
        component_types![]
    }

    fn goal_kinds(&self) -> &'static [&'static str] {
        &[Wait::ACTION]
    }

    fn begin_goal(&self, state: &mut SimState, _robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        Some(goal.read()?.map(|Wait { time }| state.now + time.get()))
    }
}
