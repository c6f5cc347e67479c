//! Text for world events.

use crate::world::{SampleHolder, WorldEvent};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_skills::actions::{FollowWaypoints, Goal, GoalStatus, NavigateToPose};

/// Foxglove's log levels.
pub(super) const INFO: u8 = 2;
pub(super) const WARNING: u8 = 3;
const ERROR: u8 = 4;

/// Returns the log level, the subject and the text of an event.
pub(super) fn log_line(event: &WorldEvent) -> (u8, String, String) {
    let info = |name: &dyn ToString, message: String| (INFO, name.to_string(), message);
    match event {
        WorldEvent::GoalStarted { robot, id, goal } => {
            info(robot, format!("begins {} (goal {})", goal_text(goal), id.0))
        }
        WorldEvent::GoalEnded { robot, id, status } => match status {
            GoalStatus::Succeeded(_) => info(robot, format!("completed goal {}", id.0)),
            GoalStatus::Canceled => info(robot, format!("goal {} was canceled", id.0)),
            GoalStatus::Aborted(error) => (WARNING, robot.to_string(), format!("goal {} failed: {error}", id.0)),
            GoalStatus::Sent | GoalStatus::Executing(_) => info(robot, format!("goal {} is under way", id.0)),
        },
        WorldEvent::DrawerMoved { robot, open } => info(robot, format!("its drawer is {}", open_text(*open))),
        WorldEvent::Approached { robot, person, authenticated: false } => {
            info(robot, format!("has approached {person}"))
        }
        WorldEvent::Approached { robot, person, authenticated: true } => {
            info(robot, format!("has authenticated {person}"))
        }
        WorldEvent::MissionCanceled { person, robot } => {
            (WARNING, person.to_string(), format!("cancels the mission of {robot}"))
        }
        WorldEvent::HandoverDeclined { person, robot } => {
            (WARNING, person.to_string(), format!("declines the handover to {robot}"))
        }
        WorldEvent::PersonLeft { person } => (WARNING, person.to_string(), "has walked away".to_owned()),
        WorldEvent::PersonReturned { person } => info(person, "has returned".to_owned()),
        WorldEvent::HandoverStarted { person, robot } => info(person, format!("starts a handover to {robot}")),
        WorldEvent::SampleMoved { sample, from, to } => {
            info(sample, format!("{} → {}", holder_text(from), holder_text(to)))
        }
        WorldEvent::SampleCreated { sample, holder } => info(sample, format!("new → {}", holder_text(holder))),
        WorldEvent::SampleConsumed { sample, from } => info(sample, format!("{} → used up", holder_text(from))),
        WorldEvent::DoorRequested { robot, door } => info(robot, format!("waits at {door}")),
        WorldEvent::DoorEntered { robot, door } => info(robot, format!("passes through {door}")),
        WorldEvent::DoorLeft { robot, door } => info(robot, format!("has left {door}")),
        WorldEvent::DoorMoved { door, open } => info(door, format!("is {}", open_text(*open))),
        WorldEvent::LiftRequested { robot, lift, at, to } => info(robot, format!("waits at {at} for {lift} to {to}")),
        WorldEvent::LiftEntered { robot, lift } => info(robot, format!("has entered {lift}")),
        WorldEvent::LiftLeft { robot, lift, at } => info(robot, format!("has left {lift} at {at}")),
        WorldEvent::LaneBlocked { obstacle, between } => {
            (WARNING, obstacle.clone(), format!("blocks the lane {}", lane_text(between)))
        }
        WorldEvent::LaneCleared { obstacle, between } => {
            info(obstacle, format!("no longer blocks the lane {}", lane_text(between)))
        }
        WorldEvent::Docked { robot, docked: true } => info(robot, "has docked".to_owned()),
        WorldEvent::Docked { robot, docked: false } => info(robot, "has undocked".to_owned()),
        WorldEvent::Collided { robot, with } => {
            let with = with.as_ref().map_or("a wall".to_owned(), ToString::to_string);
            (ERROR, robot.to_string(), format!("collided with {with}"))
        }
        WorldEvent::Stranded { robot } => (ERROR, robot.to_string(), "battery empty: stands where it is".to_owned()),
    }
}

/// Checks whether an event changes a part of a robot's state that its pose does not show.
pub(super) fn changes_state_of(event: &WorldEvent, of: &RobotId) -> bool {
    match event {
        WorldEvent::GoalEnded { robot, .. }
        | WorldEvent::DrawerMoved { robot, .. }
        | WorldEvent::Docked { robot, .. }
        | WorldEvent::Collided { robot, .. }
        | WorldEvent::Stranded { robot } => robot == of,
        WorldEvent::SampleMoved { from, to, .. } => is_held_by(from, of) || is_held_by(to, of),
        WorldEvent::SampleCreated { holder, .. } | WorldEvent::SampleConsumed { from: holder, .. } => {
            is_held_by(holder, of)
        }
        WorldEvent::GoalStarted { .. }
        | WorldEvent::Approached { .. }
        | WorldEvent::MissionCanceled { .. }
        | WorldEvent::HandoverDeclined { .. }
        | WorldEvent::PersonLeft { .. }
        | WorldEvent::PersonReturned { .. }
        | WorldEvent::HandoverStarted { .. }
        | WorldEvent::DoorRequested { .. }
        | WorldEvent::DoorEntered { .. }
        | WorldEvent::DoorLeft { .. }
        | WorldEvent::DoorMoved { .. }
        | WorldEvent::LiftRequested { .. }
        | WorldEvent::LiftEntered { .. }
        | WorldEvent::LiftLeft { .. }
        | WorldEvent::LaneBlocked { .. }
        | WorldEvent::LaneCleared { .. } => false,
    }
}

fn is_held_by(holder: &SampleHolder, of: &RobotId) -> bool {
    match holder {
        SampleHolder::Drawer(robot) | SampleHolder::Arm(robot) => robot == of,
        SampleHolder::Table(_) | SampleHolder::Person(_) => false,
    }
}

fn goal_text(goal: &Goal) -> String {
    if let Some(Ok(NavigateToPose { place: Some(place), .. })) = goal.read() {
        return format!("{} to {place}", goal.action);
    }
    match goal.read() {
        Some(Ok(FollowWaypoints { waypoints })) => format!("{} over {}", goal.action, waypoints.len()),
        _ => goal.action.to_string(),
    }
}

fn open_text(open: bool) -> &'static str {
    if open { "open" } else { "closed" }
}

fn lane_text((a, b): &(PlaceId, PlaceId)) -> String {
    format!("between {a} and {b}")
}

fn holder_text(holder_text: &SampleHolder) -> String {
    match holder_text {
        SampleHolder::Table(place) => format!("table of {place}"),
        SampleHolder::Drawer(robot) => format!("drawer of {robot}"),
        SampleHolder::Arm(robot) => format!("arm of {robot}"),
        SampleHolder::Person(person) => person.to_string(),
    }
}
