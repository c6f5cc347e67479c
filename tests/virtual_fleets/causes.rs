//! Classes of causes: what a failure means for the other robots.

use consort_protocol::cause::CauseClass;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RobotId};
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::MissionState;
use consort_tests::{FAILING_TASKS, Fleet, RobotSpec, failing_domain, for_each_seed, slug};
use serde_json::json;
use std::collections::BTreeSet;

const SEEDS: [u64; 2] = [911, 912];

/// Starts a fleet of three robots with all tasks.
async fn fleet(seed: u64) -> Fleet {
    let robot = |name| RobotSpec::carrier(name, "Dock").with_skills(&FAILING_TASKS).with_skill("operate_drawer");
    let robots = ["amber", "birch", "cedar"].map(robot).to_vec();
    let mut fleet = Fleet::hospital_of_domain(seed, robots, &["post"], failing_domain()).await;
    fleet.wait_for_coordinator().await;
    fleet
}

async fn submit(fleet: &Fleet, task: &str) -> MissionId {
    let mission = json!({
        "mission": "try", "roles": { "r1": { "kind": "managed" } },
        "root": { "task": "it", "type": task, "roles": ["r1"], "attempts": 2 },
    });
    let answer = fleet.request_answered(ApiCall::Submit, &json!({ "mission": mission })).await;
    slug(answer["mission"].as_str().unwrap_or_else(|| panic!("{answer}")))
}

/// Returns the cause of the failed mission with its class, the number of attempts, and the robots that tried.
async fn failure(fleet: &mut Fleet, task: &str) -> ((String, CauseClass), usize, BTreeSet<RobotId>) {
    let id = submit(fleet, task).await;
    let MissionState::Failed { cause, class } = fleet.wait_for_end(&id).await else { panic!("seed {}", fleet.seed) };
    let began = |kind: &EventKind| matches!(kind, EventKind::TaskBegan { mission, .. } if *mission == id);
    let attempts = fleet.events().iter().filter(|kind| began(kind)).count();
    let awarded = |kind| match kind {
        EventKind::Awarded { mission, holders, .. } if mission == id => Some(holders.into_values()),
        _ => None,
    };
    ((cause, class), attempts, fleet.events().into_iter().filter_map(awarded).flatten().collect())
}

/// Of three robots and a mission that allows two attempts:
///
/// - a task that no robot can do is tried once;
/// - each robot tries twice where another robot may succeed;
/// - each robot tries once if it lacks what the task needs;
/// - a transient cause is tried four times by each robot, which may get the role again, and the robots give it up
///   five times.
///
/// Afterwards all robots are free.
#[test]
fn the_class_of_the_cause_bounds_the_attempts_of_all_robots() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed).await;
        for (task, attempts, robots, expected, expected_class) in [
            ("fail_task", 1, 1, " as r1 could not do it: fail_task: failed: forbidden: ", CauseClass::Task),
            ("fail_robot", 6, 3, "no robot is left for r1: ", CauseClass::Robot),
            ("fail_precondition", 3, 3, "no robot is left for r1: ", CauseClass::Precondition),
            ("fail_transient", 20, 3, "its roles were given up 5 times: ", CauseClass::Transient),
            ("fail_task", 1, 1, " as r1 could not do it: fail_task: failed: forbidden: ", CauseClass::Task),
        ] {
            let ((cause, class), tried, by) = failure(&mut fleet, task).await;
            assert_eq!((tried, by.len()), (attempts, robots), "seed {seed}, {task}: {cause}");
            assert!(cause.contains(expected), "seed {seed}, {task}: {cause}");
            assert_eq!(class, expected_class, "seed {seed}, {task}: {cause}");
        }
    });
}
