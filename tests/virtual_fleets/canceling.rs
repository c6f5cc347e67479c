//! Cancellation of a mission at any stage.

use crate::support::task_began;
use consort_fleet::node::NodeSettings;
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_protocol::lease::EndReason;
use consort_protocol::ledger::{HistoryLimits, Ledger, MissionState};
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::json;
use std::time::Duration;

const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

async fn fleet(seed: u64) -> Fleet {
    let robots = vec![RobotSpec::carrier("gorse", "IC Room 4")];
    let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove"], &[ROOM]).await;
    assert_eq!(fleet.wait_for_coordinator().await.as_str(), "aster", "seed {seed}: the coordinator");
    fleet
}

fn halted(mission: &MissionId) -> impl Fn(&EventKind) -> bool {
    move |what| matches!(what, EventKind::Halted { mission: of, .. } if of == mission)
}

/// Asserts that the robot does not move any more.
async fn assert_stands_still(fleet: &mut Fleet) {
    fleet.wait_for_rest("gorse").await;
    let place = fleet.position("gorse");
    fleet.assert_never("a drive", Duration::from_secs(3), |fleet| fleet.position("gorse") != place).await;
}

#[test]
fn a_mission_can_be_canceled_at_any_stage_of_its_award() {
    for_each_seed([681, 682], async |seed| {
        let mut fleet = fleet(seed).await;
        // From before the first call for bids to after the first task.
        for (number, after_ms) in [0, 1, 2, 3, 4, 6, 8, 12, 20, 40, 80, 200].into_iter().enumerate() {
            let mission = fleet.submit(&format!("r{number}"), ROOM).await;
            tokio::time::sleep(Duration::from_millis(after_ms)).await;
            let answer = fleet.request_answered(ApiCall::Cancel, &json!({ "mission": mission, "by": "Nia" })).await;
            let context = format!("seed {seed}: canceled after {after_ms} ms");
            assert_eq!(answer["state"], json!({ "canceled": { "by": "Nia" } }), "{context}");
            let begun = |fleet: &Fleet| {
                fleet.event_log.count(|what| matches!(what, EventKind::Started { mission: of, .. } if *of == mission))
            };
            fleet
                .wait_until(&format!("{context}: all to stop"), SOON, |fleet| {
                    fleet.event_log.count(halted(&mission)) == begun(fleet)
                })
                .await;
            assert_stands_still(&mut fleet).await;
            assert_eq!(fleet.event_log.count(halted(&mission)), begun(&fleet), "{context}\n{}", fleet.event_log_text());
        }
        // The fleet still works.
        let mission = fleet.submit("last", ROOM).await;
        fleet.assert_completes(&mission).await;
        fleet.assert_exclusive_roles();
    });
}

#[test]
fn a_mission_can_be_canceled_while_its_robot_is_suspended() {
    for_each_seed([691, 692], async |seed| {
        let mut fleet = fleet(seed).await;
        let mission = fleet.submit("a", ROOM).await;
        fleet.wait_until("the way to the room", SOON, |fleet| fleet.has_event(task_began("navto_room"))).await;
        fleet.cut_off(&["gorse"]);
        fleet.wait_for_next("gorse to suspend", SOON, |what| matches!(what, EventKind::Suspended { .. })).await;
        fleet.request_answered(ApiCall::Cancel, &json!({ "mission": mission, "by": "Nia" })).await;
        fleet.heal();
        let canceled = |what: &EventKind| matches!(what, EventKind::Halted { reason: EndReason::Canceled, .. });
        fleet.wait_until("both to halt", SOON, |fleet| fleet.event_log.count(canceled) == 2).await;
        assert_stands_still(&mut fleet).await;
        assert_eq!(fleet.state(&mission).as_deref(), Some("canceled"), "seed {seed}");
    });
}

