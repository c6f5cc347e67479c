//! Leaves that drive to a place, leg by leg along the shortest route from the robot's position.
//!
//! The route is planned at each start, so a drive that was halted between two places resumes from
//! there. If a leg is blocked, the route is planned again without the lanes that the robot has
//! found closed. Without another route the drive fails with the robot's own message.
//!
//! A drive whose leg people close stops at once, and is planned again from there. If only people close
//! the last route, the robot waits until they open it.
//!
//! A leg that devices of the building guard, as doors and lifts, starts once they confirm. Until then the robot waits at its
//! place, and the route is planned again at each tick, since a device may meanwhile be unavailable.
//!
//! The goal of a leg contains the speed limit of people. If they lower it meanwhile, the robot stops, and drives the
//! rest of the leg as another goal. While there are limits the route is planned again at each place, since they may have
//! changed.

use super::context::TaskContext;
use crate::actions::{self, ActionError, ErrorCode, GoalId, GoalStatus};
use crate::bt::{
    Cause, Leaf, LeafContext, NodeKind, NodeManifest, NodeStatus, PortSpec, PortType, Registry, RegistryError, Value,
};
use crate::environment::{Environment, Passages, RouteError, Routes};
use consort_protocol::ids::PlaceId;
use consort_protocol::units::MetresPerSecond;
use std::borrow::Cow;
use std::collections::VecDeque;

pub(super) fn register_leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    let ports = [PortSpec::input("to", PortType::Place), PortSpec::output("legs", PortType::List)];
    registry.register(NodeManifest::new("PlanRoute", NodeKind::Action, ports), |context: &TaskContext| {
        Box::new(PlanRoute { environment: context.environment.clone() })
    })?;
    let ports = [PortSpec::input("place", PortType::Place), PortSpec::input("to", PortType::Place).optional()];
    registry.register(NodeManifest::new("NavigateToPose", NodeKind::Action, ports), |context: &TaskContext| {
        Box::new(NavigateToPose {
            environment: context.environment.clone(),
            drive: None,
            detour: VecDeque::new(),
            must_plan: false,
        })
    })
}

fn routes(environment: &Environment) -> Result<&Routes, Cause> {
    environment.get::<Routes>().map_err(|error| Cause::new(error.to_string()))
}

