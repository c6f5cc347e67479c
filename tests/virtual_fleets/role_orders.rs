//! People reassign and pin roles.

use crate::support::{audit_entries, kill_coordinator_during, request, task_began};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RobotId};
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::Ledger;
use consort_protocol::message::FailureKind;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::{Value, json};
use std::time::Duration;

const SOON: Duration = Duration::from_secs(60);
const ROOM: &str = "IC Room 6";

/// Starts slow carriers, far from the room, and three stations; `aster` coordinates.
async fn fleet(seed: u64) -> Fleet {
    let carriers = [("fern", "Dock"), ("gorse", "PC Room 8"), ("holly", "PC Room 2")];
    let robots = carriers.map(|(name, place)| RobotSpec::carrier(name, place).with_speed(0.6)).to_vec();
    let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove"], &[ROOM]).await;
    assert_eq!(fleet.wait_for_coordinator().await.as_str(), "aster", "seed {seed}: the coordinator");
    fleet.wait_for_audit_trail().await;
    fleet
}

/// Submits a drive to the room, after this number of seconds.
async fn submit(fleet: &Fleet, not_before_s: u32) -> MissionId {
    submit_drive(fleet, "a", ROOM, not_before_s).await
}

async fn submit_drive(fleet: &Fleet, id: &str, room: &str, not_before_s: u32) -> MissionId {
    let mission = json!({
        "mission": "visit", "roles": { "r1": { "kind": "managed" } },
        "root": { "task": "go", "type": "navigation", "roles": ["r1"], "parameters": { "to": room } },
    });
    let payload = json!({ "mission": mission, "request": id, "not_before": not_before_s });
    let reply = request(fleet, ApiCall::Submit, &payload).await;
    slug(reply["mission"].as_str().unwrap_or_else(|| panic!("seed {}: {reply}", fleet.seed)))
}

