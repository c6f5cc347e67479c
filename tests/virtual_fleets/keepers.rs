//! The autopilot keeps enough voters alive, whoever dies, returns, or turns out to be better placed.

use consort_protocol::event::Happening;
use consort_tests::{Stations, tell};
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::time::Instant;

const SEVEN: [&str; 7] = ["aster", "basil", "clove", "daisy", "elder", "fennel", "gorse"];
const SEEDS: std::ops::Range<u64> = 1..4;

fn set(names: &[&str]) -> BTreeSet<String> {
    names.iter().map(|name| (*name).to_owned()).collect()
}

#[test]
fn seven_survive_the_loss_of_four_of_the_first_five_voters_one_after_the_other() {
    tell(SEEDS, async |seed| {
        let mut fleet = Stations::founded(seed, &SEVEN).await;
        let first = fleet.voters();
        assert_eq!(first, set(&SEVEN[..5]), "seed {seed}");
        fleet.submit("gorse", "before").await;
        for (count, name) in first.iter().take(4).enumerate() {
            fleet.kill(name).await;
            let left = 7 - count - 1;
            fleet
                .until(&format!("{name} to be replaced"), |fleet| {
                    let voters = fleet.voters();
                    !voters.is_empty() && !voters.contains(name) && voters.len() == left.min(5)
                })
                .await;
        }
        fleet.submit("gorse", "after").await;
        assert_eq!(fleet.voters(), set(&["elder", "fennel", "gorse"]), "seed {seed}");
        let held = |fleet: &Stations| {
            let replica = fleet.nodes["gorse"].replica.as_ref().expect("a copy");
            replica.read(|ledger| ledger.missions().count())
        };
        fleet.until("both missions to be known", |fleet| held(fleet) == 2).await;
    });
}

#[test]
fn two_killed_at_once_are_both_replaced() {
    tell(SEEDS, async |seed| {
        let mut fleet = Stations::founded(seed, &SEVEN).await;
        fleet.kill("aster").await;
        fleet.kill("daisy").await;
        fleet
            .until("five voters that live", |fleet| {
                fleet.voters() == set(&["basil", "clove", "elder", "fennel", "gorse"])
            })
            .await;
        fleet.submit("gorse", "after").await;
        assert_eq!(fleet.changes().len(), 4, "seed {seed}: {:?}", fleet.changes());
    });
}

#[test]
fn a_voter_that_is_back_in_time_with_its_store_votes_as_before() {
    tell(SEEDS, async |seed| {
        let mut fleet = Stations::founded(seed, &SEVEN).await;
        let before = fleet.voters();
        fleet.kill("basil").await;
        fleet.pass(Duration::from_secs(5)).await;
        fleet.start("basil").await;
        fleet.pass(Duration::from_secs(20)).await;
        assert_eq!(fleet.voters(), before, "seed {seed}");
        assert_eq!(fleet.changes(), [""; 0], "seed {seed}");
        // Its vote is as good as any: with it, three of five live.
        fleet.kill("clove").await;
        fleet.kill("daisy").await;
        fleet.submit("gorse", "after").await;
    });
}

#[test]
fn a_voter_that_lost_its_store_gets_a_vote_back_as_another_member() {
    tell(SEEDS, async |seed| {
        let mut fleet = Stations::founded(seed, &["aster", "basil", "clove"]).await;
        let coordinator = fleet.coordinator().await;
        let lost = if coordinator == "basil" { "clove" } else { "basil" };
        let id = |fleet: &Stations, name: &str| fleet.nodes[name].replica.as_ref().expect("a copy").id();
        let former = id(&fleet, lost);
        fleet.kill(lost).await;
        fleet.start_empty(lost).await;
        let present = id(&fleet, lost);
        assert_ne!(former, present);
        fleet
            .until("it votes again", |fleet| {
                let leaders = fleet.leaders();
                let Some(leader) = leaders.first() else { return false };
                let believed = fleet.believed(leader);
                believed.voters.contains_key(&present) && believed.changing_to.is_none()
            })
            .await;
        assert!(!fleet.believed(&fleet.leaders()[0]).voters.contains_key(&former), "seed {seed}");
        assert_eq!(fleet.voters().len(), 3, "seed {seed}");
        let reasons = fleet.changes();
        assert!(reasons.iter().any(|reason| reason.contains("came back with an empty store")), "{reasons:?}");
    });
}

