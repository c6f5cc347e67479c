//! People hold robots and take them out of service.

use crate::support::{
    assert_completes_by, audited_changes, drive_to_room, longer_than_a_lease, released, request, slow_fleet,
};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RobotId};
use consort_protocol::keys::ApiCall;
use consort_protocol::knowledge::Availability;
use consort_protocol::ledger::RobotOrders;
use consort_tests::{Fleet, for_each_seed, slug};
use serde_json::{Value, json};
use std::time::Duration;

const ROOM: &str = "IC Room 6";
const OTHER: &str = "IC Room 5";
/// The dock of `fern`, and a place through which `gorse` drives to the rooms.
const ZONE: &str = "entrance";
const SOON: Duration = Duration::from_secs(60);

async fn hold(fleet: &Fleet, robots: Value, for_s: u32) -> Value {
    let payload = json!({ "robots": robots, "for_s": for_s, "reason": "a spill", "by": "Nia" });
    request(fleet, ApiCall::Hold, &payload).await
}

async fn release(fleet: &Fleet, robots: Value) {
    request(fleet, ApiCall::Release, &json!({ "robots": robots, "by": "Abe" })).await;
}

async fn maintenance(fleet: &Fleet, payload: Value) {
    request(fleet, ApiCall::Maintenance, &payload).await;
}

/// Longer than any step of these robots.
const STALL_AFTER: Duration = Duration::from_secs(60);

async fn fleet(seed: u64) -> Fleet {
    slow_fleet(seed, &[ROOM, OTHER], STALL_AFTER, (ZONE, &["Dock", "Crossing"])).await
}

/// Starts a mission. Returns the carrier that drives to the room.
async fn under_way(seed: u64) -> (Fleet, MissionId, String) {
    let mut fleet = fleet(seed).await;
    let (mission, carrier) = drive_to_room(&mut fleet, ROOM).await;
    let start = fleet.position(&carrier);
    fleet.wait_until("a move", SOON, |fleet| fleet.position(&carrier) != start).await;
    (fleet, mission, carrier)
}

/// Asserts that a robot stands still and starts no goal, and that no role is released.
async fn assert_held(fleet: &mut Fleet, robot: &str, during: Duration) {
    let (place, goals) = (fleet.position(robot), fleet.goal_counts(robot));
    let changed = |fleet: &Fleet| {
        fleet.position(robot) != place || fleet.goal_counts(robot) != goals || fleet.has_event(released)
    };
    fleet.assert_never("a move, a goal or a release", during, changed).await;
}

/// Asserts that a robot that stood still drives again, and completes the mission under its first award.
async fn assert_goes_on(fleet: &mut Fleet, mission: &MissionId, robot: &str, within: Duration) {
    let place = fleet.position(robot);
    fleet.wait_until("a move", within, |fleet| fleet.position(robot) != place).await;
    assert_completes_by(fleet, mission, ROOM, robot).await;
}

#[test]
fn a_held_robot_stands_still_at_once_and_keeps_its_role_until_its_release() {
    for_each_seed([1201, 1202, 1203], async |seed| {
        let (mut fleet, mission, carrier) = under_way(seed).await;
        let reply = hold(&fleet, json!([carrier]), 600).await;
        let order = &reply["robots"][&carrier]["hold"];
        assert_eq!((&order["by"], &order["reason"]), (&json!("Nia"), &json!("a spill")), "seed {seed}");
        fleet.wait_for_rest(&carrier).await;
        assert_held(&mut fleet, &carrier, longer_than_a_lease()).await;
        release(&fleet, json!([carrier])).await;
        assert_goes_on(&mut fleet, &mission, &carrier, Duration::from_secs(2)).await;
        let orders = fleet.events().into_iter().filter_map(|what| match what {
            EventKind::RobotOrders { robot, orders: RobotOrders { hold, .. } } => Some((robot, hold.is_some())),
            _ => None,
        });
        let robot: RobotId = slug(&carrier);
        assert_eq!(orders.collect::<Vec<_>>(), [(robot.clone(), true), (robot, false)], "seed {seed}");
    });
}

#[test]
fn the_next_coordinator_keeps_a_robot_held() {
    for_each_seed([1211, 1212, 1213], async |seed| {
        let (mut fleet, mission, carrier) = under_way(seed).await;
        hold(&fleet, json!([carrier]), 600).await;
        fleet.wait_for_rest(&carrier).await;
        assert_eq!(fleet.kill_coordinator().await.as_str(), "aster", "seed {seed}");
        assert_held(&mut fleet, &carrier, longer_than_a_lease()).await;
        fleet.wait_for_coordinator().await;
        release(&fleet, json!([carrier])).await;
        assert_goes_on(&mut fleet, &mission, &carrier, Duration::from_secs(2)).await;
        let changes = audited_changes(&fleet).await;
        let expected = json!([["a client", "submit", mission], ["Nia", "hold", carrier], ["Abe", "release", carrier]]);
        assert_eq!(json!(changes), expected, "seed {seed}");
    });
}

