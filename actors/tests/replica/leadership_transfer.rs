//! A leader that leaves hands over; and at no moment are there two.

use crate::failover::{LOSSY, on_wifi, ranks};
use crate::support::{Fleet, NumberCommand, TIMEOUT, default_settings, on_virtual_time};
use consort_actors::raft::{ProposeError, RaftSettings, Replica, TransferError};
use consort_protocol::ids::NodeId;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::time::Instant;

const LIMIT: Duration = Duration::from_millis(300);

/// How long from the leader's decision to leave to the first commit by the next, in virtual milliseconds.
fn leave(seed: u64, voters: usize, settings: fn(NodeId) -> RaftSettings) -> u128 {
    on_virtual_time(async {
        let fleet = Fleet::bootstrapped(seed, voters, settings).await;
        for number in 0..5 {
            fleet.write(number).await;
        }
        tokio::time::sleep(Duration::from_millis(500) + Duration::from_micros(seed * 7919 % 100_000)).await;
        let leader = fleet.leader().await;
        let leaver = fleet.replicas[&leader].clone();
        let left_at = Instant::now();
        let leaving = tokio::spawn(async move { leaver.transfer_leadership(&BTreeSet::new(), LIMIT).await });
        fleet.until("another leads", |fleet| fleet.leaders().iter().any(|name| *name != leader)).await;
        fleet.write(5).await;
        let took = left_at.elapsed().as_millis();
        let successor = leaving.await.expect("no panic").expect("a successor");
        assert_eq!(fleet.leader().await, successor, "seed {seed}");
        fleet.until_all_hold(6).await;
        assert_eq!(fleet.common().numbers(), [0, 1, 2, 3, 4, 5], "seed {seed}");
        took
    })
}

#[test]
#[expect(clippy::print_stderr, reason = "the figures are what the test is for")]
fn a_leader_that_leaves_is_succeeded_within_a_tenth_of_a_second() {
    for (what, settings) in [("lan", default_settings as fn(NodeId) -> RaftSettings), ("wifi", on_wifi)] {
        let (p50, p99) = ranks((0..200).map(|seed| leave(seed, 5, settings)).collect());
        eprintln!("leave to first commit by the next, {what}, 200 seeds: p50 {p50} ms, p99 {p99} ms");
        assert!(p99 < 100, "{what}");
    }
}

#[test]
fn of_three_voters_the_leaver_does_not_win_back_what_it_gives_to_another() {
    for seed in 0..100 {
        leave(seed, 3, default_settings);
    }
}

#[test]
fn the_leaver_refuses_proposals_at_once_votes_on_and_keeps_what_was_acknowledged() {
    on_virtual_time(async {
        let fleet = Fleet::bootstrapped(1, 3, default_settings).await;
        let mut acknowledged = 0;
        for round in 0..6 {
            let leader = fleet.leader().await;
            let leaver = fleet.replicas[&leader].clone();
            let busy = {
                let leaver = leaver.clone();
                tokio::spawn(async move {
                    let mut done = 0;
                    while leaver.propose(NumberCommand::Append(1), TIMEOUT).await.is_ok() {
                        done += 1;
                    }
                    done
                })
            };
            let begun = leaver.read(|tally| tally.written.len());
            fleet.until("it is busy", |_| leaver.read(|tally| tally.written.len()) > begun + 10).await;
            let successor = leaver.transfer_leadership(&BTreeSet::new(), LIMIT).await.expect("a successor");
            assert!(!fleet.view(&leader).is_leader && leaver.quorum_ack_age().is_none());
            acknowledged += busy.await.expect("no panic");
            let refused = leaver.propose(NumberCommand::Append(2), TIMEOUT).await;
            assert!(matches!(refused, Err(ProposeError::NotLeader { .. })), "{refused:?}");
            assert_eq!(leaver.transfer_leadership(&BTreeSet::new(), LIMIT).await, Err(TransferError::NotLeader));
            fleet.until("the successor leads", |fleet| fleet.leaders() == [successor.clone()]).await;
            assert_ne!(successor, leader, "round {round}");
        }
        fleet.until_all_hold(acknowledged).await;
        fleet.until_all_agree().await;
        // What was under way when its leader left was committed by the next, or not at all.
        let held = fleet.common().written.len();
        assert!((acknowledged..=acknowledged + 6).contains(&held), "{held} of {acknowledged}");
    });
}

#[test]
fn a_shunned_voter_succeeds_only_if_there_is_nobody_else() {
    on_virtual_time(async {
        let mut fleet = Fleet::bootstrapped(2, 3, default_settings).await;
        fleet.write(1).await;
        for _ in 0..4 {
            let leader = fleet.leader().await;
            let other: Vec<_> = fleet.replicas.keys().filter(|name| **name != leader).cloned().collect();
            let shunned = BTreeSet::from([other[0].clone()]);
            let successor = fleet.replicas[&leader].transfer_leadership(&shunned, LIMIT).await.expect("a successor");
            assert_eq!(successor, other[1]);
            fleet.until("the successor leads", |fleet| fleet.leaders() == [successor.clone()]).await;
        }
        let leader = fleet.leader().await;
        let other: Vec<_> = fleet.replicas.keys().filter(|name| **name != leader).cloned().collect();
        fleet.kill(&other[1]);
        // Its silence is what tells that it is no candidate any more.
        tokio::time::sleep(TIMEOUT).await;
        let successor = fleet.replicas[&leader].transfer_leadership(&BTreeSet::from([other[0].clone()]), LIMIT).await;
        assert_eq!(successor.as_ref(), Ok(&other[0]));
    });
}

