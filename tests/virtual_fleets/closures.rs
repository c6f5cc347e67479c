//! People close places and lanes, and open them.

use crate::support::{
    assert_completes_by, audited_changes, drive_to_room, longer_than_a_lease, released, request, slow_fleet,
};
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_tests::{Fleet, for_each_seed};
use serde_json::{Value, json};
use std::time::Duration;

pub(crate) const ROOM: &str = "IC Room 6";
/// The only way to the room leads from `BEFORE` through `GATE`.
const GATE: &str = "IC Corridor 6";
const BEFORE: &str = "IC Corridor 3";
/// Positions of these places in metres.
const BEFORE_AT: (f64, f64) = (6.0, 29.0);
const GATE_Y_M: f64 = 31.0;
/// The room and the places before it, except `BEFORE`.
const ZONE: &str = "isolation";
pub(crate) const SOON: Duration = Duration::from_secs(60);
/// Longer than the drive of the slow carriers to the room.
pub(crate) const DRIVE: Duration = Duration::from_secs(180);

async fn close(fleet: &Fleet, mut parts: Value, for_s: u32) -> Value {
    parts["for_s"] = json!(for_s);
    parts["reason"] = json!("wet floor");
    parts["by"] = json!("Nia");
    request(fleet, ApiCall::Close, &parts).await
}

async fn open(fleet: &Fleet, places: &[&str]) {
    request(fleet, ApiCall::Open, &json!({ "places": places, "by": "Abe" })).await;
}

pub(crate) async fn fleet(seed: u64) -> Fleet {
    slow_fleet(seed, &[ROOM], Duration::from_secs(900), (ZONE, &[GATE, ROOM])).await
}

/// Starts a mission. Returns the carrier that drives to the room.
pub(crate) async fn under_way(seed: u64) -> (Fleet, MissionId, String) {
    let mut fleet = fleet(seed).await;
    let (mission, carrier) = drive_to_room(&mut fleet, ROOM).await;
    (fleet, mission, carrier)
}

fn distance(a: (f64, f64), b: (f64, f64)) -> f64 {
    (a.0 - b.0).hypot(a.1 - b.1)
}

/// Checks whether a carrier is in the closed place or beyond.
fn has_entered(fleet: &Fleet) -> bool {
    ["fern", "gorse"].iter().any(|carrier| fleet.position(carrier).1 > GATE_Y_M - 0.3)
}

/// Asserts that no carrier enters the closed place and that no role is released, until the carrier
/// waits before the place and during this time.
async fn assert_waits(fleet: &mut Fleet, carrier: &str, during: Duration) {
    let mut entered = false;
    let waits = |fleet: &Fleet| {
        entered |= has_entered(fleet);
        distance(fleet.position(carrier), BEFORE_AT) < 0.3
    };
    fleet.wait_until("the carrier before the closed place", DRIVE, waits).await;
    assert!(!entered, "seed {}\n{}", fleet.seed, fleet.event_log_text());
    let place = fleet.position(carrier);
    let broken = |fleet: &Fleet| {
        has_entered(fleet) || distance(fleet.position(carrier), place) > 0.3 || fleet.has_event(released)
    };
    fleet.assert_never("an entry, a move or a release", during, broken).await;
}

