//! People cancel several missions at once, and change the priority of missions.

use crate::support::{audit_entries, kill_coordinator_during, request, task_began};
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::{Value, json};
use std::time::Duration;

const SOON: Duration = Duration::from_secs(60);
const ROOMS: [&str; 3] = ["IC Room 6", "PC Room 8", "PC Room 2"];

/// Starts slow carriers at these places, and three stations; `aster` coordinates.
async fn fleet(seed: u64, carriers: &[(&str, &str)]) -> Fleet {
    let robots = carriers.iter().map(|(name, place)| RobotSpec::carrier(name, place).with_speed(0.6)).collect();
    let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove"], &ROOMS).await;
    assert_eq!(fleet.wait_for_coordinator().await.as_str(), "aster", "seed {seed}: the coordinator");
    fleet.wait_for_audit_trail().await;
    fleet
}

/// Submits a drive to a room.
async fn submit(fleet: &Fleet, id: &str, room: &str) -> MissionId {
    let mission = json!({
        "mission": "visit", "parameters": { "room": { "kind": "place" } }, "roles": { "r1": { "kind": "managed" } },
        "root": { "task": "go", "type": "navigation", "roles": ["r1"], "parameters": { "to": "${room}" } },
    });
    let payload = json!({ "mission": mission, "parameters": { "room": room }, "request": id });
    let reply = request(fleet, ApiCall::Submit, &payload).await;
    slug(reply["mission"].as_str().unwrap_or_else(|| panic!("seed {}: {reply}", fleet.seed)))
}

/// Submits a drive to each of the rooms.
async fn submit_all(fleet: &Fleet) -> Vec<MissionId> {
    let mut missions = vec![];
    for (id, room) in ["a", "b", "c"].into_iter().zip(ROOMS) {
        missions.push(submit(fleet, id, room).await);
    }
    missions
}

/// Returns the changes in the audit trail, without submissions and answers.
async fn audited(fleet: &Fleet) -> Vec<[Value; 4]> {
    let mut entries = audit_entries(fleet).await;
    entries.retain(|entry| entry["action"] != "submit");
    let fields = |entry: &Value| ["by", "action", "subject", "details"].map(|field| entry[field].clone());
    entries.iter().map(fields).collect()
}

#[test]
fn missions_that_meet_a_condition_are_canceled_together() {
    for_each_seed([1401, 1402], async |seed| {
        let mut fleet = fleet(seed, &[("fern", "Dock")]).await;
        let missions = submit_all(&fleet).await;
        let condition = format!("mission.name == \"visit\" && mission.parameters.room != \"{}\"", ROOMS[0]);
        let selection = json!({ "where": condition });
        let listed = json!({ "missions": selection, "dry_run": true });
        let listed = request(&fleet, ApiCall::CancelMissions, &listed).await;
        let names: Vec<&String> = listed["missions"].as_object().expect("missions").keys().collect();
        assert_eq!(names, [missions[1].as_str(), missions[2].as_str()], "seed {seed}: {listed}");
        assert_eq!(audited(&fleet).await, [] as [[Value; 4]; 0], "seed {seed}: a dry run changes nothing");

        let cancel = json!({ "missions": selection, "by": "Nia" });
        let reply = request(&fleet, ApiCall::CancelMissions, &cancel).await;
        let canceled = json!({ "canceled": { "by": "Nia" } });
        let expected = json!({ missions[1].as_str(): canceled, missions[2].as_str(): canceled });
        assert_eq!((&reply["missions"], &reply["refused"]), (&expected, &json!({})), "seed {seed}");
        let entry = |mission: &MissionId| [json!("Nia"), json!("cancel"), json!(mission), json!("")];
        assert_eq!(audited(&fleet).await, [entry(&missions[1]), entry(&missions[2])], "seed {seed}");
        fleet.assert_completes(&missions[0]).await;
        let next = submit(&fleet, "next", ROOMS[1]).await;
        fleet.assert_completes(&next).await;
        fleet.assert_exclusive_roles();
    });
}

#[test]
fn missions_that_cannot_be_canceled_are_left_out_with_the_reason() {
    for_each_seed([1411], async |seed| {
        let fleet = fleet(seed, &[("fern", "Dock")]).await;
        let missions = submit_all(&fleet).await;
        request(&fleet, ApiCall::Cancel, &json!({ "mission": missions[0], "by": "Abe" })).await;
        let cancel = json!({ "missions": [missions[0], missions[1], "visit-9"], "by": "Nia" });
        for _ in 0..2 {
            let reply = request(&fleet, ApiCall::CancelMissions, &cancel).await;
            let expected = json!({
                "missions": { missions[1].as_str(): { "canceled": { "by": "Nia" } } },
                "refused": {
                    missions[0].as_str(): format!("mission {} is canceled", missions[0]),
                    "visit-9": "there is no mission visit-9",
                },
                "again": false,
            });
            assert_eq!(reply, expected, "seed {seed}");
        }
        for (missions, expected) in [
            (json!([]), "missions is empty; name a mission"),
            (json!({ "where": "mission.prio < 0" }), "where: `mission` has no field `prio`"),
        ] {
            let reply = fleet.request_answered(ApiCall::CancelMissions, &json!({ "missions": missions })).await;
            let error = reply["error"].as_str().unwrap_or_default();
            assert!(error.starts_with(expected), "seed {seed}: {reply}");
        }
    });
}