#[test]
fn whoever_has_nobody_to_hand_over_to_says_so_and_leads_on() {
    on_virtual_time(async {
        let fleet = Fleet::bootstrapped(3, 1, default_settings).await;
        fleet.write(1).await;
        assert_eq!(fleet.on("ada").transfer_leadership(&BTreeSet::new(), LIMIT).await, Err(TransferError::OnlyVoter));
        fleet.write(2).await;

        let fleet = Fleet::bootstrapped(4, 3, default_settings).await;
        fleet.write(1).await;
        let leader = fleet.leader().await;
        fleet.network.isolate(leader.clone());
        // Silent for so long that nobody counts as near, and not for so long that it doubts itself.
        tokio::time::sleep(Duration::from_millis(250)).await;
        let limit = Duration::from_millis(20);
        let nobody = fleet.replicas[&leader].transfer_leadership(&BTreeSet::new(), limit).await;
        assert_eq!(nobody, Err(TransferError::NoTargetReady { others: 2, limit }));
        fleet.network.heal();
        fleet.write(2).await;
        fleet.until_all_hold(2).await;
    });
}

#[test]
fn at_no_moment_do_two_lead_while_leaders_leave_die_and_are_cut_off() {
    for seed in 0..40 {
        on_virtual_time(async {
            let mut chance = ChaCha8Rng::seed_from_u64(seed);
            let mut fleet = Fleet::bootstrapped(seed, 5, default_settings).await;
            if seed % 3 == 0 {
                fleet.network.set_link_model(LOSSY);
            }
            let mut last = 0;
            for round in 0..8 {
                let leader = fleet.leader().await;
                let leaver: Replica<_> = fleet.replicas[&leader].clone();
                let leaving =
                    tokio::spawn(async move { leaver.transfer_leadership(&BTreeSet::new(), LIMIT).await.is_ok() });
                // Now and then something goes wrong in the middle of it.
                let (trouble, at) = (chance.random_range(0..6), chance.random_range(0..25));
                let mut killed = None;
                for step in 0..1200 {
                    let leaders = fleet.leaders();
                    assert!(leaders.len() <= 1, "{leaders:?} at once, seed {seed}, round {round}, step {step}");
                    if let [leader] = &leaders[..] {
                        let term = fleet.view(leader).term;
                        assert!(term >= last, "term {term} after {last}, seed {seed}");
                        last = term;
                    }
                    if step == at {
                        let other = fleet.replicas.keys().find(|name| **name != leader).expect("five nodes").clone();
                        match trouble {
                            0 => {
                                fleet.kill(&leader);
                                killed = Some(leader.clone());
                            }
                            1 => fleet.network.isolate(leader.clone()),
                            2 => {
                                fleet.kill(&other);
                                killed = Some(other);
                            }
                            3 => fleet.network.pause(&leader),
                            4 => fleet.network.block_outgoing(other),
                            _ => {}
                        }
                    }
                    if step == 700 {
                        fleet.network.heal();
                        fleet.network.resume(&leader);
                        if let Some(killed) = killed.take() {
                            fleet.start(killed.as_str()).await;
                        }
                    }
                    tokio::time::sleep(Duration::from_millis(1)).await;
                }
                leaving.abort();
            }
            fleet.network.set_link_model(consort_actors::bus::virtual_bus::LinkModel::LAN);
            fleet.write(1).await;
            fleet.until_all_hold(1).await;
        });
    }
}

#[test]
fn a_leader_that_is_voted_out_hands_over_at_once() {
    for seed in 0..20 {
        on_virtual_time(async {
            let fleet = Fleet::bootstrapped(seed, 4, default_settings).await;
            fleet.write(1).await;
            let leader = fleet.leader().await;
            let chief = fleet.replicas[&leader].clone();
            let kept: BTreeSet<_> = fleet.replicas.values().map(Replica::id).filter(|id| *id != chief.id()).collect();
            chief.set_voters(kept.clone(), TIMEOUT).await.expect("a commit");
            let voted_out_at = Instant::now();
            assert!(!fleet.view(&leader).is_leader && chief.quorum_ack_age().is_none(), "seed {seed}");
            fleet.until("another leads", |fleet| fleet.leaders().iter().any(|name| *name != leader)).await;
            let next = fleet.leader().await;
            fleet.replicas[&next].propose(NumberCommand::Append(2), TIMEOUT).await.expect("a commit");
            assert!(voted_out_at.elapsed() < Duration::from_millis(100), "seed {seed}: {:?}", voted_out_at.elapsed());
            assert_eq!(fleet.view(&next).voters.keys().copied().collect::<BTreeSet<_>>(), kept);
            assert_eq!(fleet.replicas[&next].read(|tally| tally.numbers()), [1, 2]);
        });
    }
}
