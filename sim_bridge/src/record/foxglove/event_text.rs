//! What happens, in words.

use crate::world::{SampleHolder, WorldEvent, goal_name};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_skills::actions::{Goal, GoalStatus};

/// Foxglove's levels.
pub(super) const INFO: u8 = 2;
pub(super) const WARNING: u8 = 3;
const ERROR: u8 = 4;

/// How grave it is, who or what it is about, and what it is.
pub(super) fn log_line(what: &WorldEvent) -> (u8, String, String) {
    let said = |name: &dyn ToString, message: String| (INFO, name.to_string(), message);
    match what {
        WorldEvent::GoalStarted { robot, id, goal } => said(robot, format!("begins {} (goal {})", aim(goal), id.0)),
        WorldEvent::GoalEnded { robot, id, status } => match status {
            GoalStatus::Succeeded => said(robot, format!("has done goal {}", id.0)),
            GoalStatus::Canceled => said(robot, format!("goal {} was canceled", id.0)),
            GoalStatus::Aborted(why) => (WARNING, robot.to_string(), format!("goal {} failed: {why}", id.0)),
            GoalStatus::Sent | GoalStatus::Executing(_) => said(robot, format!("goal {} is under way", id.0)),
        },
        WorldEvent::DrawerMoved { robot, open } => said(robot, format!("its drawer is {}", is_open(*open))),
        WorldEvent::Approached { robot, person, authenticated: false } => {
            said(robot, format!("has approached {person}"))
        }
        WorldEvent::Approached { robot, person, authenticated: true } => {
            said(robot, format!("knows that it is {person}"))
        }
        WorldEvent::MissionCanceled { person, robot } => {
            (WARNING, person.to_string(), format!("calls off what {robot} came for"))
        }
        WorldEvent::HandoverDeclined { person, robot } => {
            (WARNING, person.to_string(), format!("does not do what {robot} waits for"))
        }
        WorldEvent::PersonLeft { person } => (WARNING, person.to_string(), "has walked away".to_owned()),
        WorldEvent::PersonReturned { person } => said(person, "is back".to_owned()),
        WorldEvent::HandoverStarted { person, robot } => said(person, format!("hands a sample over to {robot}")),
        WorldEvent::SampleMoved { sample, from, to } => said(sample, format!("{} → {}", keeper(from), keeper(to))),
        WorldEvent::DoorRequested { robot, door } => said(robot, format!("waits for {door} to let it in")),
        WorldEvent::DoorEntered { robot, door } => said(robot, format!("goes through {door}")),
        WorldEvent::DoorLeft { robot, door } => said(robot, format!("is no longer at {door}")),
        WorldEvent::DoorMoved { door, open } => said(door, format!("is {}", is_open(*open))),
        WorldEvent::LiftRequested { robot, lift, at, to } => said(robot, format!("waits at {at} for {lift} to {to}")),
        WorldEvent::LiftEntered { robot, lift } => said(robot, format!("is in {lift}")),
        WorldEvent::LiftLeft { robot, lift, at } => said(robot, format!("is no longer at {lift}, but at {at}")),
        WorldEvent::LaneBlocked { obstacle, between } => {
            (WARNING, obstacle.clone(), format!("stands in the way {}", ends(between)))
        }
        WorldEvent::LaneCleared { obstacle, between } => {
            said(obstacle, format!("has gone from the way {}", ends(between)))
        }
        WorldEvent::Docked { robot, docked: true } => said(robot, "has docked".to_owned()),
        WorldEvent::Docked { robot, docked: false } => said(robot, "has undocked".to_owned()),
        WorldEvent::Collided { robot, with } => {
            let with = with.as_ref().map_or("a wall".to_owned(), ToString::to_string);
            (ERROR, robot.to_string(), format!("has run into {with}"))
        }
        WorldEvent::Stranded { robot } => (ERROR, robot.to_string(), "battery empty: stands where it is".to_owned()),
    }
}

/// Whether it changes something about a robot that its pose does not show.
pub(super) fn changes_state_of(what: &WorldEvent, of: &RobotId) -> bool {
    match what {
        WorldEvent::GoalEnded { robot, .. }
        | WorldEvent::DrawerMoved { robot, .. }
        | WorldEvent::Docked { robot, .. }
        | WorldEvent::Collided { robot, .. }
        | WorldEvent::Stranded { robot } => robot == of,
        WorldEvent::SampleMoved { from, to, .. } => [from, to].iter().any(|keeper| match keeper {
            SampleHolder::Drawer(robot) | SampleHolder::Arm(robot) => robot == of,
            SampleHolder::Table(_) | SampleHolder::Person(_) => false,
        }),
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

fn aim(goal: &Goal) -> String {
    match goal {
        Goal::NavigateToPose { place: Some(place), .. } => format!("{} to {place}", goal_name(goal)),
        Goal::FollowWaypoints { waypoints } => format!("{} over {}", goal_name(goal), waypoints.len()),
        _ => goal_name(goal).to_owned(),
    }
}

fn is_open(open: bool) -> &'static str {
    if open { "open" } else { "closed" }
}

fn ends((a, b): &(PlaceId, PlaceId)) -> String {
    format!("between {a} and {b}")
}

fn keeper(keeper: &SampleHolder) -> String {
    match keeper {
        SampleHolder::Table(place) => format!("table of {place}"),
        SampleHolder::Drawer(robot) => format!("drawer of {robot}"),
        SampleHolder::Arm(robot) => format!("arm of {robot}"),
        SampleHolder::Person(person) => person.to_string(),
    }
}
