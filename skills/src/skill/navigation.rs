//! `navigation`: to the place in parameter `to`, leg by leg along the shortest route from wherever the body is.
//!
//! A drive that was halted between two places resumes from there: the route is planned afresh at each start.

use super::{GoalLeaf, Shipped, TaskContext};
use crate::actions::Goal;
use crate::bt::{
    Cause, Leaf, LeafContext, Manifest, NodeKind, PortSpec, PortType, Registry, RegistryError, Status, Value,
};
use crate::environment::{Environment, Routes};
use consort_protocol::ids::PlaceId;

pub(super) const SKILL: Shipped =
    Shipped { task_type: "navigation", xml: include_str!("../../trees/navigation.xml"), leaves };

fn leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    let ports = [PortSpec::input("to", PortType::Place), PortSpec::output("legs", PortType::List)];
    registry.register(Manifest::new("PlanRoute", NodeKind::Action, ports), |context: &TaskContext| {
        Box::new(PlanRoute { environment: context.environment.clone() })
    })?;
    let ports = [PortSpec::input("place", PortType::Place)];
    GoalLeaf::register(registry, "NavigateToPose", ports, |context: &TaskContext, leaf| {
        let place: PlaceId = leaf.read("place")?;
        let pose = routes(&context.environment)?.pose(&place);
        let pose = pose.ok_or_else(|| Cause::new(format!("{place} is not on the map")))?;
        Ok(Goal::NavigateToPose { pose, place: Some(place) })
    })
}

fn routes(environment: &Environment) -> Result<&Routes, Cause> {
    environment.get::<Routes>().map_err(|error| Cause::new(error.to_string()))
}

/// Writes the places still to drive to; none where the body is there already. Waits for the body's first report, and
/// for the body to stand still.
struct PlanRoute {
    environment: Environment,
}

impl Leaf for PlanRoute {
    fn tick(&mut self, context: &mut LeafContext<'_, '_>) -> Result<Status, Cause> {
        if !context.is_settled() {
            return Ok(Status::Running);
        }
        let to: PlaceId = context.read("to")?;
        let Some(telemetry) = context.actions().telemetry() else { return Ok(Status::Running) };
        let (place, pose) = (telemetry.place.clone(), telemetry.pose);
        let legs = routes(&self.environment)?.legs(&place, pose, &to);
        let legs = legs.map_err(|error| Cause::new(error.to_string()))?;
        context.write("legs", legs.into_iter().map(Value::Place).collect::<Vec<_>>())?;
        Ok(Status::Success)
    }

    fn halt(&mut self, _: &mut LeafContext<'_, '_>) {}
}
