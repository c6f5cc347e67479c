//! People limit the speed of robots.

use crate::closures::{DRIVE, ROOM, SOON, fleet, under_way};
use crate::support::{assert_completes_by, request};
use consort_protocol::event::EventKind;
use consort_protocol::keys::ApiCall;
use consort_tests::{Fleet, for_each_seed};
use serde_json::{Value, json};
use std::ops::Range;
use std::time::Duration;

/// A lane of the only way to the room, 6 m to the north.
const LANE: [&str; 2] = ["IC Corridor 4", "IC Corridor 2"];
const LANE_X_M: f64 = 6.0;
const LANE_Y_M: Range<f64> = 15.0..21.0;
/// The carriers drive at 0.6 and 0.7 m/s. On the lane they need two minutes of the world at this speed.
const LIMIT_MPS: f64 = 0.05;
/// Least number of observations of a slow robot on the lane.
const OBSERVED_MIN: usize = 20;

async fn limit(fleet: &Fleet, mut payload: Value) -> Value {
    payload["action"] = json!("set");
    payload["speed_mps"] = json!(LIMIT_MPS);
    payload["for_s"] = json!(3600);
    payload["reason"] = json!("wet floor");
    payload["by"] = json!("Nia");
    request(fleet, ApiCall::Limit, &payload).await
}

/// The speeds of a robot on the lane between two observations each.
#[derive(Default)]
struct LaneSpeeds {
    /// Time and `y` of the latest observation, if the robot was on the lane.
    last: Option<(f64, f64)>,
    count: usize,
    fastest_mps: f64,
}

impl LaneSpeeds {
    /// Adds an observation. Returns whether the robot has left the lane to the north.
    fn observe(&mut self, fleet: &Fleet, robot: &str) -> bool {
        let (time_s, (x, y)) = (fleet.world_time_s(), fleet.position(robot));
        let now = ((x - LANE_X_M).abs() < 0.1 && LANE_Y_M.contains(&y)).then_some((time_s, y));
        if let Some((last_s, last_y)) = self.last
            && now.is_some()
            && time_s > last_s
        {
            self.count += 1;
            self.fastest_mps = self.fastest_mps.max((y - last_y).abs() / (time_s - last_s));
        }
        self.last = now;
        y >= LANE_Y_M.end
    }

    fn is_slow(&self) -> bool {
        self.fastest_mps <= LIMIT_MPS + 1e-6
    }

    fn assert_slow(&self, fleet: &Fleet) {
        let LaneSpeeds { count, fastest_mps, .. } = self;
        assert!(*count >= OBSERVED_MIN, "seed {}: {count} observations", fleet.seed);
        assert!(self.is_slow(), "seed {}: {fastest_mps} m/s\n{}", fleet.seed, fleet.event_log_text());
    }
}

#[test]
fn a_robot_keeps_to_a_speed_limit_through_a_takeover_until_it_is_cleared() {
    for_each_seed([1501, 1502, 1503], async |seed| {
        let (mut fleet, mission, carrier) = under_way(seed).await;
        let reply = limit(&fleet, json!({ "lanes": [LANE] })).await;
        let part = json!({ "lane": ["IC Corridor 2", "IC Corridor 4"] });
        assert_eq!(reply["speed_limits"][0]["part"], part, "seed {seed}: {reply}");
        let mut speeds = LaneSpeeds::default();
        let is_seen_there = |fleet: &Fleet| {
            speeds.observe(fleet, &carrier);
            speeds.count >= OBSERVED_MIN
        };
        fleet.wait_until("the carrier on the lane", DRIVE, is_seen_there).await;
        assert_eq!(fleet.kill_coordinator().await.as_str(), "aster", "seed {seed}");
        fleet.wait_for_coordinator().await;
        assert!(LANE_Y_M.contains(&fleet.position(&carrier).1), "seed {seed}: it is on the lane");
        fleet.wait_until("the end of the lane", DRIVE, |fleet| speeds.observe(fleet, &carrier)).await;
        speeds.assert_slow(&fleet);
        let clear = json!({ "lanes": [LANE], "action": "clear", "by": "Abe" });
        let reply = request(&fleet, ApiCall::Limit, &clear).await;
        assert_eq!(reply["speed_limits"], json!([]), "seed {seed}");
        assert_completes_by(&mut fleet, &mission, ROOM, &carrier).await;
        let trail = request(&fleet, ApiCall::Audit, &json!({ "linearizable": true })).await;
        let entries = trail["entries"].as_array().expect("entries").iter();
        let limits = entries.filter(|entry| entry["action"].as_str().is_some_and(|action| action.contains("speed")));
        let changes: Vec<_> = limits.map(|entry| [&entry["by"], &entry["action"], &entry["details"]]).collect();
        let set = json!(["Nia", "limit_speed", "0.05 m/s: for 3600 s: wet floor"]);
        assert_eq!(json!(changes), json!([set, ["Abe", "clear_speed_limit", ""]]), "seed {seed}: {trail}");
    });
}

