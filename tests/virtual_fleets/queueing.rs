//! More missions than robots.

use crate::support::task_began;
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::{Ledger, MissionState};
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::json;
use std::collections::BTreeMap;
use std::time::Duration;

const SEEDS: [u64; 3] = [71, 72, 73];
const SOON: Duration = Duration::from_secs(60);
const ROOMS: [&str; 3] = ["IC Room 6", "PC Room 8", "PC Room 2"];

async fn fleet(seed: u64) -> Fleet {
    let robots = vec![
        RobotSpec::carrier("amber", "PC Room 8"),
        RobotSpec::carrier("birch", "IC Room 4"),
        RobotSpec::arm("lab-arm-1", "Laboratory"),
        RobotSpec::arm("lab-arm-2", "Laboratory"),
    ];
    let mut fleet = Fleet::hospital(seed, robots, &["aba"], &ROOMS).await;
    fleet.wait_for_coordinator().await;
    fleet
}

/// Returns the robots with a role, each as often as it holds one.
fn holding(ledger: &Ledger) -> Vec<String> {
    let live = ledger.active_missions().into_iter();
    let held = live.flat_map(|entry| entry.holders().into_values().filter(|robot| ledger.held_by(robot).is_some()));
    held.map(|robot| robot.to_string()).collect()
}

fn completed(fleet: &Fleet, missions: &[MissionId]) -> usize {
    missions.iter().filter(|mission| fleet.state(mission).as_deref() == Some("completed")).count()
}

#[test]
fn three_missions_share_two_carriers_with_a_role_each() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed).await;
        let mut missions = vec![];
        for (request, room) in ["a", "b", "c"].into_iter().zip(ROOMS) {
            missions.push(fleet.submit(request, room).await);
        }
        let third = missions[2].clone();

        // The third mission waits; the list and the mission view contain the reason.
        let why =
            |fleet: &Fleet| fleet.ledger(|ledger| ledger.mission(&third)?.auction.as_ref()?.failure.clone()).flatten();
        fleet.wait_until("the reason", SOON, |fleet| why(fleet).is_some()).await;
        let views = fleet.view("missions").await;
        let listed = views["missions"]["missions"].as_array().expect("a list");
        let shown: Vec<_> = listed.iter().map(|brief| brief["mission"].as_str().expect("an id").to_owned()).collect();
        assert_eq!(shown, missions.iter().map(ToString::to_string).collect::<Vec<_>>(), "seed {seed}");
        assert_eq!(listed[2]["state"], "pending", "seed {seed}");
        assert_eq!(listed[2]["pending_reason"], "no viable bid for lab_arm, r1", "seed {seed}");
        // The health names the missions that have the arms and the carriers.
        let health = fleet.view("health").await;
        let findings = health["health"]["findings"].as_array().expect("a list");
        let texts: Vec<&str> = findings.iter().filter_map(|finding| finding["text"].as_str()).collect();
        for holder in &missions[..2] {
            let is_named = |text: &&str| {
                text.starts_with(&format!("{holder} holds ")) && text.ends_with(&format!(", for which {third} waits"))
            };
            assert!(texts.iter().any(is_named), "seed {seed}: {texts:?}");
        }

        let mut twice = vec![];
        let mut first_end = None;
        fleet
            .wait_until("all three to end", Duration::from_secs(120), |fleet| {
                if let Some(mut holding) = fleet.ledger(holding) {
                    let all = holding.len();
                    holding.sort();
                    holding.dedup();
                    if holding.len() < all {
                        twice.push((fleet.elapsed(), holding));
                    }
                }
                let done = completed(fleet, &missions);
                if done > 0 && first_end.is_none() {
                    first_end = Some(fleet.elapsed());
                }
                done == 3
            })
            .await;
        assert!(twice.is_empty(), "seed {seed}: {twice:?}\n{}", fleet.event_log_text());
        fleet.assert_exclusive_roles();

        let awarded = |what: &EventKind| matches!(what, EventKind::Awarded { mission, .. } if *mission == third);
        let [started] = fleet.event_log.times(awarded)[..] else {
            panic!("seed {seed}: expected a single award\n{}", fleet.event_log_text())
        };
        let waited = started.checked_sub(first_end.expect("seen")).expect("the third came last");
        assert!(
            waited < Duration::from_secs(1),
            "seed {seed}: {waited:?} after a robot was free\n{}",
            fleet.event_log_text()
        );

        for (mission, room) in missions.iter().zip(ROOMS) {
            fleet.assert_each_task_once(mission);
            fleet.assert_sample_delivered(room);
        }
        // A carrier won, finished and won again.
        let mut wins: BTreeMap<String, usize> = BTreeMap::new();
        for mission in &missions {
            *wins.entry(fleet.holder(mission, "r1").expect("the holder").to_string()).or_default() += 1;
        }
        assert_eq!(wins.values().sum::<usize>(), 3, "seed {seed}: {wins:?}");
        assert_eq!(wins.values().copied().max(), Some(2), "seed {seed}: {wins:?}");
    });
}