/// Returns the remaining places of the route, without closed lanes and places. `None` before the
/// robot's first report, and while people have closed every route.
fn legs(
    environment: &Environment,
    context: &mut LeafContext<'_, '_>,
    to: &PlaceId,
) -> Result<Option<Vec<PlaceId>>, Cause> {
    let Some(telemetry) = context.actions().telemetry() else { return Ok(None) };
    let (telemetry, routes, passages) = (telemetry.clone(), routes(environment)?, environment.find::<Passages>());
    let limits = context.actions().speed_limits().cloned().unwrap_or_default();
    let speed = context.actions().speed();
    let legs = |closed: &[(PlaceId, PlaceId)]| {
        let open = routes.without_closed(closed);
        let routes = speed.map_or(Cow::Borrowed(&*open), |speed| open.limited(&limits, speed, passages));
        routes.legs(&telemetry.place, telemetry.pose, to)
    };
    match legs(&telemetry.closed) {
        Err(RouteError::Closed { .. }) if legs(&context.actions().found_closed()).is_ok() => Ok(None),
        legs => legs.map(Some).map_err(|error| Cause::new(error.to_string())),
    }
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
/// remaining legs then have nothing left to do. Without `to` there is no detour. If people close the
/// leg, the robot stops, and drives another route to `to`, or to `place`.
struct NavigateToPose {
    environment: Environment,
    drive: Option<Drive>,
    /// Remaining legs of a detour.
    detour: VecDeque<PlaceId>,
    /// People have closed the leg, or limit speeds: the route is to be planned again.
    must_plan: bool,
}

struct Drive {
    goal: GoalId,
    /// Place that the robot had passed at the start of the leg.
    from: PlaceId,
    to: PlaceId,
    /// Places after the leg on the route.
    then: Vec<PlaceId>,
    speed_max: Option<MetresPerSecond>,
    /// Closed lanes that the robot reported at the start of the leg.
    known_closed: Vec<(PlaceId, PlaceId)>,
    /// Error of a blocked leg, while the robot's next report may still add a closed lane.
    blocked: Option<ActionError>,
}

impl Drive {
    /// Checks whether people have lowered the speed limit since the start of the leg.
    fn is_too_fast(&self, context: &mut LeafContext<'_, '_>) -> bool {
        let limit = speed_limit(context, &self.from, &self.to);
        limit.is_some_and(|limit| self.speed_max.is_none_or(|speed| limit.get() < speed.get()))
    }
}

impl NavigateToPose {
    /// Starts a leg that was planned before. While people limit speeds, another way may be faster now.
    fn start_next_leg(&mut self, context: &mut LeafContext<'_, '_>, place: PlaceId) -> Result<NodeStatus, Cause> {
        let are_limited = context.actions().speed_limits().is_some_and(|limits| !limits.is_empty());
        if are_limited && context.read_optional::<PlaceId>("to")?.is_some() {
            self.must_plan = true;
            return self.plan_again(context);
        }
        self.start_leg(context, place)
    }

    fn start_leg(&mut self, context: &mut LeafContext<'_, '_>, place: PlaceId) -> Result<NodeStatus, Cause> {
        let pose = routes(&self.environment)?.pose(&place);
        let pose = pose.ok_or_else(|| Cause::new(format!("{place} is not on the map")))?;
        if enters_closed(context, &place) {
            self.must_plan = true;
            return Ok(NodeStatus::Running);
        }
        let known_closed = closed(context);
        let from = context.actions().telemetry().map_or_else(|| place.clone(), |telemetry| telemetry.place.clone());
        let then = self.places_after(context, &place)?;
        if !context.actions().request_way(&from, &place, &then) {
            self.must_plan = true;
            return Ok(NodeStatus::Running);
        }
        let speed_max = speed_limit(context, &from, &place);
        let drive = actions::NavigateToPose {
            speed_max_mps: speed_max,
            ..actions::NavigateToPose::to(pose, Some(place.clone()))
        };
        let goal = context.actions().send_goal(drive.into());
        self.drive = Some(Drive { goal, from, to: place, then, speed_max, known_closed, blocked: None });
        self.follow(context)
    }

    /// Returns the places after the leg to `place` on the route to the destination.
    fn places_after(&self, context: &mut LeafContext<'_, '_>, place: &PlaceId) -> Result<Vec<PlaceId>, Cause> {
        if !self.detour.is_empty() {
            return Ok(self.detour.iter().cloned().collect());
        }
        let Some(to) = context.read_optional::<PlaceId>("to")?.filter(|to| to != place) else { return Ok(vec![]) };
        let route = legs(&self.environment, context, &to).ok().flatten().unwrap_or_default();
        Ok(match route.split_first() {
            Some((first, rest)) if first == place => rest.to_vec(),
            _ => vec![],
        })
    }

    fn follow(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        let Some(mut drive) = self.drive.take() else { return Ok(NodeStatus::Running) };
        if let Some(error) = drive.blocked {
            return self.take_detour(context, &drive.known_closed, error);
        }
        match context.actions().status(drive.goal) {
            Some(GoalStatus::Sent | GoalStatus::Executing(_))
                if enters_closed(context, &drive.to) || drive.is_too_fast(context) =>
            {
                context.cancel(drive.goal);
                self.must_plan = true;
                Ok(NodeStatus::Running)
            }
            Some(GoalStatus::Sent | GoalStatus::Executing(_)) => {
                context.actions().request_way(&drive.from, &drive.to, &drive.then);
                self.drive = Some(drive);
                Ok(NodeStatus::Running)
            }
            Some(GoalStatus::Succeeded(_)) => {
                context.actions().end_way();
                match self.detour.pop_front() {
                    Some(next) => self.start_next_leg(context, next),
                    None => Ok(NodeStatus::Success),
                }
            }
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

    /// Plans the route again once the robot stands still; waits while people have closed every route.
    fn plan_again(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        let to: Option<PlaceId> = context.read_optional("to")?;
        let to = match to {
            Some(to) => to,
            None => context.read("place")?,
        };
        let Some(legs) = legs(&self.environment, context, &to)? else { return Ok(NodeStatus::Running) };
        self.must_plan = false;
        self.detour = legs.into();
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
        if self.must_plan {
            return self.plan_again(context);
        }
        let place: PlaceId = context.read("place")?;
        if let Some(to) = context.read_optional::<PlaceId>("to")?
            && legs(&self.environment, context, &to).is_ok_and(|legs| legs.is_some_and(|legs| legs.is_empty()))
        {
            return Ok(NodeStatus::Success); // a detour has already reached the destination
        }
        self.start_next_leg(context, place)
    }

    fn halt(&mut self, context: &mut LeafContext<'_, '_>) {
        self.detour.clear();
        self.must_plan = false;
        if let Some(drive) = self.drive.take() {
            context.cancel(drive.goal);
        }
    }
}

/// Checks whether the robot enters what people have closed on its way to the neighbour `to`.
fn enters_closed(context: &mut LeafContext<'_, '_>, to: &PlaceId) -> bool {
    let Some(from) = context.actions().telemetry().map(|telemetry| telemetry.place.clone()) else { return false };
    Routes::enters_closed(context.actions().closed_by_people(), &from, to)
}

/// Returns the speed limit of people for a robot that has passed `from`, on its way to the neighbour `to`.
fn speed_limit(context: &mut LeafContext<'_, '_>, from: &PlaceId, to: &PlaceId) -> Option<MetresPerSecond> {
    context.actions().speed_limits().and_then(|limits| limits.on(from, to))
}

fn closed(context: &mut LeafContext<'_, '_>) -> Vec<(PlaceId, PlaceId)> {
    context.actions().telemetry().map_or(vec![], |telemetry| telemetry.closed.clone())
}
