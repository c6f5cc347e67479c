//! What happens, in words.

use crate::world::{Happening, Keeper, verb};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_skills::actions::{Goal, GoalStatus};

/// Foxglove's levels.
pub(super) const INFO: u8 = 2;
pub(super) const WARNING: u8 = 3;
const ERROR: u8 = 4;

/// How grave it is, who or what it is about, and what it is.
pub(super) fn of(what: &Happening) -> (u8, String, String) {
    let said = |name: &dyn ToString, message: String| (INFO, name.to_string(), message);
    match what {
        Happening::GoalBegan { robot, id, goal } => said(robot, format!("begins {} (goal {})", aim(goal), id.0)),
        Happening::GoalEnded { robot, id, status } => match status {
            GoalStatus::Succeeded => said(robot, format!("has done goal {}", id.0)),
            GoalStatus::Canceled => said(robot, format!("goal {} was canceled", id.0)),
            GoalStatus::Aborted(why) => (WARNING, robot.to_string(), format!("goal {} failed: {why}", id.0)),
            GoalStatus::Sent | GoalStatus::Executing(_) => said(robot, format!("goal {} is under way", id.0)),
        },
        Happening::Drawer { robot, open } => said(robot, format!("its drawer is {}", is_open(*open))),
        Happening::Approached { robot, person, authenticated: false } => {
            said(robot, format!("has approached {person}"))
        }
        Happening::Approached { robot, person, authenticated: true } => {
            said(robot, format!("knows that it is {person}"))
        }
        Happening::CalledOff { person, robot } => {
            (WARNING, person.to_string(), format!("calls off what {robot} came for"))
        }
        Happening::Declined { person, robot } => {
            (WARNING, person.to_string(), format!("does not do what {robot} waits for"))
        }
        Happening::WalkedAway { person } => (WARNING, person.to_string(), "has walked away".to_owned()),
        Happening::CameBack { person } => said(person, "is back".to_owned()),
        Happening::HandsOut { person, robot } => said(person, format!("hands a sample over to {robot}")),
        Happening::SampleMoved { sample, from, to } => said(sample, format!("{} → {}", keeper(from), keeper(to))),
        Happening::DoorAwaited { robot, door } => said(robot, format!("waits for {door} to let it in")),
        Happening::DoorEntered { robot, door } => said(robot, format!("goes through {door}")),
        Happening::DoorLeft { robot, door } => said(robot, format!("is no longer at {door}")),
        Happening::Door { door, open } => said(door, format!("is {}", is_open(*open))),
        Happening::LiftAwaited { robot, lift, at, to } => said(robot, format!("waits at {at} for {lift} to {to}")),
        Happening::LiftEntered { robot, lift } => said(robot, format!("is in {lift}")),
        Happening::LiftLeft { robot, lift, at } => said(robot, format!("is no longer at {lift}, but at {at}")),
        Happening::WayClosed { obstacle, between } => {
            (WARNING, obstacle.clone(), format!("stands in the way {}", ends(between)))
        }
        Happening::WayOpened { obstacle, between } => {
            said(obstacle, format!("has gone from the way {}", ends(between)))
        }
        Happening::Docked { robot, docked: true } => said(robot, "has docked".to_owned()),
        Happening::Docked { robot, docked: false } => said(robot, "has undocked".to_owned()),
        Happening::Collided { robot, with } => {
            let with = with.as_ref().map_or("a wall".to_owned(), ToString::to_string);
            (ERROR, robot.to_string(), format!("has run into {with}"))
        }
        Happening::Stranded { robot } => (ERROR, robot.to_string(), "battery empty: stands where it is".to_owned()),
    }
}

/// Whether it changes something about a robot that its pose does not show.
pub(super) fn is_about(what: &Happening, of: &RobotId) -> bool {
    match what {
        Happening::GoalEnded { robot, .. }
        | Happening::Drawer { robot, .. }
        | Happening::Docked { robot, .. }
        | Happening::Collided { robot, .. }
        | Happening::Stranded { robot } => robot == of,
        Happening::SampleMoved { from, to, .. } => [from, to].iter().any(|keeper| match keeper {
            Keeper::Drawer(robot) | Keeper::Arm(robot) => robot == of,
            Keeper::Table(_) | Keeper::Person(_) => false,
        }),
        Happening::GoalBegan { .. }
        | Happening::Approached { .. }
        | Happening::CalledOff { .. }
        | Happening::Declined { .. }
        | Happening::WalkedAway { .. }
        | Happening::CameBack { .. }
        | Happening::HandsOut { .. }
        | Happening::DoorAwaited { .. }
        | Happening::DoorEntered { .. }
        | Happening::DoorLeft { .. }
        | Happening::Door { .. }
        | Happening::LiftAwaited { .. }
        | Happening::LiftEntered { .. }
        | Happening::LiftLeft { .. }
        | Happening::WayClosed { .. }
        | Happening::WayOpened { .. } => false,
    }
}

fn aim(goal: &Goal) -> String {
    match goal {
        Goal::NavigateToPose { place: Some(place), .. } => format!("{} to {place}", verb(goal)),
        Goal::FollowWaypoints { waypoints } => format!("{} over {}", verb(goal), waypoints.len()),
        _ => verb(goal).to_owned(),
    }
}

fn is_open(open: bool) -> &'static str {
    if open { "open" } else { "closed" }
}

fn ends((a, b): &(PlaceId, PlaceId)) -> String {
    format!("between {a} and {b}")
}

fn keeper(keeper: &Keeper) -> String {
    match keeper {
        Keeper::Table(place) => format!("table of {place}"),
        Keeper::Drawer(robot) => format!("drawer of {robot}"),
        Keeper::Arm(robot) => format!("arm of {robot}"),
        Keeper::Person(person) => person.to_string(),
    }
}