/// The coordinator does not treat a held robot as a robot without progress.
#[test]
fn a_robot_keeps_its_role_in_a_long_hold() {
    for_each_seed([1215, 1216], async |seed| {
        let (mut fleet, mission, carrier) = under_way(seed).await;
        hold(&fleet, json!([carrier]), 600).await;
        fleet.wait_for_rest(&carrier).await;
        assert_held(&mut fleet, &carrier, STALL_AFTER * 2).await;
        release(&fleet, json!([carrier])).await;
        assert_goes_on(&mut fleet, &mission, &carrier, Duration::from_secs(2)).await;
    });
}

#[test]
fn a_hold_ends_at_its_time() {
    for_each_seed([1221, 1222], async |seed| {
        let (mut fleet, mission, carrier) = under_way(seed).await;
        hold(&fleet, json!([carrier]), 30).await;
        fleet.wait_for_rest(&carrier).await;
        assert_held(&mut fleet, &carrier, Duration::from_secs(25)).await;
        assert_goes_on(&mut fleet, &mission, &carrier, Duration::from_secs(6)).await;
        let held = fleet.ledger(|ledger| ledger.robot_orders().count());
        assert_eq!(held, Some(0), "seed {seed}: the ledger has forgotten the hold");
    });
}

#[test]
fn a_held_robot_stands_still_after_a_restart_of_its_node() {
    for_each_seed([1231, 1232, 1233], async |seed| {
        let (mut fleet, mission, carrier) = under_way(seed).await;
        hold(&fleet, json!([carrier]), 600).await;
        fleet.wait_for_rest(&carrier).await;
        fleet.kill(&carrier).await;
        fleet.restart(&carrier).await;
        assert_held(&mut fleet, &carrier, longer_than_a_lease()).await;
        release(&fleet, json!([carrier])).await;
        assert_goes_on(&mut fleet, &mission, &carrier, Duration::from_secs(4)).await;
    });
}

/// The robot learns of the hold with the renewal of its lease, before it may act again.
#[test]
fn a_robot_that_was_cut_off_is_held_when_it_is_back() {
    for_each_seed([1241, 1242, 1243], async |seed| {
        let (mut fleet, mission, carrier) = under_way(seed).await;
        fleet.cut_off(&[&carrier]);
        let suspended = |what: &EventKind| matches!(what, EventKind::Suspended { .. });
        fleet.wait_for_next("the suspension", SOON, suspended).await;
        fleet.wait_for_rest(&carrier).await;
        hold(&fleet, json!([carrier]), 600).await;
        fleet.heal();
        assert_held(&mut fleet, &carrier, longer_than_a_lease()).await;
        release(&fleet, json!([carrier])).await;
        assert_goes_on(&mut fleet, &mission, &carrier, Duration::from_secs(4)).await;
    });
}

#[test]
fn a_hold_of_all_robots_stops_each_of_them_and_none_takes_a_role() {
    for_each_seed([1251, 1252], async |seed| {
        let (mut fleet, mission, carrier) = under_way(seed).await;
        let other = if carrier == "gorse" { "fern" } else { "gorse" };
        let reply = hold(&fleet, json!("all"), 600).await;
        assert_eq!(reply["robots"].as_object().map(serde_json::Map::len), Some(3), "seed {seed}: {reply}");
        fleet.wait_for_rest(&carrier).await;
        let second = fleet.submit("b", OTHER).await;
        let goals = fleet.goal_counts(other);
        assert_held(&mut fleet, &carrier, longer_than_a_lease()).await;
        assert_eq!((fleet.goal_counts(other), fleet.holder(&second, "r1")), (goals, None), "seed {seed}");
        let explained = fleet.request_answered(ApiCall::Explain, &json!({ "mission": second })).await;
        let text = explained["text"].to_string();
        assert!(text.contains(other) && text.contains("held by Nia: a spill"), "seed {seed}: {text}");
        release(&fleet, json!("all")).await;
        assert_goes_on(&mut fleet, &mission, &carrier, Duration::from_secs(2)).await;
        fleet.assert_completes(&second).await;
    });
}

#[test]
fn a_hold_of_a_zone_holds_the_robots_that_are_in_it_now() {
    for_each_seed([1255, 1256], async |seed| {
        let mut fleet = fleet(seed).await;
        fleet.wait_for_audit_trail().await;
        let known = |fleet: &Fleet| fleet.knowledge_of("aster", &slug("fern")).is_some();
        fleet.wait_until("the record of fern", SOON, known).await;
        let reply = hold(&fleet, json!({ "zone": ZONE }), 3600).await;
        let held = reply["robots"].as_object().map(|robots| robots.keys().cloned().collect::<Vec<_>>());
        assert_eq!(held, Some(vec!["fern".to_owned()]), "seed {seed}: {reply}");
        let place = fleet.position("fern");
        let mission = fleet.submit("a", ROOM).await;
        fleet.assert_completes(&mission).await;
        assert_eq!(fleet.position("fern"), place, "seed {seed}");
        // It has entered the zone since.
        assert_eq!(fleet.holder(&mission, "r1").expect("held").as_str(), "gorse", "seed {seed}");
        release(&fleet, json!({ "zone": ZONE })).await;
        let is_released = |fleet: &Fleet| fleet.ledger(|ledger| ledger.robot_orders().count()) == Some(0);
        fleet.wait_until("the release", SOON, is_released).await;
    });
}