#[test]
fn one_founds_alone_and_others_join_it_up_to_an_odd_number() {
    tell(SEEDS, async |seed| {
        let mut fleet = Stations::none(seed, 1);
        fleet.start("aster").await;
        fleet.coordinator().await;
        fleet.start("basil").await;
        fleet.pass(Duration::from_secs(5)).await;
        assert_eq!(fleet.voters(), set(&["aster"]), "seed {seed}");
        fleet.start("clove").await;
        fleet.until("three voters", |fleet| fleet.voters() == set(&["aster", "basil", "clove"])).await;
        let clusters: BTreeSet<_> = fleet.nodes.keys().map(|name| fleet.cluster(name)).collect();
        assert_eq!(clusters.len(), 1, "seed {seed}");
    });
}

#[test]
fn of_nodes_that_start_at_once_and_expect_one_only_one_founds() {
    tell(1..9, async |seed| {
        let mut fleet = Stations::none(seed, 1);
        for name in &SEVEN[..5] {
            fleet.start(name).await;
        }
        fleet.until("five voters", |fleet| fleet.voters().len() == 5).await;
        let clusters: BTreeSet<_> = fleet.nodes.keys().map(|name| fleet.cluster(name)).collect();
        assert_eq!(clusters.len(), 1, "seed {seed}");
    });
}

#[test]
fn a_station_takes_the_place_of_a_node_that_moves_once_it_has_settled() {
    tell(SEEDS, async |seed| {
        let mut fleet = Stations::none(seed, 3);
        fleet.aim_at(3);
        fleet.start("aster").await;
        fleet.start("basil").await;
        fleet.start_mobile("cart").await;
        fleet.until("three voters", |fleet| fleet.voters().len() == 3).await;
        fleet.start("daisy").await;
        fleet.pass(Duration::from_secs(15)).await;
        assert_eq!(fleet.voters(), set(&["aster", "basil", "cart"]), "seed {seed}: it was hasty");
        fleet.until("the station votes", |fleet| fleet.voters() == set(&["aster", "basil", "daisy"])).await;
        fleet.pass(Duration::from_secs(60)).await;
        assert_eq!(fleet.voters(), set(&["aster", "basil", "daisy"]), "seed {seed}: it did not rest");
        assert_eq!(fleet.changes().len(), 2, "seed {seed}: {:?}", fleet.changes());
    });
}

#[test]
fn a_leader_that_moves_hands_over_to_a_station_that_has_settled_and_takes_the_lead_from_nobody() {
    tell(SEEDS, async |seed| {
        let mut fleet = Stations::none(seed, 1);
        fleet.aim_at(3);
        fleet.start_mobile("cart").await;
        assert_eq!(fleet.coordinator().await, "cart", "seed {seed}");
        fleet.start("aster").await;
        fleet.start("basil").await;
        fleet.until("three voters", |fleet| fleet.voters().len() == 3).await;
        fleet.submit("aster", "before").await;
        fleet.pass(Duration::from_secs(20)).await;
        assert_eq!(fleet.leaders(), ["cart"], "seed {seed}: it was hasty");
        let began = Instant::now();
        fleet.until("a station to lead", |fleet| fleet.leaders().iter().any(|name| name != "cart")).await;
        assert!(began.elapsed() < Duration::from_secs(30), "seed {seed}: {:?}", began.elapsed());
        let elected = || fleet.happenings().iter().filter(|what| matches!(what, Happening::Elected { .. })).count();
        let (leader, so_far) = (fleet.coordinator().await, elected());
        fleet.submit("aster", "after").await;
        for _ in 0..10 {
            fleet.pass(Duration::from_secs(60)).await;
        }
        assert_eq!((fleet.leaders(), elected()), (vec![leader], so_far), "seed {seed}: it did not rest");
        assert_eq!(fleet.voters(), set(&["aster", "basil", "cart"]), "seed {seed}");
    });
}

#[test]
fn a_change_that_a_dead_leader_began_is_completed_by_the_next() {
    tell(1..13, async |seed| {
        let mut fleet = Stations::founded(seed, &SEVEN).await;
        fleet.kill("elder").await;
        // The leader dies at some point of the exchange that follows: before, between and after its two entries.
        let elected = fleet.coordinator().await;
        fleet
            .until("an observer", |fleet| {
                let observers = &fleet.believed(&elected).observers;
                !observers.is_empty()
            })
            .await;
        if seed % 2 == 0 {
            fleet.until("a change under way", |fleet| fleet.believed(&elected).changing_to.is_some()).await;
        } else {
            fleet.pass(Duration::from_millis(seed * 23)).await;
        }
        fleet.kill(&elected).await;
        let live: BTreeSet<String> = fleet.nodes.keys().cloned().collect();
        fleet.until("the living five vote", |fleet| fleet.voters() == live).await;
        fleet.submit("gorse", "after").await;
        let told = |what: &Happening| matches!(what, Happening::Voters { voters, .. } if voters.len() == 5);
        assert!(fleet.happenings().iter().any(told), "seed {seed}");
    });
}