/// Starts a drive. Returns the carrier that drives, and the others.
async fn under_way(seed: u64) -> (Fleet, MissionId, String, [&'static str; 2]) {
    let mut fleet = fleet(seed).await;
    let mission = submit(&fleet, 0).await;
    fleet.wait_until("the drive", SOON, |fleet| fleet.has_event(task_began("go"))).await;
    let carrier = holder(&fleet, &mission);
    let start = fleet.position(&carrier);
    fleet.wait_until("a move", SOON, |fleet| fleet.position(&carrier) != start).await;
    let others = match carrier.as_str() {
        "fern" => ["gorse", "holly"],
        "gorse" => ["fern", "holly"],
        _ => ["fern", "gorse"],
    };
    (fleet, mission, carrier, others)
}

fn holder(fleet: &Fleet, mission: &MissionId) -> String {
    fleet.holder(mission, "r1").as_ref().map(RobotId::to_string).expect("held")
}

/// Returns the changes in the audit trail, each as person, action and details, without submissions and answers.
async fn audited(fleet: &Fleet) -> Vec<[Value; 3]> {
    let mut entries = audit_entries(fleet).await;
    entries.retain(|entry| entry["action"] != "submit");
    let fields = |entry: &Value| ["by", "action", "details"].map(|field| entry[field].clone());
    entries.iter().map(fields).collect()
}

#[test]
fn a_reassigned_role_goes_to_another_robot_across_a_takeover() {
    for_each_seed([1501, 1502, 1503], async |seed| {
        let (mut fleet, mission, carrier, others) = under_way(seed).await;
        let reassign = json!({ "mission": mission, "role": "r1", "by": "Nia", "request": "reassign-7" });
        kill_coordinator_during(&mut fleet, ApiCall::Reassign, &reassign).await;
        request(&fleet, ApiCall::Reassign, &reassign).await;
        fleet.wait_for_rest(&carrier).await;
        fleet.assert_completes(&mission).await;
        fleet.assert_exclusive_roles();
        let successor = holder(&fleet, &mission);
        assert!(others.contains(&successor.as_str()), "seed {seed}: {successor}\n{}", fleet.event_log_text());
        let returned = |what: &EventKind| matches!(what, EventKind::GaveUp { kind: FailureKind::Reassigned, .. });
        assert_eq!(fleet.event_log.count(returned), 1, "seed {seed}\n{}", fleet.event_log_text());
        let cause = format!("{carrier} returned r1: reassigned by Nia");
        let released = |what: &EventKind| matches!(what, EventKind::Released { cause: of, .. } if *of == cause);
        assert!(fleet.has_event(released), "seed {seed}\n{}", fleet.event_log_text());
        // The repeated request has changed nothing.
        assert_eq!(audited(&fleet).await, [[json!("Nia"), json!("reassign"), json!("r1")]], "seed {seed}");
    });
}

#[test]
fn a_role_is_reassigned_to_a_named_robot() {
    for_each_seed([1511, 1512], async |seed| {
        let (mut fleet, mission, _, [_, to]) = under_way(seed).await;
        let reassign = json!({ "mission": mission, "role": "r1", "to": to, "by": "Nia" });
        let reply = request(&fleet, ApiCall::Reassign, &reassign).await;
        let order = format!("reassigned to {to}; its robot returns it");
        assert_eq!((&reply["phase"], &reply["order"]), (&json!("active"), &json!(order)), "seed {seed}: {reply}");
        fleet.assert_completes(&mission).await;
        assert_eq!(holder(&fleet, &mission), to, "seed {seed}\n{}", fleet.event_log_text());
        fleet.assert_exclusive_roles();
        let orders = fleet.events().into_iter().filter_map(|what| match what {
            EventKind::RoleOrdered { order, .. } => Some(order),
            _ => None,
        });
        let expected = [Some(order), Some(format!("reassigned to {to}")), None];
        assert_eq!(orders.collect::<Vec<_>>(), expected, "seed {seed}");
    });
}

/// The other robots are free, and the pinned one is held.
#[test]
fn a_pinned_role_waits_for_its_robot() {
    for_each_seed([1521, 1522], async |seed| {
        let mut fleet = fleet(seed).await;
        let mission = submit(&fleet, 20).await;
        let hold = json!({ "robots": ["holly"], "for_s": 60, "by": "Abe" });
        request(&fleet, ApiCall::Hold, &hold).await;
        let pin = json!({ "mission": mission, "role": "r1", "pin": "holly", "by": "Nia" });
        let reply = request(&fleet, ApiCall::Reassign, &pin).await;
        assert_eq!(reply["order"], "pinned to holly", "seed {seed}: {reply}");
        let awarded = |fleet: &Fleet| fleet.holder(&mission, "r1").is_some();
        fleet.assert_never("an award", Duration::from_secs(45), awarded).await;
        let explained = fleet.request_answered(ApiCall::Explain, &json!({ "mission": mission })).await;
        let text = explained["text"].to_string();
        assert!(text.contains("not eligible: r1 is pinned to holly"), "seed {seed}: {text}");
        let listed = fleet.request_answered(ApiCall::Get, &json!({ "mission": mission, "linearizable": true })).await;
        assert_eq!(listed["orders"], json!({ "r1": "pinned to holly" }), "seed {seed}: {listed}");
        fleet.assert_completes(&mission).await;
        assert_eq!(holder(&fleet, &mission), "holly", "seed {seed}");
    });
}

#[test]
fn the_explanation_of_a_waiting_mission_names_a_later_order() {
    for_each_seed([1561, 1562], async |seed| {
        let mut fleet = fleet(seed).await;
        let hold = json!({ "robots": ["fern", "gorse", "holly"], "for_s": 600, "by": "Abe" });
        request(&fleet, ApiCall::Hold, &hold).await;
        let mission = submit(&fleet, 20).await;
        let waits =
            |fleet: &Fleet| fleet.ledger(|ledger| ledger.mission(&mission)?.auction.clone()).flatten().is_some();
        fleet.wait_until("an auction without a result", SOON, waits).await;
        let pin = json!({ "mission": mission, "role": "r1", "pin": "holly", "by": "Nia" });
        request(&fleet, ApiCall::Reassign, &pin).await;
        let names_pin = async |fleet: &Fleet| {
            let reply = fleet.request(ApiCall::Explain, &json!({ "mission": mission })).await?;
            reply["text"].to_string().contains("not eligible: r1 is pinned to holly").then_some(())
        };
        fleet.poll_until("the order in the explanation", SOON, names_pin).await;
    });
}

/// The missions are allocated together, and the pinned robot is at the room of the other mission.
#[test]
fn a_pinned_role_gets_its_robot_before_a_mission_of_lower_cost() {
    for_each_seed([1551, 1552], async |seed| {
        let mut fleet = fleet(seed).await;
        let pinned = submit_drive(&fleet, "a", ROOM, 20).await;
        let other = submit_drive(&fleet, "b", "PC Room 2", 20).await;
        request(&fleet, ApiCall::Reassign, &json!({ "mission": pinned, "role": "r1", "pin": "holly", "by": "Nia" }))
            .await;
        fleet.assert_completes(&pinned).await;
        fleet.assert_completes(&other).await;
        assert_eq!(holder(&fleet, &pinned), "holly", "seed {seed}");
        assert_ne!(holder(&fleet, &other), "holly", "seed {seed}\n{}", fleet.event_log_text());
        fleet.assert_exclusive_roles();
    });
}

#[test]
fn a_robot_that_may_have_an_item_keeps_its_role() {
    for_each_seed([1531, 1532], async |seed| {
        let mut fleet = fleet(seed).await;
        let mission = fleet.submit("a", ROOM).await;
        let carries = |fleet: &Fleet| {
            let custody = |ledger: &Ledger| ledger.mission(&mission).is_some_and(|entry| !entry.custody().is_empty());
            fleet.ledger(custody) == Some(true)
        };
        fleet.wait_until("custody of the sample", SOON * 3, carries).await;
        let carrier = holder(&fleet, &mission);
        let reassign = json!({ "mission": mission, "role": "r1", "repeat": true, "by": "Nia" });
        let reply = fleet.request_answered(ApiCall::Reassign, &reassign).await;
        let error = format!("r1 of {mission} cannot leave {carrier}, which has, or may have, the sample");
        assert_eq!(reply["error"], json!(error), "seed {seed}");
        fleet.assert_completes(&mission).await;
        fleet.assert_each_task_once(&mission);
        fleet.assert_sample_delivered(ROOM);
    });
}

#[test]
fn a_robot_that_cannot_do_a_role_does_not_get_it() {
    for_each_seed([1541], async |seed| {
        let (fleet, mission, carrier, [other, _]) = under_way(seed).await;
        for (payload, expected) in [
            (json!({ "role": "r1", "to": "heron" }), "there is no robot heron; there are ".to_owned()),
            (
                json!({ "role": "r1", "to": "lab-arm" }),
                "lab-arm is not eligible for r1: it lacks navigation".to_owned(),
            ),
            (json!({ "role": "r1", "to": carrier }), format!("r1 of {mission} belongs to {carrier} already")),
            (
                json!({ "role": "r1", "pin": other }),
                format!("r1 of {mission} is held by {carrier}; reassign it instead"),
            ),
            (json!({ "role": "r9" }), format!("mission {mission} has no role r9")),
            (
                json!({ "role": "r1", "to": other, "unpin": true }),
                "give only one of `to`, `pin` and `unpin`".to_owned(),
            ),
        ] {
            let mut payload = payload;
            payload["mission"] = json!(mission);
            let reply = fleet.request_answered(ApiCall::Reassign, &payload).await;
            let error = reply["error"].as_str().unwrap_or_default();
            assert!(error.starts_with(&expected), "seed {seed}: {payload}: {reply}");
        }
        assert_eq!(audited(&fleet).await, [] as [[Value; 3]; 0], "seed {seed}");
    });
}
