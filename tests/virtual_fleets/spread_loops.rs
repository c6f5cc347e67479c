//! Spread loops: robots share the iterations of a loop of one mission.

use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RobotId};
use consort_protocol::keys::ApiCall;
use consort_protocol::message::FailureKind;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::Duration;

const SEEDS: [u64; 3] = [91, 92, 93];
const SOON: Duration = Duration::from_secs(120);
const ROOMS: [&str; 8] =
    ["PC Room 1", "PC Room 2", "PC Room 3", "PC Room 4", "PC Room 5", "PC Room 6", "PC Room 7", "PC Room 8"];

async fn fleet(seed: u64, carriers: &[&str], stations: &[&str]) -> Fleet {
    let places = ["Dock", "IC Room 4", "PC Room 8"];
    let robots = carriers.iter().zip(places.into_iter().cycle());
    let robots = robots.map(|(name, place)| RobotSpec::carrier(name, place).with_skill("wait"));
    let mut fleet = Fleet::hospital(seed, robots.collect(), stations, &[]).await;
    fleet.wait_for_coordinator().await;
    fleet
}

/// Returns a request for a visit of all rooms by any robots, after which one of another role reports.
fn visit_rooms(request: &str, rooms: &[&str]) -> Value {
    let managed = json!({ "kind": "managed" });
    let go = json!({ "task": "go", "type": "navigation", "roles": ["visitor"], "parameters": { "to": "${room}" } });
    let look = json!({ "task": "look", "type": "wait", "roles": ["visitor"], "parameters": { "seconds": "5" } });
    let visit = json!({ "task": "visit", "method": "sequential", "tasks": [go, look] });
    let rounds = json!({ "task": "rounds", "for": "room", "in": rooms, "spread": true, "do": visit });
    let report = json!({ "task": "report", "type": "wait", "roles": ["head"], "parameters": { "seconds": "1" } });
    let mission = json!({
        "mission": "visit-rooms", "roles": { "visitor": managed, "head": managed },
        "root": { "task": "all", "method": "sequential", "tasks": [rounds, report] },
    });
    json!({ "mission": mission, "request": request })
}

async fn submit(fleet: &Fleet, request: &str, rooms: &[&str]) -> MissionId {
    let answer = fleet.request_answered(ApiCall::Submit, &visit_rooms(request, rooms)).await;
    slug(answer["mission"].as_str().unwrap_or_else(|| panic!("{answer}")))
}

/// Matches the beginning of a task of the loop.
fn iteration_began(what: &EventKind) -> bool {
    matches!(what, EventKind::TaskBegan { task, .. } if task.as_str().starts_with("go_"))
}

/// Returns the number of rooms that each robot has visited last.
fn rooms_by_robot(fleet: &Fleet, mission: &MissionId) -> BTreeMap<RobotId, usize> {
    let holders = fleet.ledger(|ledger| ledger.mission(mission).map(|entry| entry.holders())).flatten();
    let mut counts = BTreeMap::new();
    for (_, robot) in holders.expect("the mission").into_iter().filter(|(role, _)| role.as_str() != "head") {
        *counts.entry(robot).or_default() += 1;
    }
    counts
}

#[test]
fn three_robots_share_eight_rooms() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, &["amber", "birch", "fern"], &["aba"]).await;
        let mission = submit(&fleet, "a", &ROOMS).await;
        fleet.wait_until("two robots to start", SOON, |fleet| fleet.event_log.count(iteration_began) >= 2).await;
        let view = serde_json::to_string(&fleet.view(&format!("mission/{mission}")).await).expect("JSON");
        assert!(view.contains(r#""state":"running""#), "seed {seed}: {view}");
        fleet.assert_completes(&mission).await;
        fleet.assert_each_task_once(&mission);
        fleet.assert_exclusive_roles();
        let rooms = rooms_by_robot(&fleet, &mission);
        assert_eq!(rooms.values().sum::<usize>(), ROOMS.len(), "seed {seed}: {rooms:?}");
        assert!(rooms.len() == 3 && rooms.values().all(|rooms| *rooms <= 4), "seed {seed}: {rooms:?}");
    });
}

#[test]
fn a_single_robot_visits_all_rooms_and_then_reports() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, &["amber", "birch"], &["aba"]).await;
        fleet.kill("birch").await;
        let mission = submit(&fleet, "a", &ROOMS[..3]).await;
        fleet.assert_completes(&mission).await;
        fleet.assert_each_task_once(&mission);
    });
}

