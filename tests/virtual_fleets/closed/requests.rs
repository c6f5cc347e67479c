//! Requests of people: they are signed, and neither a copy nor the key of a robot makes them.

use super::{ROOM, SEEDS, SOON, closed, refused, replies, stolen};
use crate::support::{audited_changes, request};
use bytes::Bytes;
use consort_bus::SharedBus;
use consort_protocol::event::EventKind;
use consort_protocol::keys::{ApiCall, Key};
use consort_protocol::ledger::Ledger;
use consort_protocol::trust::NodeRole;
use consort_tests::{Fleet, RobotSpec, StolenKey, for_each_seed, slug};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::time::Duration;

/// Returns a request for a schedule with no occurrence during a test.
fn yearly(schedule: &str) -> Value {
    let submit = json!({ "mission": "lab-samples", "parameters": { "room": ROOM } });
    json!({ "schedule": schedule, "action": "add", "cron": "0 12 1 6 *", "submit": submit })
}

#[test]
fn the_key_of_a_robot_changes_neither_missions_nor_nodes() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        let StolenKey { signing, plain } = stolen(&fleet, "fern", NodeRole::Robot).await;
        let signing: SharedBus = signing;
        // The robot relays a person's requests, and keeps them.
        let mut relayed = plain.serve("consort/ward/api/*").await.expect("a network");
        let mission = fleet.submit("a", ROOM).await;
        let signed = relayed.recv().await.expect("a request");
        assert!(!signed.attachment.is_empty(), "seed {seed}");

        let keys = fleet.keys().clone();
        let order = json!({ "mission": "lab-samples", "parameters": { "room": ROOM }, "request": "stolen" });
        let cancel = json!({ "mission": mission, "by": "fern" });
        let attacks = [
            (keys.write(&Key::Api(ApiCall::Submit)), order),
            (keys.write(&Key::Api(ApiCall::Cancel)), cancel.clone()),
            (keys.write(&Key::Api(ApiCall::CancelMissions)), json!({ "missions": [mission] })),
            (keys.write(&Key::Api(ApiCall::CancelMissions)), json!({ "missions": { "where": "true" } })),
            (keys.write(&Key::Api(ApiCall::Priority)), json!({ "mission": mission, "priority": 1 })),
            (keys.write(&Key::Api(ApiCall::Reassign)), json!({ "mission": mission, "role": "r1" })),
            (keys.write(&Key::Api(ApiCall::Resolve)), cancel),
            (keys.write(&Key::Api(ApiCall::Answer)), json!({ "request": format!("{mission}.1"), "answer": "done" })),
            (keys.write(&Key::Api(ApiCall::Schedule)), yearly("stolen")),
            (keys.write(&Key::Api(ApiCall::Hold)), json!({ "robots": "all" })),
            (keys.write(&Key::Api(ApiCall::Release)), json!({ "robots": "all" })),
            (
                keys.write(&Key::Api(ApiCall::Maintenance)),
                json!({ "robots": "all", "action": "begin", "reason": "stolen" }),
            ),
            (keys.write(&Key::Api(ApiCall::Close)), json!({ "places": ["Dock"], "reason": "stolen" })),
            (keys.write(&Key::Api(ApiCall::Open)), json!({ "places": ["Dock"] })),
            (keys.write(&Key::Api(ApiCall::Limit)), json!({ "places": ["Dock"], "action": "set", "speed_mps": 0.1 })),
            (keys.write(&Key::Api(ApiCall::Limit)), json!({ "places": ["Dock"], "action": "clear" })),
            (keys.write(&Key::Api(ApiCall::Alarm)), json!({ "action": "raise", "alarm": "freeze" })),
            (keys.write(&Key::Api(ApiCall::Alarm)), json!({ "action": "clear" })),
            (keys.write(&Key::Api(ApiCall::Backup)), json!({})),
            (keys.write(&Key::Api(ApiCall::Upgrade)), json!({ "finish": true })),
            (keys.write(&Key::Leave("clove".parse().expect("a name"))), json!({})),
            ("consort/ward/api/leave/*".to_owned(), json!({})),
            ("consort/ward/api/**".to_owned(), json!({})),
            (signed.key.clone(), json!({ "mission": "lab-samples", "parameters": { "room": ROOM }, "request": "b" })),
        ];
        for (key, payload) in &attacks {
            let payload = Bytes::from(payload.to_string());
            for (bus, attachment) in
                [(&signing, Bytes::new()), (&plain, Bytes::new()), (&plain, signed.attachment.clone())]
            {
                for reply in replies(bus, key, payload.clone(), attachment).await {
                    let only_refused = reply.contains("\"error\"") || key.ends_with("**");
                    assert!(only_refused, "seed {seed}: {key} was answered with {reply}");
                }
            }
        }
        let again = replies(&plain, &signed.key, signed.payload.clone(), signed.attachment.clone()).await;
        assert_eq!(again, [] as [String; 0], "seed {seed}: a repeated request is not answered");
        fleet.assert_completes(&mission).await;
        fleet.assert_each_task_once(&mission);
        let submitted = fleet.event_log.count(|what| matches!(what, EventKind::Submitted { .. }));
        assert_eq!(submitted, 1, "seed {seed}\n{}", fleet.event_log_text());
        let left = fleet.event_log.count(|what| matches!(what, EventKind::Left { .. }));
        assert_eq!(left, 0, "seed {seed}: a node left\n{}", fleet.event_log_text());
    });
}

