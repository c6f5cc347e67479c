//! The autopilot keeps enough voters alive when nodes die, return, or are better suited.

use consort_protocol::event::EventKind;
use consort_tests::{StationFleet, for_each_seed};
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::time::Instant;

const SEVEN: [&str; 7] = ["aster", "basil", "clove", "daisy", "elder", "fennel", "gorse"];
const SEEDS: std::ops::Range<u64> = 1..4;

fn set(names: &[&str]) -> BTreeSet<String> {
    names.iter().map(|name| (*name).to_owned()).collect()
}

#[test]
fn seven_stations_survive_the_loss_of_four_voters_in_turn() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = StationFleet::founded(seed, &SEVEN).await;
        let first = fleet.voters();
        assert_eq!(first, set(&SEVEN[..5]), "seed {seed}");
        fleet.submit("gorse", "before").await;
        for (count, name) in first.iter().take(4).enumerate() {
            fleet.kill(name).await;
            let left = 7 - count - 1;
            fleet
                .wait_until(&format!("{name} to be replaced"), |fleet| {
                    let voters = fleet.voters();
                    !voters.is_empty() && !voters.contains(name) && voters.len() == left.min(5)
                })
                .await;
        }
        fleet.submit("gorse", "after").await;
        assert_eq!(fleet.voters(), set(&["elder", "fennel", "gorse"]), "seed {seed}");
        let held = |fleet: &StationFleet| {
            let replica = fleet.nodes["gorse"].replica.as_ref().expect("a copy");
            replica.read(|ledger| ledger.missions().count())
        };
        fleet.wait_until("both missions to be known", |fleet| held(fleet) == 2).await;
    });
}

#[test]
fn two_voters_killed_at_once_are_both_replaced() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = StationFleet::founded(seed, &SEVEN).await;
        fleet.kill("aster").await;
        fleet.kill("daisy").await;
        fleet
            .wait_until("five voters that live", |fleet| {
                fleet.voters() == set(&["basil", "clove", "elder", "fennel", "gorse"])
            })
            .await;
        fleet.submit("gorse", "after").await;
        assert_eq!(fleet.voter_change_reasons().len(), 4, "seed {seed}: {:?}", fleet.voter_change_reasons());
    });
}

#[test]
fn a_voter_that_returns_in_time_with_its_store_keeps_its_vote() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = StationFleet::founded(seed, &SEVEN).await;
        let before = fleet.voters();
        fleet.kill("basil").await;
        fleet.advance(Duration::from_secs(5)).await;
        fleet.start("basil").await;
        fleet.advance(Duration::from_secs(20)).await;
        assert_eq!(fleet.voters(), before, "seed {seed}");
        assert_eq!(fleet.voter_change_reasons(), [""; 0], "seed {seed}");
        // Its vote counts: with it, three of five voters are alive.
        fleet.kill("clove").await;
        fleet.kill("daisy").await;
        fleet.submit("gorse", "after").await;
    });
}

#[test]
fn a_voter_without_its_store_returns_as_a_new_member() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = StationFleet::founded(seed, &["aster", "basil", "clove"]).await;
        let coordinator = fleet.wait_for_coordinator().await;
        let lost = if coordinator == "basil" { "clove" } else { "basil" };
        let id = |fleet: &StationFleet, name: &str| fleet.nodes[name].replica.as_ref().expect("a copy").id();
        let former = id(&fleet, lost);
        fleet.kill(lost).await;
        fleet.start_empty(lost).await;
        let present = id(&fleet, lost);
        assert_ne!(former, present);
        fleet
            .wait_until("it votes again", |fleet| {
                let leaders = fleet.leaders();
                let Some(leader) = leaders.first() else { return false };
                let believed = fleet.leadership_view(leader);
                believed.voters.contains_key(&present) && believed.pending_voters.is_none()
            })
            .await;
        assert!(!fleet.leadership_view(&fleet.leaders()[0]).voters.contains_key(&former), "seed {seed}");
        assert_eq!(fleet.voters().len(), 3, "seed {seed}");
        let reasons = fleet.voter_change_reasons();
        assert!(reasons.iter().any(|reason| reason.contains("came back with an empty store")), "{reasons:?}");
    });
}

/// The file with the log and the snapshot of a voter, of the leader in every second run, is damaged while the voter is down.
/// Its store is quarantined, and the leader sends a new member the ledger. Then another voter is lost: the two that are left
/// are a majority only with the vote of the rebuilt voter.
#[test]
fn a_voter_with_a_damaged_store_is_rebuilt_and_votes_again() {
    for_each_seed(1..7, async |seed| {
        let mut fleet = StationFleet::founded_on_disks(seed, &["aster", "basil", "clove"]).await;
        for number in 0..20 {
            fleet.submit("aster", &format!("before-{number}")).await;
        }
        let leader = fleet.wait_for_coordinator().await;
        let follower = if leader == "basil" { "clove" } else { "basil" };
        let damaged = if seed % 2 == 0 { leader.as_str() } else { follower };
        let id = |fleet: &StationFleet| fleet.nodes[damaged].replica.as_ref().expect("a copy").id();
        let held = |fleet: &StationFleet| {
            let replica = fleet.nodes[damaged].replica.as_ref().expect("a copy");
            replica.read(|ledger| ledger.missions().count())
        };
        let (former, installed) = (id(&fleet), fleet.installed_snapshots(damaged));
        fleet.kill_and_damage(damaged).await;
        fleet.start(damaged).await;
        assert_eq!(fleet.replaced_stores(damaged), 1, "seed {seed}: the store is quarantined");
        let present = id(&fleet);
        assert_ne!(former, present, "seed {seed}: a new member");
        fleet
            .wait_until("every voter knows that the new member votes in place of the former", |fleet| {
                let is_replaced = |name: &String| {
                    let view = fleet.leadership_view(name);
                    let voters = &view.voters;
                    view.pending_voters.is_none() && voters.contains_key(&present) && !voters.contains_key(&former)
                };
                fleet.nodes.keys().all(is_replaced)
            })
            .await;
        assert_eq!(fleet.voters().len(), 3, "seed {seed}");
        fleet.wait_until("it has the ledger", |fleet| held(fleet) == 20).await;
        assert!(fleet.installed_snapshots(damaged) > installed, "seed {seed}: the leader has sent its snapshot");

        let leader = fleet.wait_for_coordinator().await;
        let others = fleet.nodes.keys().filter(|name| *name != damaged);
        let lost = others.max_by_key(|name| **name == leader).expect("two other voters").clone();
        fleet.kill(&lost).await;
        fleet.submit(damaged, "after").await;
        fleet.wait_until("it has the last mission", |fleet| held(fleet) == 21).await;
        assert_eq!(fleet.replaced_stores(damaged), 1, "seed {seed}");
    });
}

