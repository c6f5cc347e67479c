//! Nodes that leave for a while or for good: a coordinator, a voter, and neither.

use consort_bus::Bus;
use consort_tests::{StationFleet, for_each_seed};
use std::cell::Cell;
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::time::Instant;

const FIVE: [&str; 5] = ["aster", "basil", "clove", "daisy", "elder"];
const SEEDS: std::ops::Range<u64> = 1..6;

#[test]
fn a_stopping_coordinator_transfers_the_lead_and_keeps_its_vote() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = StationFleet::founded(seed, &FIVE).await;
        fleet.submit("elder", "before").await;
        let before = fleet.voters();
        let coordinator = fleet.wait_for_coordinator().await;
        let node = fleet.nodes.remove(&coordinator).expect("it runs");
        let other = FIVE.iter().find(|name| **name != coordinator).expect("five");
        let began = Instant::now();
        let stopping = tokio::spawn(node.stop());
        // A leader has committed the first entry of its term.
        fleet.wait_until("another coordinator", |fleet| fleet.leaders().iter().any(|name| *name != coordinator)).await;
        let took = began.elapsed();
        assert!(took < Duration::from_millis(100), "seed {seed}: {took:?}");
        fleet.submit(other, "after").await;
        stopping.await.expect("no panic");
        assert_eq!(fleet.voters(), before, "seed {seed}");
        fleet.network.crash(&coordinator.parse().expect("a name"));
        fleet.start(&coordinator).await;
        fleet.advance(Duration::from_secs(15)).await;
        assert_eq!((fleet.voters(), fleet.voter_change_reasons().len()), (before, 0), "seed {seed}");
    });
}

#[test]
fn a_leaving_node_passes_its_vote_on_before_it_ends() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = StationFleet::founded(seed, &FIVE).await;
        fleet.start("fennel").await;
        fleet.advance(Duration::from_secs(2)).await;
        // First a coordinator, then other voters, until no node is left to take over.
        for round in 0..3 {
            let coordinator = fleet.wait_for_coordinator().await;
            let leaver = match round {
                0 => coordinator.clone(),
                _ => fleet.voters().into_iter().find(|name| *name != coordinator).expect("several"),
            };
            let asker = fleet.nodes.keys().find(|name| **name != leaver).expect("several").clone();
            let limit = Duration::from_secs(20);
            let answers = fleet.query(&asker, &StationFleet::leave_key(&leaver), &serde_json::Value::Null, limit).await;
            let [farewell] = &answers[..] else { panic!("seed {seed}: {answers:?}") };
            assert_eq!(farewell["vote_released"], true, "seed {seed}, round {round}: {farewell}");
            assert_eq!(farewell["successor"].is_string(), round == 0, "seed {seed}: {farewell}");
            let mut node = fleet.nodes.remove(&leaver).expect("it runs");
            assert!(node.ended_or_decommissioned().await.is_ok(), "seed {seed}");
            node.shut_down().await;
            fleet.network.crash(&leaver.parse().expect("a name"));
            let left: BTreeSet<String> = fleet.nodes.keys().cloned().collect();
            fleet
                .wait_until("voters that live", |fleet| !fleet.voters().is_empty() && fleet.voters().is_subset(&left))
                .await;
            assert_eq!(fleet.voters().len(), left.len().min(5), "seed {seed}, round {round}");
        }
        fleet.submit(&fleet.wait_for_coordinator().await, "after").await;
    });
}