/// The next coordinator has not seen the request before, but the ledger has.
#[test]
fn a_copy_of_a_cancelation_cancels_nothing_at_the_next_coordinator() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        fleet.wait_for_audit_trail().await;
        let StolenKey { signing: _signing, plain } = stolen(&fleet, "fern", NodeRole::Robot).await;
        let mission = fleet.submit("a", ROOM).await;
        let mut relayed = plain.serve("consort/ward/api/cancel_missions").await.expect("a network");
        let cancel = json!({ "missions": { "where": "true" }, "by": "Nia" });
        let reply = fleet.request_answered(ApiCall::CancelMissions, &cancel).await;
        let by_signer = json!({ "canceled": { "by": "Nia, according to client" } });
        assert_eq!(reply["missions"], json!({ mission.as_str(): by_signer }), "seed {seed}: {reply}");
        let signed = relayed.recv().await.expect("a request");
        fleet.kill_coordinator().await;
        fleet.wait_for_coordinator().await;
        let later = fleet.submit("b", ROOM).await;
        for reply in replies(&plain, &signed.key, signed.payload.clone(), signed.attachment.clone()).await {
            assert!(!reply.contains("canceled"), "seed {seed}: {reply}");
        }
        fleet.assert_completes(&later).await;
    });
}

/// The ledger keeps no ids of changes of schedules: a coordinator executes only those that were signed
/// after its session began.
#[test]
fn a_copy_of_a_pause_pauses_nothing_at_the_next_coordinator() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        fleet.wait_for_audit_trail().await;
        let StolenKey { signing: _signing, plain } = stolen(&fleet, "fern", NodeRole::Robot).await;
        let change = |action: &str| json!({ "schedule": "rounds", "action": action, "by": "Nia" });
        request(&fleet, ApiCall::Schedule, &yearly("rounds")).await;
        let mut relayed = plain.serve("consort/ward/api/schedule").await.expect("a network");
        // A node that has received the request would drop a copy of it.
        for other in ["basil", "clove", "gorse", "lab-arm"] {
            fleet.network.block_queries(slug(other), "consort/ward/api/schedule");
        }
        request(&fleet, ApiCall::Schedule, &change("pause")).await;
        fleet.network.heal();
        let signed = relayed.recv().await.expect("a request");
        fleet.kill_coordinator().await;
        fleet.wait_for_coordinator().await;
        // The person resumes it with a request that is signed after the takeover.
        request(&fleet, ApiCall::Schedule, &change("resume")).await;
        let copied = replies(&plain, &signed.key, signed.payload.clone(), signed.attachment.clone()).await;
        let is_paused = |ledger: &Ledger| ledger.schedule(&slug("rounds")).map(|entry| entry.pause.is_some());
        assert_eq!(fleet.ledger(is_paused).flatten(), Some(false), "seed {seed}: {copied:?}");
        let is_put_off = |reply: &String| reply.contains("signed before") && reply.contains("retry_after_ms");
        assert!(copied.iter().any(is_put_off), "seed {seed}: {copied:?}");
    });
}

