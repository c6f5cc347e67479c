//! Requests of clients and their replies.

use crate::support::{fleet, received_of, task_began};
use consort_fleet::node::NodeSettings;
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::{ApiCall, KeyKind};
use consort_protocol::lease::EndReason;
use consort_tests::{Fleet, RobotSpec, for_each_seed};
use serde_json::{Value, json};
use std::time::Duration;

const SEEDS: [u64; 2] = [91, 92];
const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

/// Starts a fleet in which all carriers are nearly empty, so that no mission can begin.
async fn tired_fleet(seed: u64) -> Fleet {
    let robots = vec![
        RobotSpec::carrier("fern", "Dock").with_charge(0.1),
        RobotSpec::carrier("gorse", "IC Room 4").with_charge(0.1),
    ];
    let mut fleet = Fleet::hospital(seed, robots, &["aster"], &[ROOM]).await;
    fleet.wait_for_coordinator().await;
    fleet
}

fn missions(fleet: &Fleet) -> Option<usize> {
    fleet.ledger(|ledger| ledger.missions().count())
}

#[test]
fn a_repeated_request_gets_the_same_reply_after_a_takeover() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        let first = fleet.submit_with_reply("my-7", ROOM).await;
        assert_eq!(first, json!({ "mission": "lab-samples-1", "again": false }), "seed {seed}");
        let again = json!({ "mission": "lab-samples-1", "again": true });
        assert_eq!(fleet.submit_with_reply("my-7", ROOM).await, again, "seed {seed}");
        fleet.kill("aster").await;
        assert_eq!(fleet.submit_with_reply("my-7", ROOM).await, again, "seed {seed}: after a takeover");
        assert_eq!(missions(&fleet), Some(1), "seed {seed}");
        fleet.assert_completes(&"lab-samples-1".parse().expect("an id")).await;
        let again = json!({ "mission": "lab-samples-1", "again": true, "outcome": "completed" });
        assert_eq!(fleet.submit_with_reply("my-7", ROOM).await, again, "seed {seed}: after the end");
        assert_eq!(missions(&fleet), Some(1), "seed {seed}");
    });
}

/// A request to a large fleet would wake each robot.
#[test]
fn a_request_reaches_the_voters_only() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        let has_beacon = |fleet: &Fleet| received_of(fleet, "gorse", KeyKind::Beacon) > 0;
        fleet.wait_until("a beacon", SOON, has_beacon).await;
        let before = ["basil", "gorse"].map(|node| received_of(&fleet, node, KeyKind::People));
        fleet.submit("a", ROOM).await;
        let after = ["basil", "gorse"].map(|node| received_of(&fleet, node, KeyKind::People));
        assert!(after[0] > before[0], "seed {seed}: basil votes");
        assert_eq!(after[1], before[1], "seed {seed}: gorse does not vote");
    });
}

#[test]
fn an_outcome_is_known_after_many_other_missions() {
    for_each_seed([91], async |seed| {
        let fleet = tired_fleet(seed).await;
        let cancel = async |mission: &MissionId| {
            fleet.request_answered(ApiCall::Cancel, &json!({ "mission": mission, "by": "Nia" })).await;
        };
        let slow = fleet.submit("slow", ROOM).await;
        let early = fleet.submit("early", ROOM).await;
        cancel(&early).await;
        for number in 0..520 {
            cancel(&fleet.submit(&format!("other-{number}"), ROOM).await).await;
        }
        cancel(&slow).await;
        for (request, mission) in [("slow", &slow), ("early", &early)] {
            let outcome = json!({ "canceled": { "by": "Nia" } });
            let got = fleet.request_answered(ApiCall::Get, &json!({ "mission": mission })).await;
            assert_eq!((&got["detail"], &got["request"]), (&outcome, &json!(request)), "seed {seed}");
            let again = json!({ "mission": mission, "again": true, "outcome": outcome });
            assert_eq!(fleet.submit_with_reply(request, ROOM).await, again, "seed {seed}");
        }
        assert_eq!(missions(&fleet), Some(500), "seed {seed}");
        let explained = fleet.request_answered(ApiCall::Explain, &json!({ "mission": early })).await;
        let error = format!("mission {early} is canceled; it ended long ago, and its auctions are no longer stored");
        assert_eq!(explained["error"], error, "seed {seed}");
    });
}