/// All missions are canceled or none, and a repeated request cancels no later mission.
#[test]
fn a_cancelation_is_executed_once_across_a_takeover() {
    for_each_seed([1421, 1422, 1423], async |seed| {
        let mut fleet = fleet(seed, &[("fern", "Dock"), ("gorse", "IC Room 4")]).await;
        let missions = submit_all(&fleet).await;
        let cancel = json!({ "missions": { "where": "true" }, "by": "Nia", "request": "cancel-7" });
        kill_coordinator_during(&mut fleet, ApiCall::CancelMissions, &cancel).await;
        request(&fleet, ApiCall::CancelMissions, &cancel).await;
        for mission in &missions {
            assert_eq!(fleet.wait_for_end(mission).await.as_str(), "canceled", "seed {seed}: {mission}");
        }
        let later = submit(&fleet, "later", ROOMS[0]).await;
        let repeated = request(&fleet, ApiCall::CancelMissions, &cancel).await;
        assert_eq!(repeated, json!({ "missions": {}, "refused": {}, "again": true }), "seed {seed}");
        assert_eq!(audited(&fleet).await.len(), 3, "seed {seed}: an entry for each mission");
        fleet.assert_completes(&later).await;
        fleet.assert_exclusive_roles();
    });
}

#[test]
fn a_copy_of_a_cancelation_of_no_mission_cancels_no_later_mission() {
    for_each_seed([1451], async |seed| {
        let mut fleet = fleet(seed, &[("fern", "Dock")]).await;
        let cancel = json!({ "missions": { "where": "true" }, "by": "Nia", "request": "cancel-8" });
        let reply = request(&fleet, ApiCall::CancelMissions, &cancel).await;
        assert_eq!(reply, json!({ "missions": {}, "refused": {}, "again": false }), "seed {seed}");
        let later = submit(&fleet, "later", ROOMS[0]).await;
        let repeated = request(&fleet, ApiCall::CancelMissions, &cancel).await;
        assert_eq!(repeated["again"], true, "seed {seed}: {repeated}");
        fleet.assert_completes(&later).await;
    });
}

#[test]
fn a_mission_with_a_raised_priority_is_served_next_across_a_takeover() {
    for_each_seed([1431, 1432, 1433], async |seed| {
        let mut fleet = fleet(seed, &[("fern", "Dock")]).await;
        let missions = submit_all(&fleet).await;
        fleet.wait_until("the first drive", SOON, |fleet| fleet.has_event(task_began("go"))).await;
        let raise = json!({ "mission": missions[2], "priority": 20, "by": "Nia", "request": "raise-7" });
        kill_coordinator_during(&mut fleet, ApiCall::Priority, &raise).await;
        let reply = request(&fleet, ApiCall::Priority, &raise).await;
        assert_eq!(reply, json!({ "mission": missions[2], "priority": 20 }), "seed {seed}");
        for mission in &missions {
            fleet.assert_completes(mission).await;
        }
        let started = |mission: &MissionId| {
            let times =
                fleet.event_log.times(|what| matches!(what, EventKind::Started { mission: of, .. } if of == mission));
            *times.first().unwrap_or_else(|| panic!("seed {seed}: {mission} has not started"))
        };
        let order = format!("seed {seed}\n{}", fleet.event_log_text());
        assert!(started(&missions[0]) < started(&missions[2]), "{order}");
        assert!(started(&missions[2]) < started(&missions[1]), "{order}");
        fleet.assert_exclusive_roles();
        let raised = [json!("Nia"), json!("set_priority"), json!(missions[2]), json!("20")];
        assert_eq!(audited(&fleet).await, [raised], "seed {seed}");
    });
}

#[test]
fn a_change_of_priority_is_published_and_shown() {
    for_each_seed([1441], async |seed| {
        let mut fleet = fleet(seed, &[("fern", "Dock")]).await;
        let missions = submit_all(&fleet).await;
        let lower = json!({ "mission": missions[1], "priority": -20, "by": "Nia" });
        request(&fleet, ApiCall::Priority, &lower).await;
        let published = |what: &EventKind| match what {
            EventKind::PriorityChanged { mission, priority } => *mission == missions[1] && priority.get() == -20,
            _ => false,
        };
        fleet.wait_until("the event", SOON, |fleet| fleet.has_event(published)).await;
        let view = fleet.request_answered(ApiCall::Get, &json!({ "mission": missions[1], "linearizable": true })).await;
        assert_eq!(view["priority"], -20, "seed {seed}: {view}");
        request(&fleet, ApiCall::Cancel, &json!({ "mission": missions[2], "by": "Abe" })).await;
        for (payload, expected) in [
            (json!({ "mission": missions[2], "priority": 1 }), format!("mission {} is canceled", missions[2])),
            (json!({ "mission": "visit-9", "priority": 1 }), "there is no mission visit-9".to_owned()),
            (json!({ "mission": missions[1], "priority": 101 }), "101 is not a valid priority".to_owned()),
        ] {
            let reply = fleet.request_answered(ApiCall::Priority, &payload).await;
            let error = reply["error"].as_str().unwrap_or_default();
            assert!(error.starts_with(&expected), "seed {seed}: {payload}: {reply}");
        }
    });
}