#[test]
fn lost_robots_and_coordinators_cost_no_room() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, &["amber", "birch", "fern", "gorse"], &["aba", "bab", "cab"]).await;
        let mission = submit(&fleet, "a", &ROOMS).await;
        fleet.wait_until("three robots to start", SOON, |fleet| fleet.event_log.count(iteration_began) >= 3).await;
        let lost: RobotId = rooms_by_robot(&fleet, &mission).into_keys().next().expect("a robot");
        fleet.kill(lost.as_str()).await;
        fleet.kill_coordinator().await;
        fleet.assert_completes(&mission).await;
        fleet.assert_exclusive_roles();
        let counts = fleet.task_counts(&mission);
        for number in 1..=ROOMS.len() {
            let (_, ended) = counts.get(&format!("look_{number}")).copied().unwrap_or_default();
            assert_eq!(ended, 1, "seed {seed}: look_{number}\n{}", fleet.event_log_text());
        }
    });
}

/// Two missions share the robots: the first has the better rank, and the second gets what the first leaves.
#[test]
fn missions_with_spread_loops_share_robots() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, &["amber", "birch", "fern"], &["aba"]).await;
        let first = submit(&fleet, "a", &ROOMS[..4]).await;
        let second = submit(&fleet, "b", &ROOMS[4..]).await;
        for mission in [&first, &second] {
            fleet.assert_completes(mission).await;
            fleet.assert_each_task_once(mission);
        }
        fleet.assert_exclusive_roles();
        let released = fleet.event_log.count(|what| matches!(what, EventKind::Released { .. }));
        assert_eq!(released, 0, "seed {seed}:\n{}", fleet.event_log_text());
    });
}

/// The first visitor is lost on its way, while the second waits for the head, which waits for the first. The only other
/// robot returns the second visit, makes the first, and then the second.
#[test]
fn a_robot_that_waits_for_a_lost_visitor_takes_its_visit() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, &["amber", "birch", "fern"], &["aba"]).await;
        let mut request = visit_rooms("a", &["100", "1"]);
        let visit = &mut request["mission"]["root"]["tasks"][0]["do"]["tasks"];
        visit[0] =
            json!({ "task": "go", "type": "wait", "roles": ["visitor"], "parameters": { "seconds": "${room}" } });
        visit[1]["roles"] = json!(["visitor", "head"]);
        let answer = fleet.request_answered(ApiCall::Submit, &request).await;
        let mission: MissionId = slug(answer["mission"].as_str().unwrap_or_else(|| panic!("{answer}")));
        let has_arrived =
            |what: &EventKind| matches!(what, EventKind::TaskEnded { task, .. } if task.as_str() == "go_2");
        fleet.wait_until("the second visitor to wait", SOON, |fleet| fleet.has_event(has_arrived)).await;
        let lost = fleet.holder(&mission, "visitor_1").expect("a holder");
        fleet.kill(lost.as_str()).await;
        fleet.assert_completes(&mission).await;
        fleet.assert_exclusive_roles();
        let gave_way = |what: &EventKind| matches!(what, EventKind::GaveUp { kind: FailureKind::GaveWay, .. });
        assert_eq!(fleet.event_log.count(gave_way), 1, "seed {seed}:\n{}", fleet.event_log_text());
    });
}

/// The head takes part in the visit of each room, so the visits follow the order of the list. The only other robot
/// starts with the first room, also if the second is nearer.
#[test]
fn a_single_robot_visits_rooms_in_the_order_of_a_role_outside_the_loop() {
    for_each_seed(SEEDS, async |seed| {
        for rooms in [["PC Room 1", "IC Room 6"], ["IC Room 6", "PC Room 1"]] {
            let mut fleet = fleet(seed, &["amber", "birch"], &["aba"]).await;
            let mut request = visit_rooms("a", &rooms);
            let rounds = &mut request["mission"]["root"]["tasks"][0];
            rounds["do"]["tasks"][1]["roles"] = json!(["visitor", "head"]);
            let answer = fleet.request_answered(ApiCall::Submit, &request).await;
            let mission: MissionId = slug(answer["mission"].as_str().unwrap_or_else(|| panic!("{answer}")));
            fleet.assert_completes(&mission).await;
            fleet.assert_exclusive_roles();
        }
    });
}
