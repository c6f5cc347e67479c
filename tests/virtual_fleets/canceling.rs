//! A mission is withdrawn, however far it has come.

use crate::usual::began;
use consort_protocol::event::Happening;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_protocol::lease::Ending;
use consort_protocol::ledger::MissionState;
use consort_tests::{Fleet, Member, slug, tell};
use serde_json::json;
use std::time::Duration;

const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

async fn fleet(seed: u64) -> Fleet {
    let robots = vec![Member::carrier("gorse", "IC Room 4")];
    let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove"], &[ROOM]).await;
    assert_eq!(fleet.coordinator().await.as_str(), "aster", "seed {seed}: who coordinates");
    fleet
}

fn halted(mission: &MissionId) -> impl Fn(&Happening) -> bool {
    move |what| matches!(what, Happening::Halted { mission: of, .. } if of == mission)
}

/// Nothing moves any more.
async fn stands_still(fleet: &mut Fleet) {
    fleet.comes_to_rest("gorse").await;
    let place = fleet.position("gorse");
    fleet.never("a drive", Duration::from_secs(3), |fleet| fleet.position("gorse") != place).await;
}

#[test]
fn while_it_is_called_proposed_awarded_and_confirmed() {
    tell([681, 682], async |seed| {
        let mut fleet = fleet(seed).await;
        // From before the first call to after the first task.
        for (number, after_ms) in [0, 1, 2, 3, 4, 6, 8, 12, 20, 40, 80, 200].into_iter().enumerate() {
            let mission = fleet.submit(&format!("r{number}"), ROOM).await;
            tokio::time::sleep(Duration::from_millis(after_ms)).await;
            let answer = fleet.answer(ApiCall::Cancel, &json!({ "mission": mission, "by": "Nia" })).await;
            let story = format!("seed {seed}: canceled after {after_ms} ms");
            assert_eq!(answer["state"], json!({ "canceled": { "by": "Nia" } }), "{story}");
            let begun = |fleet: &Fleet| {
                fleet.chronicle.count(|what| matches!(what, Happening::Started { mission: of, .. } if *of == mission))
            };
            fleet
                .until(&format!("{story}: all to stop"), SOON, |fleet| {
                    fleet.chronicle.count(halted(&mission)) == begun(fleet)
                })
                .await;
            stands_still(&mut fleet).await;
            assert_eq!(fleet.chronicle.count(halted(&mission)), begun(&fleet), "{story}\n{}", fleet.tale());
        }
        // The fleet is none the worse for it.
        let mission = fleet.submit("last", ROOM).await;
        fleet.completes(&mission).await;
        fleet.one_role_one_robot();
    });
}

#[test]
fn while_its_robot_is_suspended() {
    tell([691, 692], async |seed| {
        let mut fleet = fleet(seed).await;
        let mission = fleet.submit("a", ROOM).await;
        fleet.until("the way to the room", SOON, |fleet| fleet.happened(began("navto_room"))).await;
        fleet.cut_off(&["gorse"]);
        fleet.next("gorse to suspend", SOON, |what| matches!(what, Happening::Suspended { .. })).await;
        fleet.answer(ApiCall::Cancel, &json!({ "mission": mission, "by": "Nia" })).await;
        fleet.heal();
        let canceled = |what: &Happening| matches!(what, Happening::Halted { reason: Ending::Canceled, .. });
        fleet.until("both to halt", SOON, |fleet| fleet.chronicle.count(canceled) == 2).await;
        stands_still(&mut fleet).await;
        assert_eq!(fleet.state(&mission).as_deref(), Some("canceled"), "seed {seed}");
    });
}

#[test]
fn while_nobody_coordinates() {
    tell([701, 702], async |seed| {
        let mut fleet = fleet(seed).await;
        let mission = fleet.submit("a", ROOM).await;
        fleet.until("the way to the room", SOON, |fleet| fleet.happened(began("navto_room"))).await;
        fleet.kill("aster").await;
        let asked = json!({ "mission": mission, "by": "Nia" });
        let settled = async |fleet: &Fleet| {
            fleet.ask(ApiCall::Cancel, &asked).await.filter(|answer| answer.get("retry_after_ms").is_none())
        };
        let answer = fleet.seen("an answer of the next coordinator", SOON, settled).await;
        assert_eq!(answer["state"], json!({ "canceled": { "by": "Nia" } }), "seed {seed}");
        fleet.until("both to halt", SOON, |fleet| fleet.chronicle.count(halted(&mission)) == 2).await;
        stands_still(&mut fleet).await;
    });
}

#[test]
fn with_the_sample_in_a_drawer_it_needs_rescue_which_no_further_cancellation_closes() {
    tell([711, 712], async |seed| {
        let mut fleet = fleet(seed).await;
        let mission = fleet.submit("a", ROOM).await;
        fleet.until("the way to the laboratory", SOON, |fleet| fleet.happened(began("navto_lab"))).await;
        fleet.answer(ApiCall::Cancel, &json!({ "mission": mission, "by": "Nia" })).await;
        let MissionState::NeedsRescue { cause, items } = fleet.end_of(&mission).await else {
            panic!("seed {seed}: it ended otherwise\n{}", fleet.tale())
        };
        let place = items[0].place.as_ref().expect("known");
        assert_eq!(cause, format!("canceled by Nia; the sample is with gorse at {place}"), "seed {seed}");
        let rescue = |what: &Happening| matches!(what, Happening::Halted { reason: Ending::Rescue, .. });
        fleet.until("both to halt", SOON, |fleet| fleet.chronicle.count(rescue) == 2).await;
        stands_still(&mut fleet).await;
        for by in ["Nia", "Abe"] {
            let answer = fleet.answer(ApiCall::Cancel, &json!({ "mission": mission, "by": by })).await;
            assert_eq!(answer["state"]["needs_rescue"]["cause"], json!(cause), "seed {seed}: {by}");
        }
        let answer = fleet.answer(ApiCall::Rescued, &json!({ "mission": mission, "by": "Abe" })).await;
        let cause = format!("{cause}; rescued by Abe");
        assert_eq!(answer["state"], json!({ "failed": { "cause": cause } }), "seed {seed}");
        assert_eq!(fleet.state_of(&slug(mission.as_str())).map(|state| state.is_end()), Some(true), "seed {seed}");
    });
}