#[test]
fn a_robot_under_way_waits_before_a_closed_place_until_it_is_opened() {
    for_each_seed([1401, 1402, 1403], async |seed| {
        let (mut fleet, mission, carrier) = under_way(seed).await;
        let reply = close(&fleet, json!({ "places": [GATE] }), 3600).await;
        assert_eq!(reply["closures"][0]["part"]["place"], json!(GATE), "seed {seed}: {reply}");
        assert_eq!(reply["closures"][0]["order"]["by"], json!("Nia"), "seed {seed}: {reply}");
        assert_waits(&mut fleet, &carrier, longer_than_a_lease()).await;
        open(&fleet, &[GATE]).await;
        assert_completes_by(&mut fleet, &mission, ROOM, &carrier).await;
        let events = fleet.events().into_iter().filter_map(|what| match what {
            EventKind::ClosureChanged { part, order } => Some((part.to_string(), order.map(|order| order.by))),
            _ => None,
        });
        let expected = [(GATE.to_owned(), Some("Nia".to_owned())), (GATE.to_owned(), None)];
        assert_eq!(events.collect::<Vec<_>>(), expected, "seed {seed}");
        let changes = audited_changes(&fleet).await;
        let expected = json!([["a client", "submit", mission], ["Nia", "close", GATE], ["Abe", "open", GATE]]);
        assert_eq!(json!(changes), expected, "seed {seed}");
    });
}

/// A robot in contact with the coordinator heeds a closure within a second.
#[test]
fn a_robot_that_drives_towards_a_place_stops_when_it_is_closed() {
    for_each_seed([1405, 1406], async |seed| {
        let (mut fleet, mission, carrier) = under_way(seed).await;
        // The places of the lane are at 15 m and 21 m.
        let is_on_lane = |fleet: &Fleet| {
            let (x, y) = fleet.position(&carrier);
            (x - 6.0).abs() < 0.1 && (16.0..18.0).contains(&y)
        };
        fleet.wait_until("the lane", DRIVE, is_on_lane).await;
        close(&fleet, json!({ "places": ["IC Corridor 2"] }), 3600).await;
        let place = fleet.position(&carrier);
        let has_gone_on = |fleet: &Fleet| distance(fleet.position(&carrier), place) > 1.0 || fleet.has_event(released);
        fleet.assert_never("more than a metre, or a release", longer_than_a_lease(), has_gone_on).await;
        open(&fleet, &["IC Corridor 2"]).await;
        assert_completes_by(&mut fleet, &mission, ROOM, &carrier).await;
    });
}

#[test]
fn a_closed_lane_is_not_driven_until_its_time_has_passed() {
    for_each_seed([1411, 1412], async |seed| {
        let (mut fleet, mission, carrier) = under_way(seed).await;
        close(&fleet, json!({ "lanes": [[GATE, BEFORE]] }), 150).await;
        assert_waits(&mut fleet, &carrier, Duration::from_secs(20)).await;
        assert_completes_by(&mut fleet, &mission, ROOM, &carrier).await;
        let closures = fleet.ledger(|ledger| ledger.closures().count());
        assert_eq!(closures, Some(0), "seed {seed}: the ledger has forgotten the closure");
    });
}

#[test]
fn the_next_coordinator_keeps_a_place_closed() {
    for_each_seed([1421, 1422, 1423], async |seed| {
        let (mut fleet, mission, carrier) = under_way(seed).await;
        close(&fleet, json!({ "places": [GATE] }), 3600).await;
        assert_eq!(fleet.kill_coordinator().await.as_str(), "aster", "seed {seed}");
        fleet.wait_for_coordinator().await;
        assert_waits(&mut fleet, &carrier, longer_than_a_lease()).await;
        open(&fleet, &[GATE]).await;
        assert_completes_by(&mut fleet, &mission, ROOM, &carrier).await;
    });
}

#[test]
fn a_zone_is_closed_and_opened_by_its_name_also_after_a_takeover() {
    for_each_seed([1425, 1426], async |seed| {
        let (mut fleet, mission, carrier) = under_way(seed).await;
        let reply = close(&fleet, json!({ "places": [ZONE] }), 3600).await;
        let zone = json!({ "zone": { "name": ZONE, "places": [GATE, ROOM] } });
        assert_eq!(reply["closures"][0]["part"], zone, "seed {seed}: {reply}");
        assert_waits(&mut fleet, &carrier, Duration::from_secs(2)).await;
        assert_eq!(fleet.kill_coordinator().await.as_str(), "aster", "seed {seed}");
        fleet.wait_for_coordinator().await;
        assert_waits(&mut fleet, &carrier, longer_than_a_lease()).await;
        open(&fleet, &[ZONE]).await;
        assert_completes_by(&mut fleet, &mission, ROOM, &carrier).await;
        let zone = format!("zone {ZONE}");
        let changes = audited_changes(&fleet).await;
        let expected = json!([["a client", "submit", mission], ["Nia", "close", zone], ["Abe", "open", zone]]);
        assert_eq!(json!(changes), expected, "seed {seed}");
    });
}

