//! `navigation`: to the place in parameter `to`, leg by leg along the shortest route from wherever the body is.
//!
//! A drive that was halted between two places resumes from there: the route is planned afresh at each start. Where a leg
//! is blocked the route is planned anew round all that the body knows to be closed; if there is no other way the drive fails
//! with the body's own words.

use super::{StandardSkill, TaskContext};
use crate::actions::{ActionError, ErrorCode, Goal, GoalId, GoalStatus};
use crate::bt::{
    Cause, Leaf, LeafContext, NodeKind, NodeManifest, NodeStatus, PortSpec, PortType, Registry, RegistryError, Value,
};
use crate::environment::{Environment, Routes};
use consort_protocol::ids::PlaceId;
use std::collections::VecDeque;

pub(super) const SKILL: StandardSkill =
    StandardSkill { task_type: "navigation", xml: include_str!("../../trees/navigation.xml"), register_leaves: leaves };

fn leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
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

/// The places still to drive to, round all that the body knows to be closed; `None` before the body's first report.
fn legs(
    environment: &Environment,
    context: &mut LeafContext<'_, '_>,
    to: &PlaceId,
) -> Result<Option<Vec<PlaceId>>, Cause> {
    let Some(telemetry) = context.actions().telemetry() else { return Ok(None) };
    let legs = routes(environment)?.without_closed(&telemetry.closed).legs(&telemetry.place, telemetry.pose, to);
    legs.map(Some).map_err(|error| Cause::new(error.to_string()))
}

/// Writes the places still to drive to; none where the body is there already. Waits for the body's first report, and
/// for the body to stand still.
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

/// Drives to `place`, one leg of the route to `to`. If the leg is blocked, and the body has learned of a closed way that it
/// did not know when it set off, drives round it, all the way to `to`; the legs that were still to come have nothing
/// left to do then. Without `to` it goes no other way.
struct NavigateToPose {
    environment: Environment,
    drive: Option<Drive>,
    /// The legs still to come of a way round.
    detour: VecDeque<PlaceId>,
}

struct Drive {
    goal: GoalId,
    /// What the body knew to be closed when it set off.
    known: Vec<(PlaceId, PlaceId)>,
    /// It was blocked, and the body's report of what it knows may be yet to come.
    blocked: Option<ActionError>,
}

impl NavigateToPose {
    fn set_off(&mut self, context: &mut LeafContext<'_, '_>, place: PlaceId) -> Result<NodeStatus, Cause> {
        let pose = routes(&self.environment)?.pose(&place);
        let pose = pose.ok_or_else(|| Cause::new(format!("{place} is not on the map")))?;
        let known = closed(context);
        let goal = context.actions().send_goal(Goal::NavigateToPose { pose, place: Some(place) });
        self.drive = Some(Drive { goal, known, blocked: None });
        self.follow(context)
    }

    fn follow(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        let Some(mut drive) = self.drive.take() else { return Ok(NodeStatus::Running) };
        if let Some(error) = drive.blocked {
            return self.look_for_another_way(context, &drive.known, error);
        }
        match context.actions().status(drive.goal) {
            Some(GoalStatus::Sent | GoalStatus::Executing(_)) => {
                self.drive = Some(drive);
                Ok(NodeStatus::Running)
            }
            Some(GoalStatus::Succeeded) => match self.detour.pop_front() {
                Some(next) => self.set_off(context, next),
                None => Ok(NodeStatus::Success),
            },
            Some(GoalStatus::Aborted(error)) if error.code == ErrorCode::Blocked => {
                if closed(context).iter().any(|way| !drive.known.contains(way)) {
                    return self.look_for_another_way(context, &drive.known, error);
                }
                // What it met may stand in the next report alone.
                drive.blocked = Some(error);
                self.drive = Some(drive);
                Ok(NodeStatus::Running)
            }
            Some(GoalStatus::Aborted(error)) => self.fail(Cause::from(error)),
            Some(GoalStatus::Canceled) => self.fail(Cause::new("it was canceled from outside")),
            None => self.fail(Cause::new(format!("the body no longer knows of goal {}", drive.goal.0))),
        }
    }

    fn look_for_another_way(
        &mut self,
        context: &mut LeafContext<'_, '_>,
        known: &[(PlaceId, PlaceId)],
        error: ActionError,
    ) -> Result<NodeStatus, Cause> {
        let learned = closed(context).iter().any(|way| !known.contains(way));
        let to: Option<PlaceId> = context.read_optional("to")?;
        let Some(to) = to.filter(|_| learned) else { return self.fail(Cause::from(error)) };
        match legs(&self.environment, context, &to) {
            Ok(Some(round)) => self.detour = round.into(),
            Ok(None) | Err(_) => return self.fail(Cause::from(error)),
        }
        match self.detour.pop_front() {
            Some(next) => self.set_off(context, next),
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
            return Ok(NodeStatus::Success); // it went round, and is there
        }
        self.set_off(context, place)
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