#[test]
fn a_waiting_mission_survives_the_coordinator() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed).await;
        let mut missions = vec![];
        for (request, room) in ["a", "b", "c"].into_iter().zip(ROOMS) {
            missions.push(fleet.submit(request, room).await);
        }
        let began = |what: &EventKind| matches!(what, EventKind::TaskBegan { .. });
        fleet.wait_until("the first task", SOON, |fleet| fleet.has_event(began)).await;
        assert_eq!(fleet.kill_coordinator().await.as_str(), "aba", "seed {seed}");
        for (mission, room) in missions.iter().zip(ROOMS) {
            fleet.assert_completes(mission).await;
            fleet.assert_each_task_once(mission);
            fleet.assert_sample_delivered(room);
        }
        fleet.assert_exclusive_roles();
    });
}

/// Each of two missions has lost a robot, waits for the robot of the other mission, and keeps a robot
/// that waits for a signal of the lost one.
#[test]
fn missions_that_wait_for_the_robots_of_each_other_are_resolved() {
    for_each_seed(SEEDS, async |seed| {
        let carriers = [("amber", "PC Room 8"), ("birch", "IC Room 4"), ("fern", "Dock"), ("gorse", "PC Room 2")];
        let robots = carriers.map(|(name, place)| RobotSpec::carrier(name, place)).to_vec();
        let mut fleet = Fleet::hospital(seed, robots, &["aba", "bab", "cab"], &ROOMS).await;
        fleet.wait_for_coordinator().await;
        let drive = |task: &str, role: &str| json!({ "task": task, "type": "navigation", "roles": [role], "parameters": { "to": "IC Room 6" } });
        let managed = json!({ "kind": "managed" });
        let mission = json!({
            "mission": "in-turn", "roles": { "first": managed, "second": managed },
            "root": { "task": "visit", "method": "sequential", "tasks": [drive("go", "first"), drive("follow", "second")] },
        });
        let mut missions: Vec<MissionId> = vec![];
        for request in ["a", "b"] {
            let answer =
                fleet.request_answered(ApiCall::Submit, &json!({ "mission": mission, "request": request })).await;
            missions.push(slug(answer["mission"].as_str().unwrap_or_else(|| panic!("seed {seed}: {answer}"))));
        }
        let went = |fleet: &Fleet| fleet.event_log.times(task_began("go")).len();
        fleet.wait_until("both to drive", SOON, |fleet| went(fleet) == 2).await;
        for mission in &missions {
            let lost = fleet.holder(mission, "first").expect("held").to_string();
            fleet.kill(&lost).await;
        }
        for mission in &missions {
            fleet.assert_completes(mission).await;
        }
        fleet.assert_exclusive_roles();
        // Only the robot of the later mission gave way, once.
        let gave_way = |what: &EventKind| matches!(what, EventKind::GaveUp { .. });
        let gave_way: Vec<_> = fleet.events().into_iter().filter(gave_way).collect();
        let [EventKind::GaveUp { mission, role, cause, .. }] = &gave_way[..] else {
            panic!("seed {seed}: {gave_way:?}\n{}", fleet.event_log_text())
        };
        assert_eq!((mission, role.as_str()), (&missions[1], "second"), "seed {seed}");
        assert_eq!(*cause, format!("it gives way to {}", missions[0]), "seed {seed}");
        let completed: Vec<_> = fleet
            .events()
            .into_iter()
            .filter_map(|what| match what {
                EventKind::Mission { mission, state: MissionState::Completed, .. } => Some(mission),
                _ => None,
            })
            .collect();
        assert_eq!(completed, missions, "seed {seed}: the better-ranked mission is completed first");
    });
}