#[test]
fn a_robot_restarts_and_still_does_not_enter_a_closed_place() {
    for_each_seed([1431, 1432], async |seed| {
        let (mut fleet, mission, carrier) = under_way(seed).await;
        close(&fleet, json!({ "places": [GATE] }), 3600).await;
        assert_waits(&mut fleet, &carrier, Duration::from_secs(2)).await;
        fleet.kill(&carrier).await;
        fleet.restart(&carrier).await;
        fleet.assert_never("an entry", longer_than_a_lease(), has_entered).await;
        open(&fleet, &[GATE]).await;
        fleet.assert_completes(&mission).await;
    });
}

#[test]
fn a_mission_into_a_closed_place_waits_and_its_refusals_name_the_closure() {
    for_each_seed([1441, 1442], async |seed| {
        let mut fleet = fleet(seed).await;
        close(&fleet, json!({ "places": [ROOM] }), 3600).await;
        let starts = ["fern", "gorse"].map(|carrier| fleet.position(carrier));
        let mission = fleet.submit("a", ROOM).await;
        let named = async |fleet: &Fleet| {
            let reply = fleet.request(ApiCall::Explain, &json!({ "mission": mission })).await?;
            let text = reply["text"].to_string();
            let is_named = text.contains("IC Room 6 is closed by Nia: wet floor, until ");
            is_named.then_some(())
        };
        fleet.poll_until("the refusals", SOON, named).await;
        let moved = |fleet: &Fleet| ["fern", "gorse"].map(|carrier| fleet.position(carrier)) != starts;
        fleet.assert_never("a move", Duration::from_secs(20), moved).await;
        open(&fleet, &[ROOM]).await;
        fleet.assert_completes(&mission).await;
        fleet.assert_sample_delivered(ROOM);
    });
}

#[test]
fn a_robot_inside_a_closed_place_may_leave_it() {
    for_each_seed([1451], async |seed| {
        let mut fleet = fleet(seed).await;
        close(&fleet, json!({ "places": ["Dock", "PC Room 8"] }), 3600).await;
        let mission = fleet.submit("a", ROOM).await;
        fleet.assert_completes(&mission).await;
        fleet.assert_sample_delivered(ROOM);
    });
}

#[test]
fn a_closure_without_a_place_is_rejected() {
    for_each_seed([1461], async |seed| {
        let fleet = fleet(seed).await;
        for (call, payload, expected) in [
            (ApiCall::Close, json!({}), "name a place or a zone in `places`, or a lane in `lanes`"),
            (ApiCall::Open, json!({}), "name a place or a zone in `places`, or a lane in `lanes`"),
            (ApiCall::Close, json!({ "places": [ROOM], "for_s": 0 }), "for_s is 0; allowed are 1 to "),
            (
                ApiCall::Close,
                json!({ "places": [ROOM], "for_s": 1, "until": "2100-01-01T00:00:00Z" }),
                "give `for_s` or `until`, not both",
            ),
        ] {
            let reply = fleet.request_answered(call, &payload).await;
            let error = reply["error"].as_str().unwrap_or_default();
            assert!(error.starts_with(expected), "seed {seed}: {payload}: {reply}");
        }
        assert_eq!(fleet.ledger(|ledger| ledger.closures().count()), Some(0), "seed {seed}");
    });
}
