//! Drives: the length of the shortest route over the average speed, with delays on the route as far
//! as the environment describes them.

use super::estimate::{Estimate, EstimateContext, EstimateError, SkillDescriptor, parsed};
use crate::environment::{Environment, EnvironmentDescriptor, Passages, Routes};
use consort_protocol::ids::{PlaceId, TaskType};
use consort_protocol::mission::TaskSpec;

/// A drive to the place in parameter `to`.
#[derive(Debug, Clone)]
pub(super) struct NavigationDescriptor {
    task_type: TaskType,
}

impl NavigationDescriptor {
    /// Creates the descriptor of a task type.
    pub(super) fn new(task_type: TaskType) -> NavigationDescriptor {
        NavigationDescriptor { task_type }
    }
}

impl SkillDescriptor for NavigationDescriptor {
    fn task_type(&self) -> &TaskType {
        &self.task_type
    }

    fn required_descriptors(&self) -> Vec<&'static str> {
        vec![Routes::KIND]
    }

    fn estimate(
        &self,
        task: &TaskSpec,
        context: &EstimateContext,
        environment: &Environment,
    ) -> Result<Estimate, EstimateError> {
        let to = parsed(task, "to", str::parse::<PlaceId>)?;
        let routes = environment.get::<Routes>()?.without_closed(&context.closed);
        // Most maps have no doors, lifts or limits. For them a look-up in the table of lengths is
        // enough.
        let time = match (environment.find::<Passages>().filter(|passages| !passages.is_empty()), context.pose) {
            (None, Some(pose)) => routes.distance_left(&context.place, pose, &to)?.at(context.speed),
            (None, None) => routes.distance(&context.place, &to)?.at(context.speed),
            (Some(passages), pose) => {
                let pose = pose.or(routes.pose(&context.place)).unwrap_or_default();
                routes.time_left(&context.place, pose, &to, context.speed, passages)?
            }
        };
        Ok(Estimate::of_duration(time, context, to))
    }
}
