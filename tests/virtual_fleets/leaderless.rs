//! Requests while there is no coordinator.

use consort_protocol::keys::ApiCall;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::json;
use std::time::Duration;
use tokio::time::Instant;

const ROOM: &str = "IC Room 6";

#[test]
fn a_request_without_a_leader_is_delayed_and_carried_out_once() {
    for_each_seed([621, 622, 623, 624], async |seed| {
        let robots = vec![RobotSpec::carrier("fern", "Dock"), RobotSpec::carrier("gorse", "IC Room 4")];
        let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove"], &[ROOM]).await;
        fleet.wait_for_coordinator().await;
        // No node can win an election until the links are restored, no matter how soon the nodes
        // stop following the last leader.
        let names = ["aster", "basil", "clove", "fern", "gorse", "lab-arm"];
        for (from, to) in names.iter().flat_map(|from| names.iter().map(move |to| (*from, *to))) {
            if from != to {
                fleet.network.cut(slug(from), slug(to));
            }
        }
        fleet.kill_coordinator().await;
        let request = json!({ "mission": "lab-samples", "parameters": { "room": ROOM }, "request": "my-7" });
        let mut put_off = 0;
        let mission = loop {
            let at = Instant::now();
            let answer = fleet.request(ApiCall::Submit, &request).await;
            assert!(fleet.elapsed() < Duration::from_secs(60), "seed {seed}: never\n{}", fleet.event_log_text());
            let Some(voice) = answer else { continue };
            if let Some(mission) = voice["mission"].as_str() {
                break mission.to_owned();
            }
            let error = voice["error"].as_str().expect("an error");
            assert!(
                error.starts_with("no coordinator yet") && error.ends_with(": retry after 300 ms"),
                "seed {seed}: {error}"
            );
            assert_eq!(voice["retry_after_ms"], 300, "seed {seed}");
            assert!(at.elapsed() < Duration::from_millis(300), "seed {seed}: not at once: {:?}", at.elapsed());
            put_off += 1;
            fleet.network.heal();
            tokio::time::sleep(Duration::from_millis(20)).await;
        };
        assert!(put_off > 0, "seed {seed}: no reply reported the missing coordinator\n{}", fleet.event_log_text());
        let missions = fleet.ledger(|ledger| ledger.missions().count());
        assert_eq!(missions, Some(1), "seed {seed}: done once");
        fleet.assert_completes(&mission.parse().expect("an id")).await;
    });
}

#[test]
fn an_error_without_a_quorum_counts_the_reachable_voters() {
    for_each_seed([631, 632], async |seed| {
        let robots = vec![RobotSpec::carrier("fern", "Dock").starting_later()];
        let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil"], &[ROOM]).await;
        fleet.wait_for_coordinator().await;
        for gone in ["aster", "basil"] {
            fleet.kill(gone).await;
        }
        let expected = "no coordinator yet (no quorum: 1 of 3 voters reachable): retry after 300 ms";
        let mut found = String::new();
        for _ in 0..400 {
            let voices = fleet.request_all(ApiCall::Cancel, &json!({ "mission": "lab-samples-9" })).await;
            assert!(voices.len() <= 1, "seed {seed}: {voices:?}");
            if let Some(error) = voices.first().and_then(|voice| voice["error"].as_str()) {
                found = error.to_owned();
            }
            if found == expected {
                break;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        assert_eq!(found, expected, "seed {seed}\n{}", fleet.event_log_text());
    });
}