#[test]
fn a_fleet_limits_its_active_missions() {
    for_each_seed(SEEDS, async |seed| {
        let robots = vec![RobotSpec::carrier("fern", "Dock").with_charge(0.1)];
        let adjust = Box::new(|settings: &mut NodeSettings| settings.fleet.request_limits.missions_max = 2);
        let mut fleet = Fleet::adjusted_hospital(seed, robots, &["aster"], &[ROOM], adjust).await;
        fleet.wait_for_coordinator().await;
        for (request, mission) in [("a", "lab-samples-1"), ("b", "lab-samples-2")] {
            assert_eq!(fleet.submit_with_reply(request, ROOM).await["mission"], mission, "seed {seed}");
        }
        let request = json!({ "mission": "lab-samples", "parameters": { "room": ROOM }, "request": "c" });
        let refused = fleet.request(ApiCall::Submit, &request).await.expect("a reply");
        let expected = "2 missions are active, the maximum of this fleet";
        assert_eq!(refused, json!({ "error": expected, "retry_after_ms": 300 }), "seed {seed}");
        let again = json!({ "mission": "lab-samples-2", "again": true });
        assert_eq!(fleet.submit_with_reply("b", ROOM).await, again, "seed {seed}: what was taken on is answered again");
        fleet.request(ApiCall::Cancel, &json!({ "mission": "lab-samples-1", "by": "Nia" })).await.expect("a reply");
        assert_eq!(fleet.submit_with_reply("c", ROOM).await["mission"], "lab-samples-3", "seed {seed}");
    });
}

#[test]
fn a_rate_limited_client_is_served_after_its_delay() {
    for_each_seed(SEEDS, async |seed| {
        let robots = vec![RobotSpec::carrier("fern", "Dock").with_charge(0.1)];
        let adjust = Box::new(|settings: &mut NodeSettings| settings.fleet.request_limits.requests_per_s = 1);
        let mut fleet = Fleet::adjusted_hospital(seed, robots, &["aster"], &[ROOM], adjust).await;
        fleet.wait_for_coordinator().await;
        let request = json!({ "mission": "lab-samples", "parameters": { "room": ROOM }, "request": "a" });
        let mut refused = None;
        for _ in 0..20 {
            let answer = fleet.request(ApiCall::Submit, &request).await.expect("a reply");
            refused = answer["retry_after_ms"].as_u64().or(refused);
        }
        let after = refused.expect("twenty in an instant are more than five");
        assert!((1..=1000).contains(&after), "seed {seed}: {after}");
        tokio::time::sleep(Duration::from_millis(after)).await;
        let answer = fleet.request(ApiCall::Submit, &request).await.expect("a reply");
        assert_eq!(answer, json!({ "mission": "lab-samples-1", "again": true }), "seed {seed}");
    });
}

#[test]
fn the_next_coordinator_repeats_a_lost_reply() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        fleet.network.cut("aster".parse().expect("a name"), "client".parse().expect("a name"));
        let request = json!({ "mission": "lab-samples", "parameters": { "room": ROOM }, "request": "my-7" });
        let answer = fleet.request(ApiCall::Submit, &request).await;
        assert_eq!(answer, None, "seed {seed}: the reply was lost");
        assert_eq!(missions(&fleet), Some(1), "seed {seed}: and the mission committed");
        fleet.kill("aster").await;
        fleet.heal();
        let answer = fleet.submit_with_reply("my-7", ROOM).await;
        assert_eq!(answer, json!({ "mission": "lab-samples-1", "again": true }), "seed {seed}");
        assert_eq!(missions(&fleet), Some(1), "seed {seed}");
        let mission = "lab-samples-1".parse().expect("an id");
        fleet.assert_completes(&mission).await;
        fleet.assert_each_task_once(&mission);
    });
}

