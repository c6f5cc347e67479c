//! Priorities, earliest starts and deadlines of missions.

use crate::support::{DAY_MS, with_wrong_clock};
use consort_protocol::cause::CauseClass;
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::MissionState;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::{Value, json};
use std::time::Duration;

const ROOMS: [&str; 4] = ["IC Room 6", "PC Room 8", "PC Room 2", "IC Room 2"];
const SOON: Duration = Duration::from_secs(60);

async fn submit(fleet: &Fleet, request: &str, room: &str, more: Value) -> MissionId {
    let mut request = json!({ "mission": "lab-samples", "parameters": { "room": room }, "request": request });
    for (name, value) in more.as_object().expect("a map") {
        request[name] = value.clone();
    }
    let answer = fleet.request_answered(ApiCall::Submit, &request).await;
    slug(answer["mission"].as_str().unwrap_or_else(|| panic!("seed {}: {answer}", fleet.seed)))
}

/// Returns the missions in the order of their first award.
fn begun(fleet: &Fleet) -> Vec<MissionId> {
    let mut order: Vec<MissionId> = vec![];
    for what in fleet.events() {
        if let EventKind::Awarded { mission, .. } = what
            && !order.contains(&mission)
        {
            order.push(mission);
        }
    }
    order
}

#[test]
fn waiting_missions_run_by_priority_and_order_after_a_takeover() {
    for_each_seed([641, 642, 643], async |seed| {
        let robots = vec![RobotSpec::carrier("amber", "PC Room 8").with_speed(1.5)];
        let mut fleet = Fleet::hospital(seed, robots, &["aba", "abb", "abc"], &ROOMS).await;
        fleet.wait_for_coordinator().await;
        let first = submit(&fleet, "a", ROOMS[0], json!({})).await;
        fleet.wait_until("the first to begin", SOON, |fleet| fleet.holder(&first, "r1").is_some()).await;
        let later = submit(&fleet, "b", ROOMS[1], json!({ "priority": -5 })).await;
        let plain = submit(&fleet, "c", ROOMS[2], json!({})).await;
        let urgent = submit(&fleet, "d", ROOMS[3], json!({ "priority": 100 })).await;
        fleet.kill_coordinator().await;
        fleet.wait_for_coordinator().await;
        for mission in [&first, &later, &plain, &urgent] {
            fleet.assert_completes(mission).await;
        }
        assert_eq!(begun(&fleet), [first, urgent, plain, later], "seed {seed}\n{}", fleet.event_log_text());
        fleet.assert_exclusive_roles();
    });
}

#[test]
fn missions_with_deadlines_overtake_an_older_one_without() {
    for_each_seed([644, 645], async |seed| {
        let robots = vec![RobotSpec::carrier("amber", "PC Room 8").with_speed(1.5)];
        let mut fleet = Fleet::hospital(seed, robots, &["aba"], &ROOMS).await;
        fleet.wait_for_coordinator().await;
        let first = submit(&fleet, "a", ROOMS[0], json!({})).await;
        fleet.wait_until("the first to begin", SOON, |fleet| fleet.holder(&first, "r1").is_some()).await;
        let plain = submit(&fleet, "b", ROOMS[1], json!({})).await;
        let relaxed = submit(&fleet, "c", ROOMS[2], json!({ "deadline_s": 7200 })).await;
        let near = submit(&fleet, "d", ROOMS[3], json!({ "deadline_s": 3600 })).await;
        for mission in [&first, &plain, &relaxed, &near] {
            fleet.assert_completes(mission).await;
        }
        assert_eq!(begun(&fleet), [first, near, relaxed, plain], "seed {seed}\n{}", fleet.event_log_text());
    });
}

#[test]
fn the_urgent_mission_of_two_simultaneous_requests_wins() {
    for_each_seed([651, 652, 653, 654], async |seed| {
        let mut fleet = Fleet::hospital(seed, vec![RobotSpec::carrier("amber", "PC Room 8")], &["aba"], &ROOMS).await;
        fleet.wait_for_coordinator().await;
        let plain = json!({ "mission": "lab-samples", "parameters": { "room": ROOMS[0] }, "request": "a" });
        let urgent =
            json!({ "mission": "lab-samples", "parameters": { "room": ROOMS[1] }, "request": "b", "priority": 1 });
        let (plain, urgent) = tokio::join!(
            fleet.request_answered(ApiCall::Submit, &plain),
            fleet.request_answered(ApiCall::Submit, &urgent)
        );
        let id = |answer: &Value| slug::<MissionId>(answer["mission"].as_str().expect("acknowledged"));
        let both = [id(&plain), id(&urgent)];
        fleet.wait_until("an award", SOON, |fleet| !begun(fleet).is_empty()).await;
        assert_eq!(begun(&fleet)[0], both[1], "seed {seed}\n{}", fleet.event_log_text());
    });
}

