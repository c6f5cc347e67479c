//! Support for the tests of virtual fleets.

use consort_bus::clock::Clock;
use consort_fleet::node::NodeSettings;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId, RobotId};
use consort_protocol::keys::{ApiCall, KeyKind};
use consort_protocol::lease::LeaseTerms;
use consort_protocol::mission::Domain;
use consort_protocol::view::PersonRequestView;
use consort_tests::{Fleet, RobotSpec, slug};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// Starts two carriers and three stations; `aster` coordinates.
pub(crate) async fn fleet(seed: u64, room: &'static str) -> Fleet {
    let robots = vec![RobotSpec::carrier("fern", "Dock"), RobotSpec::carrier("gorse", "IC Room 4")];
    let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove"], &[room]).await;
    assert_eq!(fleet.wait_for_coordinator().await.as_str(), "aster", "seed {seed}: the first coordinator");
    fleet
}

/// Returns the number of messages of a kind that a node has received.
pub(crate) fn received_of(fleet: &Fleet, node: &str, kind: KeyKind) -> u64 {
    let traffic = fleet.network.traffic(&slug(node));
    traffic.iter().find(|(of, _)| *of == kind).map_or(0, |(_, traffic)| traffic.messages_received)
}

/// Returns two slow carriers, far from the rooms.
pub(crate) fn slow_carriers() -> Vec<RobotSpec> {
    vec![RobotSpec::carrier("fern", "Dock").with_speed(0.6), RobotSpec::carrier("gorse", "PC Room 8").with_speed(0.7)]
}

/// Starts the slow carriers and three stations; `aster` coordinates, and takes a role from a robot that ends no step for
/// `stall_timeout`. The fleet file declares one zone, by its name and places.
pub(crate) async fn slow_fleet(
    seed: u64,
    rooms: &[&str],
    stall_timeout: Duration,
    (zone, places): (&str, &[&str]),
) -> Fleet {
    let zones = BTreeMap::from([(slug(zone), places.iter().map(|place| slug(place)).collect())]);
    let adjust = move |settings: &mut NodeSettings| {
        settings.fleet.stall_timeout = stall_timeout;
        settings.fleet.domain = Arc::new(Domain::clone(&settings.fleet.domain).with_zones(zones.clone()));
    };
    fleet_of(seed, slow_carriers(), rooms, adjust).await
}

/// Starts these robots and three stations with changed node settings; `aster` coordinates.
pub(crate) async fn fleet_of(
    seed: u64,
    robots: Vec<RobotSpec>,
    rooms: &[&str],
    adjust: impl FnMut(&mut NodeSettings) + 'static,
) -> Fleet {
    let stations = ["aster", "basil", "clove"];
    let mut fleet = Fleet::adjusted_hospital(seed, robots, &stations, rooms, Box::new(adjust)).await;
    assert_eq!(fleet.wait_for_coordinator().await.as_str(), "aster", "seed {seed}: the coordinator");
    fleet
}

/// Starts a mission in a fleet that keeps an audit trail. Returns it and the carrier that drives to the room.
pub(crate) async fn drive_to_room(fleet: &mut Fleet, room: &str) -> (MissionId, String) {
    let limit = Duration::from_secs(60);
    fleet.wait_for_audit_trail().await;
    let mission = fleet.submit("a", room).await;
    fleet.wait_until("the way to the room", limit, |fleet| fleet.has_event(task_began("navto_room"))).await;
    let carrier = fleet.holder(&mission, "r1").expect("held").to_string();
    (mission, carrier)
}

/// Submits a mission that visits rooms in their order.
pub(crate) async fn visit(fleet: &Fleet, rooms: &[&str]) -> MissionId {
    let visit = |(number, room): (usize, &&str)| {
        json!({ "task": format!("visit_{number}"), "type": "navigation", "roles": ["r1"], "parameters": { "to": room },
            "reaches": { "location": room } })
    };
    let visits: Vec<Value> = rooms.iter().enumerate().map(visit).collect();
    let root = json!({ "task": "round", "method": "sequential", "tasks": visits });
    let mission = json!({ "mission": "round", "roles": { "r1": { "kind": "managed" } }, "root": root });
    let answer = fleet.request_answered(ApiCall::Submit, &json!({ "mission": mission })).await;
    slug(answer["mission"].as_str().unwrap_or_else(|| panic!("{answer}")))
}

/// Asserts that a mission of this room completes under its first award.
pub(crate) async fn assert_completes_by(fleet: &mut Fleet, mission: &MissionId, room: &str, carrier: &str) {
    fleet.assert_completes(mission).await;
    fleet.assert_sample_delivered(room);
    fleet.assert_exclusive_roles();
    assert_eq!(fleet.holder(mission, "r1").as_ref().map(RobotId::as_str), Some(carrier), "seed {}", fleet.seed);
    assert_eq!(fleet.event_log.count(released), 0, "seed {}\n{}", fleet.seed, fleet.event_log_text());
}

/// Returns the entries of the audit trail, without the answers of simulated people.
pub(crate) async fn audit_entries(fleet: &Fleet) -> Vec<Value> {
    let trail = request(fleet, ApiCall::Audit, &json!({ "linearizable": true })).await;
    let entries = trail["entries"].as_array().expect("entries").iter().filter(|entry| entry["action"] != "answer");
    entries.cloned().collect()
}