#[test]
fn a_leaving_node_that_is_elected_again_transfers_again() {
    let led_again = Cell::new(0);
    for seed in 101..121 {
        for_each_seed([seed], async |seed| {
            let mut fleet = StationFleet::founded(seed, &FIVE).await;
            let leaver = fleet.wait_for_coordinator().await;
            // It transfers the lead to the voter with the lowest id.
            let others = fleet.leadership_view(&leaver).voters.into_values().map(|name| name.to_string());
            let successor = others.into_iter().find(|name| *name != leaver).expect("several");
            let asker = FIVE.into_iter().find(|name| *name != leaver && *name != successor).expect("five");
            let bus = fleet.network.bus(asker.parse().expect("a name"));
            let key = format!("consort/ward/api/leave/{leaver}");
            let request = tokio::spawn(async move {
                let mut replies = bus.query(&key, vec![].into(), Duration::from_secs(20)).await.expect("a virtual bus");
                let reply = replies.recv().await.expect("a reply").payload.expect("no refusal");
                serde_json::from_slice::<serde_json::Value>(&reply).expect("JSON")
            });
            // The target of the transfer is killed before it takes over, and the others hold an
            // election. The leaving node may win it.
            fleet.wait_until("it to hand over", |fleet| !fleet.leadership_view(&leaver).is_leader).await;
            fleet.kill(&successor).await;
            fleet.wait_until("it to have left", |_| request.is_finished()).await;
            let farewell = request.await.expect("no panic");
            assert_eq!(farewell["vote_released"], true, "seed {seed}: {farewell}");
            let again = farewell["successor"].as_str().is_some_and(|last| last != successor);
            led_again.set(led_again.get() + usize::from(again));
            let node = fleet.nodes.remove(&leaver).expect("it runs");
            node.shut_down().await;
            fleet.network.crash(&leaver.parse().expect("a name"));
            fleet
                .wait_until("voters without it", |fleet| {
                    let voters = fleet.voters();
                    !voters.is_empty() && !voters.contains(&leaver)
                })
                .await;
            fleet.submit(asker, "after").await;
        });
    }
    assert!(led_again.get() >= 3, "of 20 it was elected once more {} times", led_again.get());
}

#[test]
fn the_only_voter_may_leave_once_there_is_another() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = StationFleet::founded(seed, &["aster"]).await;
        let limit = Duration::from_secs(20);
        let key = StationFleet::leave_key("aster");
        let answers = fleet.query("aster", &key, &serde_json::Value::Null, limit).await;
        let problem = answers[0]["error"].as_str().expect("a refusal");
        assert!(problem.starts_with("aster is the only voter"), "seed {seed}: {problem}");
        fleet.submit("aster", "before").await;
        fleet.start("basil").await;
        fleet.advance(Duration::from_secs(2)).await;
        let answers = fleet.query("basil", &key, &serde_json::Value::Null, limit).await;
        assert_eq!(answers[0]["successor"], "basil", "seed {seed}: {answers:?}");
        let node = fleet.nodes.remove("aster").expect("it runs");
        node.shut_down().await;
        fleet.network.crash(&"aster".parse().expect("a name"));
        fleet.submit("basil", "after").await;
        assert_eq!(fleet.voters(), BTreeSet::from(["basil".to_owned()]), "seed {seed}");
    });
}

#[test]
fn a_voter_may_not_leave_while_the_other_is_down() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = StationFleet::founded(seed, &["aster"]).await;
        fleet.submit("aster", "before").await;
        fleet.start("basil").await;
        fleet.advance(Duration::from_secs(2)).await;
        let bus = fleet.network.bus("asker".parse().expect("a name"));
        let request = tokio::spawn(async move {
            let key = "consort/ward/api/leave/aster";
            let mut replies = bus.query(key, vec![].into(), Duration::from_secs(20)).await.expect("a virtual bus");
            let reply = replies.recv().await.expect("a reply").payload.expect("no refusal");
            serde_json::from_slice::<serde_json::Value>(&reply).expect("JSON")
        });
        // The node that should take over is killed before it can.
        fleet.wait_until("two voters", |fleet| fleet.leadership_view("aster").voters.len() == 2).await;
        fleet.kill("basil").await;
        fleet.wait_until("a reply", |_| request.is_finished()).await;
        let reply = request.await.expect("no panic");
        let problem = reply["error"].as_str().expect("a refusal");
        assert!(problem.starts_with("aster and basil are the only voters, and basil has not relieved"), "{problem}");
        assert!(!fleet.nodes["aster"].has_ended(), "seed {seed}");
        fleet.start("basil").await;
        fleet.submit("basil", "after").await;
    });
}
