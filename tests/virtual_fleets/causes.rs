//! Classes of causes: what a failure means for the other robots.

use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RobotId};
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::MissionState;
use consort_protocol::yaml;
use consort_skills::domain_file::DomainFile;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};

const SEEDS: [u64; 2] = [911, 912];

/// Actions that always fail, each for a cause of another class.
const DOMAIN: &str = r#"
domain: failing
actions:
  fail_robot: { failures: { worn: { class: robot } }, simulate: { failures: { worn: 1.0 } } }
  fail_task: { failures: { forbidden: { class: task } }, simulate: { failures: { forbidden: 1.0 } } }
  fail_transient: { failures: { jammed: { class: transient } }, simulate: { failures: { jammed: 1.0 } } }
  fail_precondition: { failures: { no_tool: { class: precondition } }, simulate: { failures: { no_tool: 1.0 } } }
tasks:
  fail_robot: { action: fail_robot }
  fail_task: { action: fail_task }
  fail_transient: { action: fail_transient }
  fail_precondition: { action: fail_precondition }
"#;

const TASKS: [&str; 4] = ["fail_robot", "fail_task", "fail_transient", "fail_precondition"];

fn domain() -> DomainFile {
    DomainFile::check(yaml::parse(DOMAIN).unwrap(), &BTreeMap::new(), &[]).unwrap()
}

/// Starts a fleet of three robots with all tasks.
async fn fleet(seed: u64) -> Fleet {
    let robot = |name| RobotSpec::carrier(name, "Dock").with_skills(&TASKS).with_skill("operate_drawer");
    let robots = ["amber", "birch", "cedar"].map(robot).to_vec();
    let mut fleet = Fleet::hospital_of_domain(seed, robots, &["post"], domain()).await;
    fleet.wait_for_coordinator().await;
    fleet
}

async fn submit(fleet: &Fleet, task: &str) -> MissionId {
    let mission = json!({
        "mission": "try", "roles": { "r1": { "kind": "managed" } },
        "root": { "task": "it", "type": task, "roles": ["r1"], "attempts": 2 },
    });
    let answer = fleet.request_answered(ApiCall::Submit, &json!({ "mission": mission, "request": task })).await;
    slug(answer["mission"].as_str().unwrap_or_else(|| panic!("{answer}")))
}

/// Returns the cause of the failed mission, the number of attempts, and the robots that tried.
async fn failure(fleet: &mut Fleet, task: &str) -> (String, usize, BTreeSet<RobotId>) {
    let id = submit(fleet, task).await;
    let MissionState::Failed { cause } = fleet.wait_for_end(&id).await else { panic!("seed {}", fleet.seed) };
    let began = |kind: &EventKind| matches!(kind, EventKind::TaskBegan { mission, .. } if *mission == id);
    let attempts = fleet.events().iter().filter(|kind| began(kind)).count();
    let awarded = |kind| match kind {
        EventKind::Awarded { mission, holders, .. } if mission == id => Some(holders.into_values()),
        _ => None,
    };
    (cause, attempts, fleet.events().into_iter().filter_map(awarded).flatten().collect())
}

/// The mission fails with the first attempt of the first robot. All robots are free for the next one.
#[test]
fn a_task_that_no_robot_can_do_fails_at_once() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed).await;
        for round in 0..2 {
            let (cause, attempts, robots) = failure(&mut fleet, "fail_task").await;
            assert_eq!((attempts, robots.len()), (1, 1), "seed {seed}, round {round}: {cause}");
            assert!(cause.contains("could not do it: fail_task: failed: forbidden: "), "seed {seed}: {cause}");
        }
    });
}

/// Each robot tries as often as the mission allows.
#[test]
fn another_robot_may_succeed_where_a_robot_failed() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed).await;
        let (cause, attempts, robots) = failure(&mut fleet, "fail_robot").await;
        assert_eq!((attempts, robots.len()), (6, 3), "seed {seed}: {cause}");
        assert!(cause.starts_with("no robot is left for r1: "), "seed {seed}: {cause}");
    });
}

/// A robot without what the task needs does not try again; each other robot tries once.
#[test]
fn a_missing_precondition_is_not_tried_again() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed).await;
        let (cause, attempts, robots) = failure(&mut fleet, "fail_precondition").await;
        assert_eq!((attempts, robots.len()), (3, 3), "seed {seed}: {cause}");
    });
}

/// Robots try four times each, although the mission allows two attempts, and may get the role again. All
/// robots together give it up five times.
#[test]
fn transient_failures_are_bounded_over_all_robots() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed).await;
        let (cause, attempts, robots) = failure(&mut fleet, "fail_transient").await;
        assert_eq!((attempts, robots.len()), (20, 3), "seed {seed}: {cause}");
        assert!(cause.starts_with("its roles were given up 5 times: "), "seed {seed}: {cause}");
    });
}