#[test]
fn an_invalid_request_is_rejected_with_a_hint() {
    for_each_seed(SEEDS, async |seed| {
        let fleet = fleet(seed, ROOM).await;
        let cases: [(ApiCall, &str, &[&str]); 10] = [
            (ApiCall::Submit, "{", &["an example is", "vital-signs"]),
            (ApiCall::Submit, "", &["an example is"]),
            (ApiCall::Submit, r#"{"mision": "lab-samples"}"#, &["unknown field `mision`", "expected one of `mission`"]),
            (
                ApiCall::Submit,
                r#"{"mission": "tea"}"#,
                &[
                    "\"tea\"",
                    "bed-transfer, food-logistics, lab-samples, lab-samples-watched, vital-signs, ward-disinfection",
                ],
            ),
            (ApiCall::Submit, r#"{"mission": "lab-samples", "parameters": {"romm": "IC Room 6"}}"#, &["romm", "room"]),
            (
                ApiCall::Submit,
                r#"{"mission": "lab-samples", "parameters": {"room": "IC Rom 6"}}"#,
                &[
                    "parameters/room: `room` is the place \"IC Rom 6\", which is not on the fleet's map; allowed: ",
                    "did you mean `IC Room 6`?",
                ],
            ),
            (
                ApiCall::Submit,
                r#"{"mission": {"mission": "visit", "roles": {"r1": {"kind": "managed"}}, "root": {"task": "go",
                    "type": "navigation", "roles": ["r1"], "parameters": {"to": "labratory"}}}}"#,
                &[
                    "root: `to` is the place \"labratory\", which is not on the fleet's map",
                    "did you mean `Laboratory`?",
                ],
            ),
            (ApiCall::Submit, r#"{"mission": "lab-samples", "request": "a b/c*"}"#, &["a b/c*"]),
            (ApiCall::Cancel, r#"{"mission": "lab-samples-9"}"#, &["no mission lab-samples-9"]),
            (ApiCall::Get, r#"{"mission": "lab-samples-9"}"#, &["no mission lab-samples-9"]),
        ];
        for (call, payload, expected) in cases {
            let answer = fleet.request_raw(call, payload).await;
            let answer = answer.unwrap_or_else(|| panic!("seed {seed}: no reply to {payload}"));
            let error = answer["error"].as_str().unwrap_or_else(|| panic!("seed {seed}: {payload} got {answer}"));
            for part in expected {
                assert!(error.contains(part), "seed {seed}: {payload} got {error:?}, without {part:?}");
            }
        }
        assert_eq!(missions(&fleet), Some(0), "seed {seed}");
        assert!(
            !fleet.has_event(|what| matches!(what, EventKind::Submitted { .. })),
            "seed {seed}\n{}",
            fleet.event_log_text()
        );
    });
}

#[test]
fn a_mission_canceled_while_it_waits_is_never_begun() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = tired_fleet(seed).await;
        let mission = fleet.submit("a", ROOM).await;
        let answer = fleet.request_answered(ApiCall::Cancel, &json!({ "mission": mission, "by": "a nurse" })).await;
        let state = json!({ "canceled": { "by": "a nurse" } });
        assert_eq!(answer, json!({ "mission": mission, "state": state }), "seed {seed}");
        assert_eq!(fleet.wait_for_end(&mission).await.as_str(), "canceled", "seed {seed}");
        let called = |what: &EventKind| matches!(what, EventKind::BidsRequested { .. });
        let calls = fleet.event_log.count(called);
        fleet.assert_never("a call", Duration::from_secs(10), |fleet| fleet.event_log.count(called) > calls).await;
        assert!(fleet.task_counts(&mission).is_empty(), "seed {seed}\n{}", fleet.event_log_text());
    });
}