#[test]
fn a_mission_past_its_deadline_fails_with_its_progress() {
    for_each_seed([661, 662], async |seed| {
        let robots = vec![RobotSpec::carrier("amber", "Dock").with_speed(0.05)];
        let mut fleet = Fleet::hospital(seed, robots, &["aba"], &ROOMS).await;
        fleet.wait_for_coordinator().await;
        let running = submit(&fleet, "a", ROOMS[0], json!({ "deadline_s": 12.5 })).await;
        fleet.wait_until("the first to begin", SOON, |fleet| fleet.holder(&running, "r1").is_some()).await;
        let waiting = submit(&fleet, "b", ROOMS[1], json!({ "deadline_s": 3 })).await;
        let MissionState::Failed { cause, .. } = fleet.wait_for_end(&waiting).await else {
            panic!("seed {seed}: it ended in another state")
        };
        assert_eq!(cause, "its deadline passed while it waited: no viable bid for lab_arm, r1", "seed {seed}");
        let at = fleet.elapsed();
        let MissionState::Failed { cause, .. } = fleet.wait_for_end(&running).await else {
            panic!("seed {seed}: it ended in another state")
        };
        assert_eq!(cause, "its deadline passed after 0 of 16 steps", "seed {seed}");
        assert!(fleet.elapsed() - at > Duration::from_secs(7), "seed {seed}: too early\n{}", fleet.event_log_text());
        let halted = |what: &EventKind| matches!(what, EventKind::Halted { .. });
        fleet.wait_until("both robots to stop", SOON, |fleet| fleet.event_log.count(halted) == 2).await;
        fleet.wait_for_rest("amber").await;
        let place = fleet.position("amber");
        fleet.assert_never("a drive", Duration::from_secs(5), |fleet| fleet.position("amber") != place).await;
    });
}

/// A mission file has a bound on time. The earlier of it and the deadline of the request counts.
#[test]
fn a_mission_past_its_time_limit_fails_and_frees_its_robot() {
    let rest = |seconds: u32, limit_s: u32| {
        let parameters = json!({ "seconds": seconds.to_string() });
        json!({ "mission": { "mission": "rest", "time_limit_s": limit_s, "roles": { "r1": { "kind": "managed" } },
            "root": { "task": "rest", "type": "wait", "roles": ["r1"], "parameters": parameters } }, "parameters": {} })
    };
    let and = |mut request: Value, name: &str, value: Value| {
        request[name] = value;
        request
    };
    for_each_seed([663, 664], async |seed| {
        let mut fleet =
            Fleet::hospital(seed, vec![RobotSpec::carrier("amber", "Dock").with_skill("wait")], &["aba"], &[]).await;
        fleet.wait_for_coordinator().await;
        let late = submit(&fleet, "a", "", rest(120, 5)).await;
        let MissionState::Failed { cause, class } = fleet.wait_for_end(&late).await else {
            panic!("seed {seed}: it ended in another state")
        };
        assert_eq!(cause, "its deadline passed after 0 of 1 steps", "seed {seed}");
        assert_eq!(class, CauseClass::Transient, "seed {seed}");
        let view = fleet.request_answered(ApiCall::Get, &json!({ "mission": late })).await;
        assert_eq!(view["detail"]["failed"]["class"], "transient", "seed {seed}: {view}");
        let timely = submit(&fleet, "b", "", rest(1, 600)).await;
        fleet.assert_completes(&timely).await;
        for (name, request, more, after_ms) in [
            ("c", rest(1, 600), "deadline_s", 30_000),
            ("d", rest(1, 20), "deadline_s", 20_000),
            ("e", rest(1, 20), "not_before", 50_000),
        ] {
            let mission = submit(&fleet, name, "", and(request, more, json!(30))).await;
            let view = fleet.request_answered(ApiCall::Get, &json!({ "mission": mission })).await;
            let at = |name: &str| view[name].as_u64().unwrap_or_else(|| panic!("seed {seed}: {name}: {view}"));
            assert_eq!(at("deadline_at_ms") - at("submitted_at_ms"), after_ms, "seed {seed}: {more}");
        }
    });
}