#[test]
fn a_robot_on_a_lane_is_slowed_at_once_when_people_limit_its_speed() {
    for_each_seed([1511, 1512], async |seed| {
        let (mut fleet, mission, carrier) = under_way(seed).await;
        let mut speeds = LaneSpeeds::default();
        let is_on_lane = |fleet: &Fleet| {
            speeds.observe(fleet, &carrier);
            speeds.count > 0 && (16.0..17.0).contains(&fleet.position(&carrier).1)
        };
        fleet.wait_until("the carrier on the lane", DRIVE, is_on_lane).await;
        assert!(!speeds.is_slow(), "seed {seed}: there is no limit yet");
        limit(&fleet, json!({ "places": [LANE[1]] })).await;
        let is_slowed = |fleet: &Fleet| {
            speeds = LaneSpeeds { last: speeds.last, ..LaneSpeeds::default() };
            speeds.observe(fleet, &carrier);
            speeds.count > 0 && speeds.is_slow()
        };
        fleet.wait_until("a slow carrier", Duration::from_secs(1), is_slowed).await;
        fleet.wait_until("the end of the lane", DRIVE, |fleet| speeds.observe(fleet, &carrier)).await;
        speeds.assert_slow(&fleet);
        assert_completes_by(&mut fleet, &mission, ROOM, &carrier).await;
    });
}

#[test]
fn bids_count_with_a_speed_limit() {
    for_each_seed([1521, 1522], async |seed| {
        let mut fleet = fleet(seed).await;
        fleet.wait_for_audit_trail().await;
        limit(&fleet, json!({ "lanes": [LANE] })).await;
        let mission = fleet.submit("a", ROOM).await;
        fleet.wait_until("the award", SOON, |fleet| fleet.holder(&mission, "r1").is_some()).await;
        let records = fleet.events().into_iter().filter_map(|what| match what {
            EventKind::Closed { record, .. } => Some(record),
            _ => None,
        });
        let parts = records.flat_map(|record| record.entries).flat_map(|entry| entry.parts);
        let drives: Vec<f64> = parts.filter(|part| part.label == "navto_room").map(|part| part.time.get()).collect();
        let least_s = (LANE_Y_M.end - LANE_Y_M.start) / LIMIT_MPS;
        assert!(!drives.is_empty() && drives.iter().all(|time_s| *time_s > least_s), "seed {seed}: {drives:?}");
    });
}

#[test]
fn a_speed_limit_needs_a_speed_and_a_place() {
    for_each_seed([1531], async |seed| {
        let fleet = fleet(seed).await;
        for (payload, expected) in [
            (json!({ "places": [ROOM], "action": "set" }), "the action `set` needs `speed_mps`"),
            (json!({ "places": [ROOM], "action": "set", "speed_mps": 0.01 }), "speed_mps is 0.01; allowed are 0.05 or"),
            (json!({ "action": "set", "speed_mps": 0.3 }), "name a place or a zone in `places`, or a lane in `lanes`"),
            (json!({ "places": [ROOM], "action": "clear", "speed_mps": 0.3 }), "`speed_mps`, `for_s`, `until` and"),
        ] {
            let reply = fleet.request_answered(ApiCall::Limit, &payload).await;
            let error = reply["error"].as_str().unwrap_or_default();
            assert!(error.starts_with(expected), "seed {seed}: {payload}: {reply}");
        }
        assert_eq!(fleet.ledger(|ledger| ledger.speed_limits().count()), Some(0), "seed {seed}");
    });
}
