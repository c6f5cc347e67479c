//! Paths over points: their length over the average speed.

use super::estimate::{Estimate, EstimateContext, EstimateError, SkillDescriptor, parsed};
use crate::environment::{Environment, EnvironmentDescriptor, Routes};
use crate::waypoints::parse_points;
use consort_protocol::ids::TaskType;
use consort_protocol::mission::TaskSpec;
use consort_protocol::pose::Pose;
use consort_protocol::units::Metres;

/// A drive over the points in parameter `waypoints`, in straight lines from the robot's position.
#[derive(Debug, Clone)]
pub(super) struct PathDescriptor {
    task_type: TaskType,
}

impl PathDescriptor {
    /// Creates the descriptor of a task type.
    pub(super) fn new(task_type: TaskType) -> PathDescriptor {
        PathDescriptor { task_type }
    }
}

impl SkillDescriptor for PathDescriptor {
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
        let points = parsed(task, "waypoints", |text| parse_points(text.split(';')))?;
        let routes = environment.get::<Routes>()?;
        let start = context.pose.or(routes.pose(&context.place));
        let poses = start.into_iter().chain(points.into_iter().map(|(x, y)| Pose::new(x, y, 0.0)));
        let poses: Vec<Pose> = poses.collect();
        let length = poses.windows(2).fold(Metres::ZERO, |length, leg| length + leg[0].distance(leg[1]));
        // The robot is then off the lanes, and has to return to the place where it left them.
        Ok(Estimate::of_duration(length.at(context.speed), context, context.place.clone()))
    }
}
