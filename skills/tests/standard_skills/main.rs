//! The standard skills, with a robot that follows a script.

mod follow_path;
mod interactions;
mod library;
mod navigation;
mod questions;
mod scripted_driver;

use consort_protocol::cause::CauseClass;
use consort_protocol::ids::{PlaceId, RobotId, RoleId, TaskType};
use consort_protocol::mission::TaskSpec;
use consort_protocol::pose::Pose;
use consort_skills::actions::{ActionError, ErrorCode, Goal};
use consort_skills::environment::{Edge, Environment, Routes, TopologicalMap};
use consort_skills::library::{ActiveSkill, SkillLibrary, SkillStatus};
use consort_skills::skill::SkillContext;
use scripted_driver::ScriptedDriver;
use serde_json::{Value, json};

fn place(name: &str) -> PlaceId {
    PlaceId::new(name).unwrap()
}

fn role(name: &str) -> RoleId {
    RoleId::new(name).unwrap()
}

/// A – B – C in a line with 10 m between, and D apart.
fn environment() -> Environment {
    let names = [("A", 0.0), ("B", 10.0), ("C", 20.0), ("D", 90.0)];
    let edge = |a, b| Edge { a: place(a), b: place(b), length_m: 10.0, one_way: false };
    let map = TopologicalMap {
        places: names.map(|(name, x)| (place(name), Pose::new(x, 0.0, 0.0))).into(),
        edges: vec![edge("A", "B"), edge("B", "C")],
    };
    Environment::new().with(Routes::new(&map).unwrap())
}

/// A task of role r1.
fn task(task_type: &str, parameters: &[(&str, &str)]) -> TaskSpec {
    TaskSpec {
        parameters: parameters.iter().map(|(name, value)| (name.to_string(), value.to_string())).collect(),
        ..TaskSpec::of(TaskType::new(task_type).unwrap(), vec![role("r1")])
    }
}

/// Robot ada is r1, arm is lab_arm.
fn goal(action: &str, parameters: Value, repeatable: bool) -> Goal {
    let Value::Object(parameters) = parameters else { panic!("{parameters} is not an object") };
    Goal { action: action.parse().unwrap(), parameters, repeatable, hands_over: None, since: None }
}

fn context() -> SkillContext {
    let holder = |name, robot| (role(name), RobotId::new(robot).unwrap());
    SkillContext { holders: [holder("r1", "ada"), holder("lab_arm", "arm")].into() }
}

fn skill(task: &TaskSpec) -> ActiveSkill {
    SkillLibrary::standard(environment()).load(task, &context()).unwrap_or_else(|error| panic!("{error}"))
}

/// The status of a completed task without results.
fn succeeded() -> SkillStatus {
    SkillStatus::Succeeded(Default::default())
}

/// Ticks, and lets the robot end its goals, until the skill ends.
fn run(skill: &mut ActiveSkill, driver: &mut ScriptedDriver) -> SkillStatus {
    for _ in 0..100 {
        match skill.tick(driver) {
            SkillStatus::Running => driver.end_goal(),
            ended => return ended,
        }
    }
    panic!("it still runs after 100 ticks; sent {:?}", driver.sent());
}

fn failed(cause: &str) -> SkillStatus {
    failed_as(CauseClass::Robot, cause)
}

fn failed_as(class: CauseClass, cause: &str) -> SkillStatus {
    SkillStatus::Failed { cause: cause.to_owned(), class }
}

fn error(code: ErrorCode, message: &str) -> ActionError {
    ActionError::new(code, message.to_owned())
}