/// Returns the entries of the audit trail, each as person, action and subject, without the answers of simulated people.
pub(crate) async fn audited_changes(fleet: &Fleet) -> Vec<[Value; 3]> {
    let fields = |entry: &Value| ["by", "action", "subject"].map(|field| entry[field].clone());
    audit_entries(fleet).await.iter().map(fields).collect()
}

/// Matches the start of a task.
pub(crate) fn task_began(task: &str) -> impl Fn(&EventKind) -> bool {
    move |what| matches!(what, EventKind::TaskBegan { task: of, .. } if of.as_str() == task)
}

/// Matches the release of a role.
pub(crate) fn released(what: &EventKind) -> bool {
    release_reason(what).is_some()
}

/// Returns the released role and the cause.
pub(crate) fn release_reason(what: &EventKind) -> Option<String> {
    match what {
        EventKind::Released { role, cause, .. } => Some(format!("{role}: {cause}")),
        _ => None,
    }
}

/// Repeats a request until a coordinator has executed it.
pub(crate) async fn request(fleet: &Fleet, call: ApiCall, payload: &Value) -> Value {
    let executed = async |fleet: &Fleet| {
        let reply = fleet.request(call, payload).await?;
        reply.get("retry_after_ms").is_none().then_some(reply)
    };
    let reply = fleet.poll_until("a reply", Duration::from_secs(60), executed).await;
    assert!(reply.get("error").is_none(), "seed {}: {payload}: {reply}", fleet.seed);
    reply
}

/// Longer than a lease and its grace, after which a silent robot loses its role.
pub(crate) fn longer_than_a_lease() -> Duration {
    let terms = LeaseTerms::default();
    (terms.lease + terms.grace) * 2
}

/// Returns all requests to people.
pub(crate) async fn person_requests(fleet: &Fleet) -> Vec<Value> {
    let reply = fleet.request_answered(ApiCall::Requests, &json!({ "linearizable": true })).await;
    reply["requests"].as_array().cloned().unwrap_or_default()
}

/// Waits for an open request to a person for which `is_meant` holds.
pub(crate) async fn open_request(fleet: &Fleet, what: &str, is_meant: impl Fn(&Value) -> bool) -> Value {
    let find = async |fleet: &Fleet| {
        let mut open =
            person_requests(fleet).await.into_iter().filter(|request| request["phase"].get("open").is_some());
        open.find(|request| is_meant(request))
    };
    fleet.poll_until(what, Duration::from_secs(60), find).await
}

/// Checks whether people with a role are asked.
pub(crate) fn is_for(request: &Value, role: &str) -> bool {
    let view: PersonRequestView = serde_json::from_value(request.clone()).expect("a request");
    view.is_for(&slug(role))
}

/// Waits for the escalation of the request for a task.
pub(crate) async fn escalated_request(fleet: &Fleet, task: &str) -> Value {
    let find = async |fleet: &Fleet| {
        let mut requests = person_requests(fleet).await.into_iter();
        requests.find(|request| request["task"] == task && request["escalated_at_ms"].is_u64())
    };
    fleet.poll_until("an escalation", Duration::from_secs(120), find).await
}

/// Matches the escalation of the request for a task to a role.
pub(crate) fn escalated(task: &str, role: &str) -> impl Fn(&EventKind) -> bool {
    move |kind| matches!(kind, EventKind::Escalated { task: of, to, .. } if of.as_str() == task && to.as_str() == role)
}

/// Repeats the answer of a person until a coordinator has executed it.
pub(crate) async fn answer(fleet: &Fleet, payload: &Value) -> Value {
    let executed = async |fleet: &Fleet| {
        let reply = fleet.request(ApiCall::Answer, payload).await?;
        reply.get("retry_after_ms").is_none().then_some(reply)
    };
    fleet.poll_until("a reply", Duration::from_secs(60), executed).await
}

/// Kills the coordinator while a request is on its way or is being executed: the seed decides how far it
/// gets.
pub(crate) async fn kill_coordinator_during(fleet: &mut Fleet, call: ApiCall, payload: &Value) -> NodeId {
    let limit = Duration::from_millis(fleet.seed % 3 * 4);
    // Without a reply in time the request may still be executed.
    let _ = tokio::time::timeout(limit, fleet.request(call, payload)).await; // virtual time
    fleet.kill_coordinator().await
}

/// A day in milliseconds.
pub(crate) const DAY_MS: u64 = 24 * 60 * 60 * 1000;

/// Starts a fleet in which the clock of this station is a day ahead. Robots have no vote, so that the wrong
/// clock is one of three.
pub(crate) async fn with_wrong_clock(seed: u64, wrong: &'static str, rooms: &[&str]) -> Fleet {
    let (robots, stations) = (vec![RobotSpec::carrier("amber", "Dock").with_skill("wait")], ["aba", "abb", "abc"]);
    let adjust = move |settings: &mut NodeSettings| {
        settings.may_vote = stations.contains(&settings.node.as_str());
        settings.fleet.bootstrap_expect = stations.len();
        if settings.node == slug(wrong) {
            settings.clock = Clock::virtual_at(DAY_MS);
        }
    };
    let mut fleet = Fleet::adjusted_hospital(seed, robots, &stations, rooms, Box::new(adjust)).await;
    fleet.wait_for_coordinator().await;
    fleet
}
