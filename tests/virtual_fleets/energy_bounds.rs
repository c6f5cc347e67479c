//! Bounds on the energy of missions.

use crate::support::task_began;
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::MissionState;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::{Value, json};
use std::time::Duration;

const SEEDS: [u64; 2] = [931, 932];
const SOON: Duration = Duration::from_secs(60);

/// Time from a request to a failure without an attempt: a bid window, and commits.
const AT_ONCE: Duration = Duration::from_secs(3);

/// Starts a fleet of a robot that is near the room and a robot that is farther away.
async fn fleet(seed: u64) -> Fleet {
    let robots = vec![RobotSpec::carrier("gorse", "IC Room 4"), RobotSpec::carrier("fern", "Dock")];
    let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove"], &[]).await;
    fleet.wait_for_coordinator().await;
    let all = async |fleet: &Fleet| (members(fleet).await == ["fern", "gorse", "lab-arm"]).then_some(());
    fleet.poll_until("all robots as members", SOON, all).await;
    fleet
}

async fn members(fleet: &Fleet) -> Vec<String> {
    let views = fleet.view("ensembles").await;
    let members = views.get("ensembles").and_then(|view| view["ensembles"][0]["members"].as_array().cloned());
    members.unwrap_or_default().iter().filter_map(Value::as_str).map(str::to_owned).collect()
}

/// Submits a drive to a room with a bound on its energy.
async fn submit(fleet: &Fleet, energy_max: f64) -> MissionId {
    let mission = json!({
        "mission": "drive", "roles": { "r1": { "kind": "managed" } }, "energy_max": energy_max,
        "root": { "task": "go", "type": "navigation", "roles": ["r1"], "parameters": { "to": "IC Room 6" },
            "reaches": { "location": "IC Room 6" } },
    });
    let answer = fleet.request_answered(ApiCall::Submit, &json!({ "mission": mission })).await;
    slug(answer["mission"].as_str().unwrap_or_else(|| panic!("{answer}")))
}

async fn view(fleet: &Fleet, mission: &MissionId) -> Value {
    fleet.request_answered(ApiCall::Get, &json!({ "mission": mission })).await
}

/// Returns the energy that the bid of a robot for a mission has estimated.
fn estimate(fleet: &Fleet, mission: &MissionId, robot: &str) -> f64 {
    let energy = |kind: EventKind| match kind {
        EventKind::Bid { mission: of, bid } if of == *mission && bid.robot.as_str() == robot => Some(bid.energy),
        _ => None,
    };
    let energy = fleet.events().into_iter().find_map(energy);
    energy.unwrap_or_else(|| panic!("no bid of {robot}\n{}", fleet.event_log_text()))
}

/// Submits a drive whose bound is too small for every robot. Returns the estimates of both robots.
async fn estimates(fleet: &mut Fleet) -> (f64, f64) {
    let begin = fleet.elapsed();
    let mission = submit(fleet, 0.001).await;
    let MissionState::Failed { cause, .. } = fleet.wait_for_end(&mission).await else {
        panic!("{}", fleet.event_log_text())
    };
    assert!(fleet.elapsed() - begin < AT_ONCE, "seed {}: after {:?}", fleet.seed, fleet.elapsed() - begin);
    let (gorse, fern) = (estimate(fleet, &mission, "gorse"), estimate(fleet, &mission, "fern"));
    let expected = format!(
        "the mission would exceed its bound on energy, energy_max 0.001: the open roles need at least {gorse:.3} of a \
         full battery (gorse as r1)"
    );
    assert_eq!(cause, expected, "seed {}", fleet.seed);
    let view = view(fleet, &mission).await;
    assert_eq!(view["auction"]["failure"], cause, "seed {}: the auction explains the failure: {view}", fleet.seed);
    let awarded = |kind: &EventKind| matches!(kind, EventKind::Awarded { mission: of, .. } if *of == mission);
    assert!(!fleet.has_event(awarded), "seed {}\n{}", fleet.seed, fleet.event_log_text());
    assert!(gorse < fern, "seed {}: {gorse} and {fern}", fleet.seed);
    (gorse, fern)
}

/// Submits a drive, and kills the robot that has begun it.
async fn submit_and_lose_the_first_robot(fleet: &mut Fleet, energy_max: f64) -> MissionId {
    let mission = submit(fleet, energy_max).await;
    let began = task_began("go");
    fleet.wait_until("the drive", SOON, |fleet| fleet.has_event(&began)).await;
    assert_eq!(fleet.holder(&mission, "r1"), Some(slug("gorse")), "seed {}", fleet.seed);
    fleet.kill("gorse").await;
    mission
}

#[test]
fn a_mission_fails_at_once_if_every_robot_exceeds_its_bound() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed).await;
        let (gorse, _) = estimates(&mut fleet).await;
        let mission = submit(&fleet, gorse * 1.05).await;
        fleet.assert_completes(&mission).await;
        let view = view(&fleet, &mission).await;
        assert_eq!(view["energy_max"], gorse * 1.05, "seed {seed}");
        let used = view["energy"].as_f64().expect("a number");
        assert!((used - gorse).abs() < 0.05 * gorse, "seed {seed}: {used} and {gorse}");
        let explained = fleet.request_answered(ApiCall::Explain, &json!({ "mission": mission })).await;
        let line =
            format!("its awards are estimated at {used:.3} of a full battery; energy_max is {:.3}", gorse * 1.05);
        assert!(explained["text"].as_array().is_some_and(|text| text.contains(&json!(line))), "{explained}");
    });
}

#[test]
fn an_award_after_a_loss_counts_the_energy_of_the_first() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed).await;
        let (gorse, fern) = estimates(&mut fleet).await;
        // The bound permits each robot, and not one after the other.
        let mission = submit_and_lose_the_first_robot(&mut fleet, fern * 1.05).await;
        let end = fleet.wait_for_end(&mission).await;
        let MissionState::Failed { cause, .. } = end else {
            panic!("seed {seed}: {end:?}\n{}", fleet.event_log_text())
        };
        let (needs, used) = (format!("at least {fern:.3} "), format!("earlier awards were estimated at {gorse:.3}"));
        assert!(cause.contains(&needs) && cause.ends_with(&used), "seed {seed}: {cause}");
    });
}

#[test]
fn a_larger_bound_permits_an_award_after_a_loss() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed).await;
        let (gorse, fern) = estimates(&mut fleet).await;
        let mission = submit_and_lose_the_first_robot(&mut fleet, (gorse + fern) * 1.05).await;
        fleet.assert_completes(&mission).await;
        assert_eq!(fleet.holder(&mission, "r1"), Some(slug("fern")), "seed {seed}");
        let used = view(&fleet, &mission).await["energy"].as_f64().expect("a number");
        assert!((used - gorse - fern).abs() < 0.05 * fern, "seed {seed}: {used}");
    });
}
