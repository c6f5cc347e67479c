//! More missions than robots.

use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::ledger::Ledger;
use consort_tests::{Fleet, RobotSpec, for_each_seed};
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
