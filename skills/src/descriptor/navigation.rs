//! Driving to a place: the shortest way at the robot's average speed.

use super::{Context, Estimate, EstimateError, SkillDescriptor};
use crate::environment::{Environment, EnvironmentKind};
use consort_protocol::ids::{PlaceId, TaskType};
use consort_protocol::mission::TaskSpec;

/// Prices `navigation` to the place in parameter `to`.
#[derive(Debug, Clone, Default)]
pub struct Navigation;

impl SkillDescriptor for Navigation {
    fn task_type(&self) -> TaskType {
        TaskType::new("navigation").expect("a slug")
    }

    fn needs(&self) -> &[EnvironmentKind] {
        &[EnvironmentKind::Routes]
    }

    fn estimate(
        &self,
        task: &TaskSpec,
        context: &Context,
        environment: &Environment,
    ) -> Result<Estimate, EstimateError> {
        let to = task.parameters.get("to").ok_or(EstimateError::Missing { parameter: "to" })?;
        let to = PlaceId::new(to.as_str())
            .map_err(|problem| EstimateError::Parameter { parameter: "to", problem: problem.to_string() })?;
        let routes = environment.routes().expect("a navigation descriptor is resolved with routes");
        let time = routes.length(&context.place, &to)?.at(context.speed);
        Ok(Estimate { time, energy: context.discharge.over(time), place: to })
    }
}