#[test]
fn a_signed_alarm_names_the_signer_and_the_key_of_a_robot_does_not_clear_it() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        fleet.wait_for_audit_trail().await;
        let mission = fleet.submit("a", ROOM).await;
        let start = fleet.position("gorse");
        fleet.wait_until("a move", SOON, |fleet| fleet.position("gorse") != start).await;
        let raise = json!({ "action": "raise", "alarm": "freeze", "by": "Nia" });
        let reply = fleet.request_answered(ApiCall::Alarm, &raise).await;
        assert_eq!(reply["alarms"][0]["order"]["by"], "Nia, according to client", "seed {seed}: {reply}");
        fleet.wait_for_rest("gorse").await;
        let place = fleet.position("gorse");
        let StolenKey { signing, plain } = stolen(&fleet, "fern", NodeRole::Robot).await;
        let signing: SharedBus = signing;
        let key = fleet.keys().write(&Key::Api(ApiCall::Alarm));
        let clear = json!({ "action": "clear" });
        for bus in [&signing, &plain] {
            for reply in replies(bus, &key, Bytes::from(clear.to_string()), Bytes::new()).await {
                assert!(reply.contains("\"error\""), "seed {seed}: {reply}");
            }
        }
        fleet.assert_never("a move", Duration::from_secs(10), |fleet| fleet.position("gorse") != place).await;
        assert_eq!(fleet.ledger(|ledger| ledger.alarms().count()), Some(1), "seed {seed}");
        fleet.request_answered(ApiCall::Alarm, &clear).await;
        fleet.assert_completes(&mission).await;
    });
}

#[test]
fn a_signed_hold_stops_a_robot_and_names_the_signer() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock")).await;
        fleet.wait_for_audit_trail().await;
        let mission = fleet.submit("a", ROOM).await;
        let start = fleet.position("gorse");
        fleet.wait_until("a move", SOON, |fleet| fleet.position("gorse") != start).await;
        let payload = json!({ "robots": ["gorse"], "by": "Nia" });
        let reply = fleet.request_answered(ApiCall::Hold, &payload).await;
        assert_eq!(reply["robots"]["gorse"]["hold"]["by"], "Nia, according to client", "seed {seed}: {reply}");
        fleet.wait_for_rest("gorse").await;
        let place = fleet.position("gorse");
        fleet.assert_never("a move", Duration::from_secs(10), |fleet| fleet.position("gorse") != place).await;
        fleet.request_answered(ApiCall::Release, &payload).await;
        fleet.assert_completes(&mission).await;
        let (signer, mission) = ("Nia, according to client", mission.as_str());
        let expected = json!([["client", "submit", mission], [signer, "hold", "gorse"], [signer, "release", "gorse"]]);
        assert_eq!(json!(audited_changes(&fleet).await), expected, "seed {seed}");
        assert_eq!(refused(&fleet), BTreeSet::new(), "seed {seed}: friends are taken for foes");
    });
}

/// A client that repeats a request, for lack of a reply, signs it again.
#[test]
fn a_hold_that_is_signed_twice_is_executed_once() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock")).await;
        fleet.wait_for_audit_trail().await;
        let is_known = |fleet: &Fleet| fleet.knowledge_of("aster", &slug("gorse")).is_some();
        fleet.wait_until("the record of the robot", SOON, is_known).await;
        let hold = json!({ "robots": ["gorse"], "by": "Nia", "request": "order-7" });
        let first = request(&fleet, ApiCall::Hold, &hold).await;
        let from = fleet.elapsed();
        let is_later = |fleet: &Fleet| fleet.elapsed() >= from + Duration::from_secs(2);
        fleet.wait_until("another time of the request", SOON, is_later).await;
        assert_eq!(request(&fleet, ApiCall::Hold, &hold).await, first, "seed {seed}: its end is the same");
        let expected = json!([["Nia, according to client", "hold", "gorse"]]);
        assert_eq!(json!(audited_changes(&fleet).await), expected, "seed {seed}");
    });
}
