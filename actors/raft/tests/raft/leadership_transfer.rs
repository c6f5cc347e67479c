//! Transfer of leadership, and the absence of two concurrent leaders.

use crate::failover::{LOSSY, on_wifi, ranks};
use crate::support::{Fleet, NumberCommand, TIMEOUT, default_settings, on_virtual_time};
use consort_protocol::ids::NodeId;
use consort_raft::{ProposeError, RaftSettings, Replica, TransferError};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::time::Instant;

const LIMIT: Duration = Duration::from_millis(300);

/// Measures the time from the leader's decision to leave to the first commit of its successor, in
/// virtual milliseconds.
fn transfer_time(seed: u64, voters: usize, settings: fn(NodeId) -> RaftSettings) -> u128 {
    on_virtual_time(async {
        let fleet = Fleet::bootstrapped(seed, voters, settings).await;
        for number in 0..5 {
            fleet.write(number).await;
        }
        tokio::time::sleep(Duration::from_millis(500) + Duration::from_micros(seed * 7919 % 100_000)).await;
        let leader = fleet.leader().await;
        let resigning = fleet.replicas[&leader].clone();
        let started_at = Instant::now();
        let transfer = tokio::spawn(async move { resigning.transfer_leadership(&BTreeSet::new(), LIMIT).await });
        fleet.until("another leads", |fleet| fleet.leaders().iter().any(|name| *name != leader)).await;
        fleet.write(5).await;
        let elapsed = started_at.elapsed().as_millis();
        let successor = transfer.await.expect("no panic").expect("a successor");
        assert_eq!(fleet.leader().await, successor, "seed {seed}");
        fleet.until_all_hold(6).await;
        assert_eq!(fleet.common().numbers(), [0, 1, 2, 3, 4, 5], "seed {seed}");
        elapsed
    })
}

#[test]
#[expect(clippy::print_stderr, reason = "the test prints its measurements")]
fn a_leadership_transfer_takes_less_than_a_tenth_of_a_second() {
    for (timing, settings) in [("lan", default_settings as fn(NodeId) -> RaftSettings), ("wifi", on_wifi)] {
        let (p50, p99) = ranks((0..200).map(|seed| transfer_time(seed, 5, settings)).collect());
        eprintln!("transfer to first commit by the successor, {timing}, 200 seeds: p50 {p50} ms, p99 {p99} ms");
        assert!(p99 < 100, "{timing}");
    }
}

#[test]
fn a_resigned_leader_of_three_voters_is_not_elected_again() {
    for seed in 0..100 {
        transfer_time(seed, 3, default_settings);
    }
}

#[test]
fn a_resigning_leader_rejects_proposals_and_loses_no_commit() {
    on_virtual_time(async {
        let fleet = Fleet::bootstrapped(1, 3, default_settings).await;
        let mut acknowledged = 0;
        for round in 0..6 {
            let leader = fleet.leader().await;
            let resigning = fleet.replicas[&leader].clone();
            let busy = {
                let resigning = resigning.clone();
                tokio::spawn(async move {
                    let mut done = 0;
                    while resigning.propose(NumberCommand::Append(1), TIMEOUT).await.is_ok() {
                        done += 1;
                    }
                    done
                })
            };
            let count_before = resigning.read(|list| list.written.len());
            fleet
                .until("ten commands are committed", |_| resigning.read(|list| list.written.len()) > count_before + 10)
                .await;
            let successor = resigning.transfer_leadership(&BTreeSet::new(), LIMIT).await.expect("a successor");
            assert!(!fleet.view(&leader).is_leader && resigning.quorum_ack_age().is_none());
            acknowledged += busy.await.expect("no panic");
            let refused = resigning.propose(NumberCommand::Append(2), TIMEOUT).await;
            assert!(matches!(refused, Err(ProposeError::NotLeader { .. })), "{refused:?}");
            assert_eq!(resigning.transfer_leadership(&BTreeSet::new(), LIMIT).await, Err(TransferError::NotLeader));
            fleet.until("the successor leads", |fleet| fleet.leaders() == [successor.clone()]).await;
            assert_ne!(successor, leader, "round {round}");
        }
        fleet.until_all_hold(acknowledged).await;
        fleet.until_all_agree().await;
        // A command that was in progress when its leader resigned was committed by the successor,
        // or not at all.
        let count = fleet.common().written.len();
        assert!((acknowledged..=acknowledged + 6).contains(&count), "{count} of {acknowledged}");
    });
}