#[test]
fn a_wrong_clock_of_one_voter_fails_no_mission() {
    for (seed, wrong) in [(671, "aba"), (672, "abb"), (673, "abc")] {
        for_each_seed([seed], async |seed| {
            let mut fleet = with_wrong_clock(seed, wrong, &ROOMS).await;
            let mission = submit(&fleet, "a", ROOMS[0], json!({ "deadline_s": 3600 })).await;
            fleet.wait_until("the mission to begin", SOON, |fleet| fleet.holder(&mission, "r1").is_some()).await;
            let mut coordinators = vec![fleet.kill_coordinator().await];
            coordinators.push(fleet.wait_for_coordinator().await);
            fleet.assert_completes(&mission).await;
            let submitted_ms = fleet.events().into_iter().find_map(|event| match event {
                EventKind::Mission { submitted_at_ms, .. } => Some(submitted_at_ms),
                _ => None,
            });
            assert!(submitted_ms.is_some_and(|ms| ms < DAY_MS), "seed {seed}: {submitted_ms:?}, {coordinators:?}");
        });
    }
}

#[test]
fn an_invalid_priority_or_deadline_is_rejected() {
    for_each_seed([671], async |seed| {
        let mut fleet = Fleet::hospital(seed, vec![], &["aba"], &ROOMS).await;
        fleet.wait_for_coordinator().await;
        for (more, expected) in [
            (json!({ "priority": 101 }), "101 is not a valid priority; allowed are -100 to 100"),
            (json!({ "deadline_s": 0 }), "deadline_s is 0; the time must be more than 0"),
            (json!({ "deadline_s": -3.5 }), "deadline_s is -3.5; the time must be more than 0"),
        ] {
            let mut request = json!({ "mission": "lab-samples" });
            request.as_object_mut().expect("a map").extend(more.as_object().expect("a map").clone());
            let answer = fleet.request_answered(ApiCall::Submit, &request).await;
            assert!(answer["error"].as_str().is_some_and(|error| error.contains(expected)), "seed {seed}: {answer}");
        }
    });
}

/// The coordinator dies while the mission waits, and the clock of one voter is a day ahead.
#[test]
fn a_mission_starts_at_its_time_and_not_before() {
    const WAIT_S: u64 = 40;
    for (seed, wrong) in [(674, "aba"), (675, "abb"), (676, "abc")] {
        for_each_seed([seed], async |seed| {
            let mut fleet = with_wrong_clock(seed, wrong, &ROOMS).await;
            let submitted = fleet.elapsed();
            let mission = submit(&fleet, "a", ROOMS[0], json!({ "not_before": WAIT_S })).await;
            let list = fleet.request_answered(ApiCall::List, &json!({})).await;
            let reason = list["missions"][0]["pending_reason"].as_str().unwrap_or_default().to_owned();
            assert!(reason.starts_with("it may not start before 1970-01-0"), "seed {seed}: {list}");
            fleet.kill_coordinator().await;
            let before = submitted + Duration::from_secs(WAIT_S - 1) - fleet.elapsed();
            fleet.assert_never("an award before its time", before, |fleet| !begun(fleet).is_empty()).await;
            fleet.wait_until("an award", SOON, |fleet| !begun(fleet).is_empty()).await;
            let late = fleet.elapsed() - submitted - Duration::from_secs(WAIT_S);
            assert!(late < Duration::from_secs(15), "seed {seed}: {late:?} late\n{}", fleet.event_log_text());
            fleet.assert_completes(&mission).await;
        });
    }
}

#[test]
fn a_start_that_is_no_time_or_after_the_deadline_is_rejected() {
    for_each_seed([677], async |seed| {
        let mut fleet = Fleet::hospital(seed, vec![RobotSpec::carrier("amber", "Dock")], &["aba"], &ROOMS).await;
        fleet.wait_for_coordinator().await;
        for (more, expected) in [
            (json!({ "not_before": "tomorrow" }), "not_before is \"tomorrow\"; allowed is a date and time"),
            (json!({ "not_before": "2999-01-01T00:00:00Z" }), "in the next ten years"),
            (json!({ "not_before": -1.0 }), "not_before is -1; allowed is a date and time"),
            (json!({ "not_before": 60, "deadline_s": 60 }), "deadline_s is 60, but not_before is 60 s from now"),
        ] {
            let mut request = json!({ "mission": "lab-samples", "parameters": { "room": ROOMS[0] } });
            more.as_object().expect("a map").iter().for_each(|(name, value)| request[name] = value.clone());
            let reply = fleet.request_answered(ApiCall::Submit, &request).await;
            let error = reply["error"].as_str().unwrap_or_else(|| panic!("{more}: {reply}"));
            assert!(error.contains(expected), "{more}: {error}");
        }
        // A time that has passed, with the offset of another zone, is no obstacle.
        let mission = submit(&fleet, "a", ROOMS[0], json!({ "not_before": "1970-01-01T01:00:00+01:00" })).await;
        fleet.assert_completes(&mission).await;
    });
}