#[test]
fn a_mission_canceled_under_way_stops_its_robots_and_frees_them() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        let mission = fleet.submit("a", ROOM).await;
        let began = task_began("navto_room");
        fleet.wait_until("the way to the room", SOON, |fleet| fleet.has_event(&began)).await;
        let robot = fleet.holder(&mission, "r1").expect("held").to_string();
        fleet.request_answered(ApiCall::Cancel, &json!({ "mission": mission })).await;
        let halted = |what: &EventKind| matches!(what, EventKind::Halted { reason: EndReason::Canceled, .. });
        fleet.wait_until("both to halt", Duration::from_secs(2), |fleet| fleet.event_log.count(halted) == 2).await;
        fleet.wait_for_rest(&robot).await;
        let place = fleet.position(&robot);
        for who in [robot.as_str(), "lab-arm"] {
            let name = format!("robot/{who}");
            let free = async |fleet: &Fleet| {
                let views = fleet.view(&name).await;
                (views[&name]["robot"]["availability"] == "free").then_some(())
            };
            fleet.poll_until(&format!("{who} free"), Duration::from_secs(3), free).await;
        }
        assert_eq!(fleet.position(&robot), place, "seed {seed}: it stands still");
        let begun = fleet.task_counts(&mission);
        fleet
            .assert_never("anything of the mission", Duration::from_secs(10), |fleet| {
                fleet.task_counts(&mission) != begun
            })
            .await;

        // Another cancellation is an error and changes nothing.
        let answer = fleet.request_answered(ApiCall::Cancel, &json!({ "mission": mission, "by": "a late one" })).await;
        let error = answer["error"].as_str().expect("an error");
        assert!(error.contains(mission.as_str()) && error.contains("canceled"), "seed {seed}: {error}");
        let got = fleet.request_answered(ApiCall::Get, &json!({ "mission": mission })).await;
        assert_eq!(got["detail"], json!({ "canceled": { "by": "a client" } }), "seed {seed}");
    });
}

#[test]
fn missions_can_be_listed_and_read_individually() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        assert_eq!(fleet.request_answered(ApiCall::List, &Value::Null).await["missions"], json!([]), "seed {seed}");
        let mission = fleet.submit("my-7", ROOM).await;
        fleet.assert_completes(&mission).await;
        let list = fleet.request_answered(ApiCall::List, &Value::Null).await;
        let brief = &list["missions"][0];
        assert_eq!(brief["mission"], json!(mission), "seed {seed}: {list}");
        assert_eq!((&brief["state"], &brief["done"]), (&json!("completed"), &brief["steps"]), "seed {seed}");
        assert_eq!(brief["holders"], json!({ "lab_arm": "lab-arm", "r1": "gorse" }), "seed {seed}");
        let got = fleet.request_answered(ApiCall::Get, &json!({ "mission": mission })).await;
        assert_eq!((&got["request"], &got["number"]), (&json!("my-7"), &json!(1)), "seed {seed}");
        let ageless = |view: &Value| {
            let mut view = view.clone();
            (view["age_ms"], view["at_ms"]) = (Value::Null, Value::Null);
            view["ledger"]["age_ms"] = Value::Null;
            view
        };
        let views = fleet.view(&format!("mission/{mission}")).await;
        assert_eq!(
            ageless(&views[&format!("mission/{mission}")]),
            ageless(&got),
            "seed {seed}: both ways of looking agree"
        );
        let answer = fleet.request_answered(ApiCall::Cancel, &json!({ "mission": mission })).await;
        let error = answer["error"].as_str().expect("an error");
        assert!(error.contains("completed"), "seed {seed}: {error}");
    });
}
