//! Conditions of task types on readings of the robots.

use consort_protocol::auction::{BidVerdict, RefusalReason};
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_protocol::yaml;
use consort_skills::domain_file::DomainFile;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::json;
use std::collections::BTreeMap;
use std::time::Duration;

const SEEDS: [u64; 2] = [951, 952];
const SOON: Duration = Duration::from_secs(60);

/// A robot that waters needs water, and has enough for one time.
const DOMAIN: &str = r#"
domain: watering
actions:
  fill: { simulate: { duration_s: [1, 2], effects: { tank_l: 1 } } }
  water: { simulate: { duration_s: [1, 2], effects: { tank_l: { add: -1 } } } }
readings: { tank_l: { type: number, unit: l, minimum: 0, maximum: 5, simulate: { value: 1 } } }
tasks:
  fill: { action: fill }
  water: { action: water, requires: "readings.tank_l >= 1.0" }
"#;

async fn submit(fleet: &Fleet, task: &str) -> MissionId {
    let mission = json!({
        "mission": task, "roles": { "r1": { "kind": "managed" } },
        "root": { "task": "it", "type": task, "roles": ["r1"] },
    });
    let answer = fleet.request_answered(ApiCall::Submit, &json!({ "mission": mission })).await;
    slug(answer["mission"].as_str().unwrap_or_else(|| panic!("{answer}")))
}

/// Returns the reasons for which the robot was not eligible for the role of a mission, and whether each is permanent.
fn refusals(fleet: &Fleet, of: &MissionId) -> Vec<(String, bool)> {
    let records = fleet.events().into_iter().filter_map(|kind| match kind {
        EventKind::Closed { record, .. } if record.auction.mission == *of => Some(record),
        _ => None,
    });
    let entries = records.flat_map(|record| record.entries).filter(|entry| entry.robot.as_str() == "amber");
    let refused = entries.filter_map(|entry| match entry.verdict {
        BidVerdict::Refused { reason: RefusalReason::NotEligible { why, permanent } } => Some((why, permanent)),
        _ => None,
    });
    refused.collect()
}

/// The reading changes, so the refusal is not final: the mission waits, and starts when the robot has been filled.
#[test]
fn a_mission_waits_until_a_reading_meets_the_condition_of_its_task() {
    for_each_seed(SEEDS, async |seed| {
        let domain = DomainFile::check(yaml::parse(DOMAIN).expect("YAML"), &BTreeMap::new(), &[]).expect("a domain");
        let robot = RobotSpec::carrier("amber", "Dock").with_skills(&["fill", "water", "operate_drawer"]);
        let mut fleet = Fleet::hospital_of_domain(seed, vec![robot], &["post"], domain).await;
        fleet.wait_for_coordinator().await;
        let first = submit(&fleet, "water").await;
        fleet.assert_completes(&first).await;

        let second = submit(&fleet, "water").await;
        fleet.wait_until("a refusal", SOON, |fleet| !refusals(fleet, &second).is_empty()).await;
        for (why, permanent) in refusals(&fleet, &second) {
            let expected = "water requires `readings.tank_l >= 1.0`, which is false";
            assert!(why.ends_with(expected) && !permanent, "seed {seed}: {why}");
        }
        let is_active = fleet.mission_state(&second).is_some_and(|state| !state.is_final());
        assert!(is_active, "seed {seed}\n{}", fleet.event_log_text());

        let filled = submit(&fleet, "fill").await;
        fleet.assert_completes(&filled).await;
        fleet.assert_completes(&second).await;
    });
}
