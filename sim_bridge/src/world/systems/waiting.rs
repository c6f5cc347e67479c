//! Standing still for a while.

use crate::world::floor::Floor;
use crate::world::system::{Kind, System, kinds};
use consort_skills::actions::{ActionError, Goal};
use hecs::Entity;

/// See the [module](self).
pub(crate) struct Waiting;

impl System for Waiting {
    fn name(&self) -> &'static str {
        "waiting"
    }

    fn reads(&self) -> Vec<Kind> {
        kinds![]
    }

    fn writes(&self) -> Vec<Kind> {
        kinds![]
    }

    fn begin(&self, floor: &mut Floor, _robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        let Goal::Wait { time } = goal else { return None };
        Some(Ok(floor.now + time.get()))
    }
}