#[test]
fn a_mission_can_be_canceled_without_a_coordinator() {
    for_each_seed([701, 702], async |seed| {
        let mut fleet = fleet(seed).await;
        let mission = fleet.submit("a", ROOM).await;
        fleet.wait_until("the way to the room", SOON, |fleet| fleet.has_event(task_began("navto_room"))).await;
        fleet.kill("aster").await;
        let request = json!({ "mission": mission, "by": "Nia" });
        let settled = async |fleet: &Fleet| {
            fleet.request(ApiCall::Cancel, &request).await.filter(|answer| answer.get("retry_after_ms").is_none())
        };
        let answer = fleet.poll_until("a reply of the next coordinator", SOON, settled).await;
        assert_eq!(answer["state"], json!({ "canceled": { "by": "Nia" } }), "seed {seed}");
        fleet.wait_until("both to halt", SOON, |fleet| fleet.event_log.count(halted(&mission)) == 2).await;
        assert_stands_still(&mut fleet).await;
    });
}

#[test]
fn a_canceled_mission_with_a_held_item_needs_intervention() {
    for_each_seed([711, 712], async |seed| {
        let mut fleet = fleet(seed).await;
        let mission = fleet.submit("a", ROOM).await;
        fleet.wait_until("the way to the laboratory", SOON, |fleet| fleet.has_event(task_began("navto_lab"))).await;
        fleet.request_answered(ApiCall::Cancel, &json!({ "mission": mission, "by": "Nia" })).await;
        let MissionState::NeedsIntervention { cause, items, .. } = fleet.wait_for_end(&mission).await else {
            panic!("seed {seed}: it ended in another state\n{}", fleet.event_log_text())
        };
        let place = items[0].place.as_ref().expect("known");
        assert_eq!(cause, format!("canceled by Nia; the sample is with gorse at {place}"), "seed {seed}");
        let rescue = |what: &EventKind| matches!(what, EventKind::Halted { reason: EndReason::NeedsIntervention, .. });
        fleet.wait_until("both to halt", SOON, |fleet| fleet.event_log.count(rescue) == 2).await;
        assert_stands_still(&mut fleet).await;
        for by in ["Nia", "Abe"] {
            let answer = fleet.request_answered(ApiCall::Cancel, &json!({ "mission": mission, "by": by })).await;
            assert_eq!(answer["state"]["needs_intervention"]["cause"], json!(cause), "seed {seed}: {by}");
        }
        let answer = fleet.request_answered(ApiCall::Resolve, &json!({ "mission": mission, "by": "Abe" })).await;
        let cause = format!("{cause}; resolved by Abe");
        assert_eq!(answer["state"], json!({ "failed": { "cause": cause, "class": "transient" } }), "seed {seed}");
        assert_eq!(
            fleet.mission_state(&slug(mission.as_str())).map(|state| state.is_final()),
            Some(true),
            "seed {seed}"
        );
    });
}

/// The ledger has dropped the mission before the coordinator compares it with its session.
#[test]
fn the_end_of_a_mission_is_published_although_no_ended_mission_is_kept() {
    for_each_seed([721, 722], async |seed| {
        let limits = HistoryLimits { missions_max: 0, ..HistoryLimits::default() };
        let adjust = Box::new(move |settings: &mut NodeSettings| settings.fleet.history_limits = limits);
        let robots = vec![RobotSpec::carrier("gorse", "IC Room 4")];
        let mut fleet = Fleet::adjusted_hospital(seed, robots, &["aster"], &[ROOM], adjust).await;
        fleet.wait_for_coordinator().await;
        let in_force = |fleet: &Fleet| fleet.ledger(Ledger::history_limits).flatten() == Some(limits);
        fleet.wait_until("the limits of the history", SOON, in_force).await;
        let mission = fleet.submit("a", ROOM).await;
        fleet.wait_until("the way to the room", SOON, |fleet| fleet.has_event(task_began("navto_room"))).await;
        let reply = fleet.request_answered(ApiCall::Cancel, &json!({ "mission": mission, "by": "Nia" })).await;
        assert_eq!(reply["state"], json!({ "canceled": { "by": "Nia" } }), "seed {seed}");
        assert_eq!(fleet.ledger(|ledger| ledger.mission(&mission).is_none()), Some(true), "seed {seed}");
        let ended = |what: &EventKind| match what {
            EventKind::Mission { mission: of, state, .. } => *of == mission && state.has_ended(),
            _ => false,
        };
        fleet.wait_until("the end of the mission", SOON, |fleet| fleet.event_log.count(ended) == 1).await;
        fleet.wait_until("both to halt", SOON, |fleet| fleet.event_log.count(halted(&mission)) == 2).await;
        assert_eq!(fleet.event_log.count(ended), 1, "seed {seed}");
    });
}