#[test]
fn an_avoided_voter_is_the_target_only_without_another() {
    on_virtual_time(async {
        let mut fleet = Fleet::bootstrapped(2, 3, default_settings).await;
        fleet.write(1).await;
        for _ in 0..4 {
            let leader = fleet.leader().await;
            let other: Vec<_> = fleet.replicas.keys().filter(|name| **name != leader).cloned().collect();
            let avoided = BTreeSet::from([other[0].clone()]);
            let successor = fleet.replicas[&leader].transfer_leadership(&avoided, LIMIT).await.expect("a successor");
            assert_eq!(successor, other[1]);
            fleet.until("the successor leads", |fleet| fleet.leaders() == [successor.clone()]).await;
        }
        let leader = fleet.leader().await;
        let other: Vec<_> = fleet.replicas.keys().filter(|name| **name != leader).cloned().collect();
        fleet.kill(&other[1]);
        // The missing contact shows that the killed voter is no longer a target.
        tokio::time::sleep(TIMEOUT).await;
        let successor = fleet.replicas[&leader].transfer_leadership(&BTreeSet::from([other[0].clone()]), LIMIT).await;
        assert_eq!(successor.as_ref(), Ok(&other[0]));
    });
}

#[test]
fn a_leader_without_a_transfer_target_stays_leader() {
    on_virtual_time(async {
        let fleet = Fleet::bootstrapped(3, 1, default_settings).await;
        fleet.write(1).await;
        assert_eq!(fleet.on("ada").transfer_leadership(&BTreeSet::new(), LIMIT).await, Err(TransferError::OnlyVoter));
        fleet.write(2).await;

        let fleet = Fleet::bootstrapped(4, 3, default_settings).await;
        fleet.write(1).await;
        let leader = fleet.leader().await;
        fleet.network.isolate(leader.clone());
        // Long enough that no voter has recent contact, and too short for the check-quorum timeout.
        tokio::time::sleep(Duration::from_millis(250)).await;
        let limit = Duration::from_millis(20);
        let no_target = fleet.replicas[&leader].transfer_leadership(&BTreeSet::new(), limit).await;
        assert_eq!(no_target, Err(TransferError::NoTargetReady { others: 2, limit }));
        fleet.network.heal();
        fleet.write(2).await;
        fleet.until_all_hold(2).await;
    });
}

#[test]
fn two_nodes_never_lead_during_transfers_and_faults() {
    for seed in 0..40 {
        on_virtual_time(async {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let mut fleet = Fleet::bootstrapped(seed, 5, default_settings).await;
            if seed % 3 == 0 {
                fleet.network.set_link_model(LOSSY);
            }
            let mut last = 0;
            for round in 0..8 {
                let leader = fleet.leader().await;
                let resigning: Replica<_> = fleet.replicas[&leader].clone();
                let transfer =
                    tokio::spawn(async move { resigning.transfer_leadership(&BTreeSet::new(), LIMIT).await.is_ok() });
                // In some rounds a fault is injected during the transfer.
                let (fault, fault_step) = (rng.random_range(0..6), rng.random_range(0..25));
                let mut killed = None;
                for step in 0..1200 {
                    let leaders = fleet.leaders();
                    assert!(leaders.len() <= 1, "{leaders:?} at once, seed {seed}, round {round}, step {step}");
                    if let [leader] = &leaders[..] {
                        let term = fleet.view(leader).term;
                        assert!(term >= last, "term {term} after {last}, seed {seed}");
                        last = term;
                    }
                    if step == fault_step {
                        let other = fleet.replicas.keys().find(|name| **name != leader).expect("five nodes").clone();
                        match fault {
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
                transfer.abort();
            }
            fleet.network.set_link_model(consort_bus::virtual_bus::LinkModel::LAN);
            fleet.write(1).await;
            fleet.until_all_hold(1).await;
        });
    }
}

#[test]
fn a_removed_leader_transfers_leadership_at_once() {
    for seed in 0..20 {
        on_virtual_time(async {
            let fleet = Fleet::bootstrapped(seed, 4, default_settings).await;
            fleet.write(1).await;
            let leader = fleet.leader().await;
            let leader_replica = fleet.replicas[&leader].clone();
            let kept: BTreeSet<_> =
                fleet.replicas.values().map(Replica::id).filter(|id| *id != leader_replica.id()).collect();
            leader_replica.set_voters(kept.clone(), TIMEOUT).await.expect("a commit");
            let voted_out_at = Instant::now();
            assert!(!fleet.view(&leader).is_leader && leader_replica.quorum_ack_age().is_none(), "seed {seed}");
            fleet.until("another leads", |fleet| fleet.leaders().iter().any(|name| *name != leader)).await;
            let next = fleet.leader().await;
            fleet.replicas[&next].propose(NumberCommand::Append(2), TIMEOUT).await.expect("a commit");
            assert!(voted_out_at.elapsed() < Duration::from_millis(100), "seed {seed}: {:?}", voted_out_at.elapsed());
            assert_eq!(fleet.view(&next).voters.keys().copied().collect::<BTreeSet<_>>(), kept);
            assert_eq!(fleet.replicas[&next].read(|list| list.numbers()), [1, 2]);
        });
    }
}