#[test]
fn nodes_join_a_single_node_cluster_up_to_an_odd_number() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = StationFleet::empty(seed, 1);
        fleet.start("aster").await;
        fleet.wait_for_coordinator().await;
        fleet.start("basil").await;
        fleet.advance(Duration::from_secs(5)).await;
        assert_eq!(fleet.voters(), set(&["aster"]), "seed {seed}");
        fleet.start("clove").await;
        fleet.wait_until("three voters", |fleet| fleet.voters() == set(&["aster", "basil", "clove"])).await;
        let clusters: BTreeSet<_> = fleet.nodes.keys().map(|name| fleet.cluster(name)).collect();
        assert_eq!(clusters.len(), 1, "seed {seed}");
    });
}

#[test]
fn a_settled_station_replaces_a_mobile_voter() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = StationFleet::empty(seed, 3);
        fleet.set_voter_target(3);
        fleet.start("aster").await;
        fleet.start("basil").await;
        fleet.start_mobile("cart").await;
        fleet.wait_until("three voters", |fleet| fleet.voters().len() == 3).await;
        fleet.start("daisy").await;
        fleet.advance(Duration::from_secs(15)).await;
        assert_eq!(fleet.voters(), set(&["aster", "basil", "cart"]), "seed {seed}: it was hasty");
        fleet.wait_until("the station votes", |fleet| fleet.voters() == set(&["aster", "basil", "daisy"])).await;
        fleet.advance(Duration::from_secs(60)).await;
        assert_eq!(fleet.voters(), set(&["aster", "basil", "daisy"]), "seed {seed}: it did not rest");
        assert_eq!(fleet.voter_change_reasons().len(), 2, "seed {seed}: {:?}", fleet.voter_change_reasons());
    });
}

#[test]
fn a_mobile_leader_transfers_the_lead_to_a_settled_station() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = StationFleet::empty(seed, 1);
        fleet.set_voter_target(3);
        fleet.start_mobile("cart").await;
        assert_eq!(fleet.wait_for_coordinator().await, "cart", "seed {seed}");
        fleet.start("aster").await;
        fleet.start("basil").await;
        fleet.wait_until("three voters", |fleet| fleet.voters().len() == 3).await;
        fleet.submit("aster", "before").await;
        fleet.advance(Duration::from_secs(20)).await;
        assert_eq!(fleet.leaders(), ["cart"], "seed {seed}: it was hasty");
        let began = Instant::now();
        fleet.wait_until("a station to lead", |fleet| fleet.leaders().iter().any(|name| name != "cart")).await;
        assert!(began.elapsed() < Duration::from_secs(30), "seed {seed}: {:?}", began.elapsed());
        let elected = || fleet.events().iter().filter(|what| matches!(what, EventKind::Elected { .. })).count();
        let (leader, so_far) = (fleet.wait_for_coordinator().await, elected());
        fleet.submit("aster", "after").await;
        for _ in 0..10 {
            fleet.advance(Duration::from_secs(60)).await;
        }
        assert_eq!((fleet.leaders(), elected()), (vec![leader], so_far), "seed {seed}: it did not rest");
        assert_eq!(fleet.voters(), set(&["aster", "basil", "cart"]), "seed {seed}");
    });
}

#[test]
fn the_next_leader_completes_a_membership_change() {
    for_each_seed(1..13, async |seed| {
        let mut fleet = StationFleet::founded(seed, &SEVEN).await;
        fleet.kill("elder").await;
        // The leader is killed at some point of the following membership change: before, between
        // and after its two entries.
        let election = fleet.wait_for_coordinator().await;
        fleet
            .wait_until("an observer", |fleet| {
                let learners = &fleet.leadership_view(&election).learners;
                !learners.is_empty()
            })
            .await;
        if seed % 2 == 0 {
            fleet
                .wait_until("a change under way", |fleet| fleet.leadership_view(&election).pending_voters.is_some())
                .await;
        } else {
            fleet.advance(Duration::from_millis(seed * 23)).await;
        }
        fleet.kill(&election).await;
        let live: BTreeSet<String> = fleet.nodes.keys().cloned().collect();
        fleet.wait_until("the living five vote", |fleet| fleet.voters() == live).await;
        fleet.submit("gorse", "after").await;
        let five_voters = |what: &EventKind| matches!(what, EventKind::Voters { voters, .. } if voters.len() == 5);
        assert!(fleet.events().iter().any(five_voters), "seed {seed}");
    });
}
