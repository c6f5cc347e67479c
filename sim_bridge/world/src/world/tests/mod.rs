//! Tests of the world, a subject per file.

mod action_systems;
mod declared_goals;
mod docking;
mod doors;
mod driving;
mod gripping;
mod lab_samples;
mod lifts;
mod obstacles;
mod own_parts;
mod person_requests;
mod power;
mod preconditions;
mod properties;
mod readings;
mod sensing;
mod setup_errors;
mod speed;
mod spontaneous_actions;
mod steered_journeys;
mod steering;
mod systems;

use super::*;
use crate::map::{self, Map};
use consort_protocol::ids::{PlaceId, RobotId, RoleId, TaskType};
use consort_protocol::mission::TaskSpec;
use consort_protocol::units::{BatteryShare, MetresPerSecond, Seconds, SharePerSecond, WorldTime};
use consort_skills::actions::{
    ActionError, BackendEvent, ErrorCode, Goal, GoalId, GoalStatus, NavigateToPose, PersonRequest, RobotBackend,
};

fn place(name: &str) -> PlaceId {
    PlaceId::new(name).unwrap()
}

fn robot(name: &str) -> RobotId {
    RobotId::new(name).unwrap()
}

fn role(name: &str) -> RoleId {
    RoleId::new(name).unwrap()
}

fn at(seconds: f64) -> WorldTime {
    WorldTime::from_secs(seconds)
}

/// A carrier of 0.5 m/s with a full battery that loses 0.1 % a second with a goal.
fn carrier(name: &str, at: &str) -> RobotSetup {
    let (speed, discharge) = (MetresPerSecond::new(0.5).unwrap(), SharePerSecond::new(0.001).unwrap());
    RobotSetup::carrier(robot(name), place(at), speed, BatteryShare::FULL, discharge)
}

fn nurse(name: &str, at: &str, sample: &str) -> PersonSetup {
    PersonSetup { samples: vec![sample.into()], ..PersonSetup::new(name, role("nurse"), place(at)) }
}

fn hospital(seed: u64) -> WorldSetup {
    WorldSetup::new(map::shipped("hospital").unwrap(), seed)
}

/// Drains the event log and returns the events that `of` maps to a value, with their times.
fn logged<T>(world: &mut World, of: impl Fn(&WorldEvent) -> Option<T>) -> Vec<(f64, T)> {
    let journal = world.drain_event_log().into_iter();
    journal.filter_map(|entry| Some((entry.time.as_secs(), of(&entry.event)?))).collect()
}

fn drive_goal(world: &World, to: &str) -> Goal {
    Goal::from(NavigateToPose::to(world.map().place(&place(to)).unwrap().pose, Some(place(to))))
}

fn ended(name: &str, goal: u64, status: GoalStatus) -> BackendEvent {
    BackendEvent::GoalEnded { robot: robot(name), goal: GoalId(goal), status }
}

fn aborted(code: ErrorCode, message: &str) -> GoalStatus {
    GoalStatus::Aborted(ActionError::rejected(code, message.to_owned()))
}

/// A request to a nurse to deposit into the drawer of the robot that holds `r1`.
fn deposit(holder: &str) -> PersonRequest {
    let task = TaskSpec {
        parameters: [("into_role".to_owned(), "r1".to_owned())].into(),
        ..TaskSpec::of(TaskType::new("deposit").unwrap(), vec![role("nurse")])
    };
    PersonRequest { role: role("nurse"), task, holders: [(role("r1"), robot(holder))].into() }
}

/// Starts a goal and advances time until it ends. Returns its status and the other events.
fn run(world: &mut World, name: &str, id: u64, goal: Goal) -> (GoalStatus, Vec<BackendEvent>) {
    world.start(&robot(name), GoalId(id), goal);
    let mut others = Vec::new();
    for _ in 0..100 {
        let due = world.next_due().expect("the goal has not ended");
        for event in world.advance(due) {
            match event {
                BackendEvent::GoalEnded { robot, goal, status } if robot.as_str() == name && goal == GoalId(id) => {
                    return (status, others);
                }
                other => others.push(other),
            }
        }
    }
    panic!("goal {id} of {name} did not end");
}

/// The same for a goal that must succeed without other events.
fn run_to_success(world: &mut World, name: &str, id: u64, goal: Goal) {
    assert_eq!(run(world, name, id, goal), (GoalStatus::succeeded(), vec![]), "{name}, goal {id}");
}

fn rejected_status(world: &mut World, name: &str, id: u64, goal: Goal) -> GoalStatus {
    world.start(&robot(name), GoalId(id), goal);
    let now = world.now();
    match world.advance(now).as_slice() {
        [BackendEvent::GoalEnded { status, .. }] => status.clone(),
        other => panic!("one refusal at once, not {other:?}"),
    }
}