#[test]
fn a_robot_in_maintenance_finishes_its_role_and_takes_no_other() {
    for_each_seed([1261, 1262], async |seed| {
        let (mut fleet, mission, carrier) = under_way(seed).await;
        let begin = json!({ "robots": [carrier], "action": "begin", "reason": "new tyres", "by": "Nia" });
        maintenance(&fleet, begin).await;
        fleet.assert_completes(&mission).await;
        fleet.assert_sample_delivered(ROOM);
        assert_eq!(fleet.event_log.count(released), 0, "seed {seed}\n{}", fleet.event_log_text());
        let published = |fleet: &Fleet| {
            let worker = fleet.knowledge_of("basil", &slug(&carrier));
            worker.is_some_and(|worker| {
                let problem = "in maintenance by Nia: new tyres";
                worker.availability == Availability::OutOfService { problem: problem.to_owned() }
            })
        };
        fleet.wait_until("its record", SOON, published).await;
        let place = fleet.position(&carrier);
        let second = fleet.submit("b", OTHER).await;
        fleet.assert_completes(&second).await;
        assert_eq!(fleet.position(&carrier), place, "seed {seed}: the other carrier did it");
        assert_ne!(fleet.holder(&second, "r1").expect("held").as_str(), carrier, "seed {seed}");
        maintenance(&fleet, json!({ "robots": [carrier], "action": "end", "by": "Nia" })).await;
        let is_free = |fleet: &Fleet| {
            fleet.knowledge_of("basil", &slug(&carrier)).is_some_and(|robot| robot.availability == Availability::Free)
        };
        fleet.wait_until("its return to service", SOON, is_free).await;
    });
}

#[test]
fn an_order_to_an_unknown_robot_is_rejected() {
    for_each_seed([1271], async |seed| {
        let fleet = fleet(seed).await;
        for (call, payload, expected) in [
            (ApiCall::Hold, json!({ "robots": ["ferm"] }), "there is no robot ferm; there are "),
            (ApiCall::Release, json!({ "robots": ["fern", "ferm"] }), "there is no robot ferm; there are "),
            (
                ApiCall::Hold,
                json!({ "robots": { "zone": "exit" } }),
                "there is no zone exit in the fleet file; allowed: ",
            ),
            (ApiCall::Hold, json!({ "robots": ["fern"], "for_s": 0 }), "for_s is 0; allowed are 1 to 86400"),
            (
                ApiCall::Maintenance,
                json!({ "robots": "all", "action": "begin" }),
                "the action `begin` needs a `reason`",
            ),
        ] {
            let reply = fleet.request_answered(call, &payload).await;
            let error = reply["error"].as_str().unwrap_or_default();
            assert!(error.starts_with(expected), "seed {seed}: {payload}: {reply}");
        }
        let orders = fleet.ledger(|ledger| ledger.robot_orders().count());
        assert_eq!(orders, Some(0), "seed {seed}");
    });
}

/// Maintenance has no end, so its order would stay in the ledger.
#[test]
fn orders_to_a_robot_end_when_it_leaves_the_fleet() {
    for_each_seed([1391, 1392], async |seed| {
        let mut fleet = fleet(seed).await;
        fleet.wait_for_audit_trail().await;
        let begin = json!({ "robots": ["fern", "gorse"], "action": "begin", "reason": "tyres", "by": "Nia" });
        maintenance(&fleet, begin).await;
        fleet.leave("gorse").await;
        let ordered = |fleet: &Fleet| {
            fleet.ledger(|ledger| ledger.robot_orders().map(|(robot, _)| robot.to_string()).collect::<Vec<_>>())
        };
        let is_over = |fleet: &Fleet| ordered(fleet).is_some_and(|ordered| ordered == ["fern"]);
        fleet.wait_until("the end of its orders", SOON, is_over).await;
    });
}

/// A client repeats a request for which it got no reply.
#[test]
fn a_repeated_hold_is_executed_once() {
    for_each_seed([1395, 1396], async |seed| {
        let mut fleet = fleet(seed).await;
        fleet.wait_for_audit_trail().await;
        let hold = json!({ "robots": ["fern"], "for_s": 600, "by": "Nia", "request": "order-7" });
        let first = request(&fleet, ApiCall::Hold, &hold).await;
        let from = fleet.elapsed();
        let is_later = |fleet: &Fleet| fleet.elapsed() >= from + Duration::from_secs(2);
        fleet.wait_until("another time of the request", SOON, is_later).await;
        assert_eq!(request(&fleet, ApiCall::Hold, &hold).await, first, "seed {seed}: its end is the same");
        let trail = request(&fleet, ApiCall::Audit, &json!({ "linearizable": true })).await;
        assert_eq!(trail["entries"].as_array().map(Vec::len), Some(1), "seed {seed}: {trail}");
    });
}
