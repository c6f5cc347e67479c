//! Leaves that drive to a place, leg by leg along the shortest route from the robot's position.
//!
//! The route is planned at each start, so a drive that was halted between two places resumes from
//! there. If a leg is blocked, the route is planned again without the lanes that the robot has
//! found closed. Without another route the drive fails with the robot's own message.

use super::context::TaskContext;
use crate::actions::{self, ActionError, ErrorCode, GoalId, GoalStatus};
use crate::bt::{
    Cause, Leaf, LeafContext, NodeKind, NodeManifest, NodeStatus, PortSpec, PortType, Registry, RegistryError, Value,
};
use crate::environment::{Environment, Routes};
use consort_protocol::ids::PlaceId;
use std::collections::VecDeque;

pub(super) fn register_leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    let ports = [PortSpec::input("to", PortType::Place), PortSpec::output("legs", PortType::List)];
    registry.register(NodeManifest::new("PlanRoute", NodeKind::Action, ports), |context: &TaskContext| {
        Box::new(PlanRoute { environment: context.environment.clone() })
    })?;
    let ports = [PortSpec::input("place", PortType::Place), PortSpec::input("to", PortType::Place).optional()];
    registry.register(NodeManifest::new("NavigateToPose", NodeKind::Action, ports), |context: &TaskContext| {
        Box::new(NavigateToPose { environment: context.environment.clone(), drive: None, detour: VecDeque::new() })
    })
}

fn routes(environment: &Environment) -> Result<&Routes, Cause> {
    environment.get::<Routes>().map_err(|error| Cause::new(error.to_string()))
}

/// Returns the remaining places of the route, without the lanes that the robot has found closed;
/// `None` before the robot's first report.
fn legs(
    environment: &Environment,
    context: &mut LeafContext<'_, '_>,
    to: &PlaceId,
) -> Result<Option<Vec<PlaceId>>, Cause> {
    let Some(telemetry) = context.actions().telemetry() else { return Ok(None) };
    let legs = routes(environment)?.without_closed(&telemetry.closed).legs(&telemetry.place, telemetry.pose, to);
    legs.map(Some).map_err(|error| Cause::new(error.to_string()))
}

/// Writes the remaining places of the route; an empty list at the destination. Waits for the
/// robot's first report, and for the robot to stand still.
struct PlanRoute {
    environment: Environment,
}

impl Leaf for PlanRoute {
    fn tick(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        if !context.cancels_complete() {
            return Ok(NodeStatus::Running);
        }
        let to: PlaceId = context.read("to")?;
        let Some(legs) = legs(&self.environment, context, &to)? else { return Ok(NodeStatus::Running) };
        context.write("legs", legs.into_iter().map(Value::Place).collect::<Vec<_>>())?;
        Ok(NodeStatus::Success)
    }

    fn halt(&mut self, _: &mut LeafContext<'_, '_>) {}
}

/// Drives to `place`, a leg of the route to `to`. If the leg is blocked, and the robot has found a
/// closed lane since the start of the leg, the leaf drives a detour all the way to `to`. The
/// remaining legs then have nothing left to do. Without `to` there is no detour.
struct NavigateToPose {
    environment: Environment,
    drive: Option<Drive>,
    /// Remaining legs of a detour.
    detour: VecDeque<PlaceId>,
}

struct Drive {
    goal: GoalId,
    /// Closed lanes that the robot reported at the start of the leg.
    known_closed: Vec<(PlaceId, PlaceId)>,
    /// Error of a blocked leg, while the robot's next report may still add a closed lane.
    blocked: Option<ActionError>,
}

impl NavigateToPose {
    fn start_leg(&mut self, context: &mut LeafContext<'_, '_>, place: PlaceId) -> Result<NodeStatus, Cause> {
        let pose = routes(&self.environment)?.pose(&place);
        let pose = pose.ok_or_else(|| Cause::new(format!("{place} is not on the map")))?;
        let known_closed = closed(context);
        let goal = context.actions().send_goal(actions::NavigateToPose { pose, place: Some(place) }.into());
        self.drive = Some(Drive { goal, known_closed, blocked: None });
        self.follow(context)
    }

    fn follow(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        let Some(mut drive) = self.drive.take() else { return Ok(NodeStatus::Running) };
        if let Some(error) = drive.blocked {
            return self.take_detour(context, &drive.known_closed, error);
        }
        match context.actions().status(drive.goal) {
            Some(GoalStatus::Sent | GoalStatus::Executing(_)) => {
                self.drive = Some(drive);
                Ok(NodeStatus::Running)
            }
            Some(GoalStatus::Succeeded(_)) => match self.detour.pop_front() {
                Some(next) => self.start_leg(context, next),
                None => Ok(NodeStatus::Success),
            },
            Some(GoalStatus::Aborted(error)) if error.code == ErrorCode::Blocked => {
                if closed(context).iter().any(|lane| !drive.known_closed.contains(lane)) {
                    return self.take_detour(context, &drive.known_closed, error);
                }
                // The obstacle may appear only in the next report.
                drive.blocked = Some(error);
                self.drive = Some(drive);
                Ok(NodeStatus::Running)
            }
            Some(GoalStatus::Aborted(error)) => self.fail(Cause::from(error)),
            Some(GoalStatus::Canceled) => self.fail(Cause::new("it was canceled from outside")),
            None => self.fail(Cause::new(format!("the robot no longer reports goal {}", drive.goal.0))),
        }
    }

    fn take_detour(
        &mut self,
        context: &mut LeafContext<'_, '_>,
        known_closed: &[(PlaceId, PlaceId)],
        error: ActionError,
    ) -> Result<NodeStatus, Cause> {
        let has_new_closure = closed(context).iter().any(|lane| !known_closed.contains(lane));
        let to: Option<PlaceId> = context.read_optional("to")?;
        let Some(to) = to.filter(|_| has_new_closure) else { return self.fail(Cause::from(error)) };
        match legs(&self.environment, context, &to) {
            Ok(Some(detour_legs)) => self.detour = detour_legs.into(),
            Ok(None) | Err(_) => return self.fail(Cause::from(error)),
        }
        match self.detour.pop_front() {
            Some(next) => self.start_leg(context, next),
            None => Ok(NodeStatus::Success),
        }
    }

    fn fail(&mut self, cause: Cause) -> Result<NodeStatus, Cause> {
        self.detour.clear();
        Err(cause)
    }
}

impl Leaf for NavigateToPose {
    fn tick(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        if self.drive.is_some() {
            return self.follow(context);
        }
        if !context.cancels_complete() {
            return Ok(NodeStatus::Running);
        }
        let place: PlaceId = context.read("place")?;
        if let Some(to) = context.read_optional::<PlaceId>("to")?
            && legs(&self.environment, context, &to).is_ok_and(|legs| legs.is_some_and(|legs| legs.is_empty()))
        {
            return Ok(NodeStatus::Success); // a detour has already reached the destination
        }
        self.start_leg(context, place)
    }

    fn halt(&mut self, context: &mut LeafContext<'_, '_>) {
        self.detour.clear();
        if let Some(drive) = self.drive.take() {
            context.cancel(drive.goal);
        }
    }
}

fn closed(context: &mut LeafContext<'_, '_>) -> Vec<(PlaceId, PlaceId)> {
    context.actions().telemetry().map_or(vec![], |telemetry| telemetry.closed.clone())
}
