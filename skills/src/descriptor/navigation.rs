//! Drives: the length of the shortest route over the average speed.

use super::{Context, Estimate, EstimateError, SkillDescriptor, parsed};
use crate::environment::{Environment, EnvironmentDescriptor, Routes};
use consort_protocol::ids::{PlaceId, TaskType};
use consort_protocol::mission::TaskSpec;

/// A drive to the place in parameter `to`.
#[derive(Debug, Clone)]
pub struct Navigation {
    task_type: TaskType,
}

impl Navigation {
    /// Tasks of this type are drives.
    pub fn new(task_type: TaskType) -> Navigation {
        Navigation { task_type }
    }
}

impl SkillDescriptor for Navigation {
    fn task_type(&self) -> &TaskType {
        &self.task_type
    }

    fn needs(&self) -> Vec<&'static str> {
        vec![Routes::KIND]
    }

    fn estimate(
        &self,
        task: &TaskSpec,
        context: &Context,
        environment: &Environment,
    ) -> Result<Estimate, EstimateError> {
        let to = parsed(task, "to", str::parse::<PlaceId>)?;
        let routes = environment.get::<Routes>()?.without(&context.closed);
        let length = match context.pose {
            Some(pose) => routes.distance_left(&context.place, pose, &to)?,
            None => routes.distance(&context.place, &to)?,
        };
        Ok(Estimate::lasting(length.at(context.speed), context, to))
    }
}
