//! Elections, crashes, partitions and restarts: all nodes have the same ledger in every case.

use crate::support::{Fleet, NumberCommand, TIMEOUT, default_settings, node, on_virtual_time, with_short_logs};
use consort_bus::Bus as _;
use consort_bus::virtual_bus::LinkModel;
use consort_protocol::ids::NodeId;
use consort_raft::{BootstrapError, LeaderId, LeadershipView, LogStore as _, MemberError, ProposeError, Replica};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tokio::time::Instant;

#[test]
fn fleets_elect_a_leader_and_apply_all_writes_in_one_order() {
    for size in [3, 5] {
        on_virtual_time(async {
            let fleet = Fleet::bootstrapped(1, size, default_settings).await;
            let leader = fleet.leader().await;
            for number in 0..300 {
                fleet.replicas[&leader].propose(NumberCommand::Append(number), TIMEOUT).await.expect("a commit");
            }
            fleet.until_all_hold(300).await;
            assert_eq!(fleet.common().numbers(), (0..300).collect::<Vec<_>>());
            assert!(fleet.common().written.is_sorted());
            for name in fleet.replicas.keys() {
                let view = fleet.view(name);
                assert_eq!(view.leader, Some(leader.clone()));
                assert_eq!(view.voters.len(), size);
                assert_eq!(view.is_leader, *name == leader);
            }
        });
    }
}

#[test]
fn a_killed_leader_is_replaced_without_a_lost_commit() {
    for seed in 0..50 {
        on_virtual_time(async {
            let mut fleet = Fleet::bootstrapped(seed, 5, default_settings).await;
            let mut acknowledged = BTreeMap::new();
            for round in 0..2 {
                for number in round * 100..round * 100 + 20 {
                    acknowledged.insert(fleet.write(number).await, number);
                }
                // Another command is in progress when the leader fails: it may or may not be
                // committed.
                let leader = fleet.leader().await;
                let failing_leader = fleet.replicas[&leader].clone();
                let pending = tokio::spawn(async move {
                    failing_leader.propose(NumberCommand::Append(1_000_000 + round), TIMEOUT).await
                });
                tokio::time::sleep(Duration::from_micros(500)).await;
                pending.abort();
                fleet.kill(&leader);
                acknowledged.insert(fleet.write(round * 100 + 50).await, round * 100 + 50);
            }
            fleet.until_all_hold(acknowledged.len()).await;
            fleet.until_all_agree().await;
            let log: BTreeMap<_, _> = fleet.common().written.into_iter().collect();
            for (at, number) in acknowledged {
                assert_eq!(log.get(&at), Some(&number), "at {at}, seed {seed}");
            }
        });
    }
}

/// Trace of a run: virtual time, node, term, leader and `is_leader`, for each change of a node's
/// view.
type Trace = Vec<(Duration, NodeId, u64, Option<NodeId>, bool)>;

/// Runs a fleet in which two leaders fail; returns the trace and the digest of all messages.
async fn run_with_trace(seed: u64) -> (Trace, u64) {
    let mut fleet = Fleet::bootstrapped(seed, 5, default_settings).await;
    let mut trace = Vec::new();
    let mut last: BTreeMap<NodeId, LeadershipView> = BTreeMap::new();
    let mut number = 0;
    for step in 0..3000 {
        for name in fleet.replicas.keys() {
            let view = fleet.view(name);
            if last.get(name) != Some(&view) {
                let leader = view.leader.clone();
                trace.push((fleet.started_at.elapsed(), name.clone(), view.term, leader, view.is_leader));
                last.insert(name.clone(), view);
            }
        }
        if step == 900 || step == 1900 {
            let leader = fleet.leader().await;
            fleet.kill(&leader);
        }
        if step % 7 == 0
            && let [leader] = &fleet.leaders()[..]
        {
            number += 1;
            let _ = fleet.replicas[leader].propose(NumberCommand::Append(number), Duration::from_millis(3)).await;
        }
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    (trace, fleet.network.digest())
}

#[test]
fn each_seed_gives_a_reproducible_run_of_its_own() {
    let runs: Vec<_> = (0..6).map(|seed| on_virtual_time(run_with_trace(seed))).collect();
    for (seed, run) in (0..).zip(&runs) {
        assert!(run.0.len() > 20, "{run:#?}");
        assert_eq!(*run, on_virtual_time(run_with_trace(seed)), "seed {seed}");
    }
    assert_eq!(runs.iter().collect::<BTreeSet<_>>().len(), runs.len());
}

/// A restarted leader continues in its old term until it learns of a later term. It must not announce
/// its last commit to a follower in its minority. Found by chaos, seed 4012.
#[test]
fn the_copy_of_a_follower_ages_although_a_leader_restarts_in_its_minority() {
    for seed in 0..20 {
        on_virtual_time(async {
            let mut fleet = Fleet::bootstrapped(seed, 5, default_settings).await;
            fleet.write(1).await;
            fleet.until_all_hold(1).await;
            let old = fleet.leader().await;
            let follower = fleet.replicas.keys().find(|name| **name != old).expect("five nodes").clone();
            let majority = fleet.replicas.keys().filter(|name| ![&old, &follower].contains(name)).cloned().collect();
            fleet.network.partition([vec![old.clone(), follower.clone()], majority]);
            fleet.until("the leader has stepped down", |fleet| !fleet.view(&old).is_leader).await;
            fleet.write(2).await;
            let committed_at = Instant::now();
            fleet.kill(&old);
            fleet.start(old.as_str()).await;
            fleet
                .until("the copy is 2 s old", |fleet| {
                    let replica = &fleet.replicas[&follower];
                    let age = replica.staleness().expect("it has followed a leader");
                    assert_eq!(replica.read(|list| list.written.len()), 1, "seed {seed}");
                    assert!(age >= committed_at.elapsed(), "{age:?} old, seed {seed}");
                    age >= Duration::from_secs(2)
                })
                .await;
            fleet.network.heal();
            fleet.until_all_hold(2).await;
        });
    }
}

#[test]
fn a_leader_in_the_minority_steps_down_and_rejects_proposals() {
    for seed in 0..20 {
        on_virtual_time(async {
            let fleet = Fleet::bootstrapped(seed, 5, default_settings).await;
            fleet.write(1).await;
            let old = fleet.leader().await;
            let follower = fleet.replicas.keys().find(|name| **name != old).expect("five nodes").clone();
            let majority: Vec<_> =
                fleet.replicas.keys().filter(|name| ![&old, &follower].contains(name)).cloned().collect();
            let old_leadership = fleet.view(&old).leader_id.expect("a leader");
            fleet.network.partition([vec![old.clone(), follower.clone()], majority.clone()]);

            // The leader has not detected the partition yet: the outcome of its proposal is unknown
            // to the caller.
            let cut_at = Instant::now();
            let limit = Duration::from_millis(100);
            let pending = fleet.replicas[&old].propose(NumberCommand::Append(2), limit).await;
            assert_eq!(pending, Err(ProposeError::TimedOut { limit }));
            assert!(cut_at.elapsed() <= limit + Duration::from_millis(2), "{:?}", cut_at.elapsed());

            let mut view = fleet.replicas[&old].leadership();
            view.wait_for(|now| !now.is_leader).await.expect("a replica");
            let detected_after = cut_at.elapsed();
            assert!(detected_after <= Duration::from_millis(281), "{detected_after:?}, seed {seed}");
            assert!(fleet.leaders().is_empty(), "another led at the same time, seed {seed}");
            let now = fleet.view(&old);
            assert!(now.lost_quorum && now.leader_id.is_none() && now.leader.is_none());
            let refused_at = Instant::now();
            let refused = fleet.replicas[&old].propose(NumberCommand::Append(3), limit).await;
            assert_eq!(refused, Err(ProposeError::NoQuorum { reachable: 2, voters: 5 }));
            assert_eq!(refused_at.elapsed(), Duration::ZERO);
            assert!(fleet.replicas[&old].ensure_leader(limit).await.is_err());

            let new = fleet.leader().await;
            assert!(majority.contains(&new));
            let new_leadership = fleet.view(&new).leader_id.expect("a leader");
            assert!(new_leadership > old_leadership);
            fleet.replicas[&new].ensure_leader(TIMEOUT).await.expect("a confirmation");
            fleet.replicas[&new].propose(NumberCommand::Append(4), TIMEOUT).await.expect("a commit");

            fleet.network.heal();
            fleet.write(5).await;
            fleet.until_all_hold(3).await;
            assert_eq!(fleet.common().numbers(), [1, 4, 5], "seed {seed}");
        });
    }
}

#[test]
fn two_nodes_never_count_themselves_leader() {
    for seed in 0..12 {
        on_virtual_time(async {
            let fleet = Fleet::bootstrapped(seed, 5, default_settings).await;
            let mut last = LeaderId::default();
            for round in 0..8 {
                let leader = fleet.leader().await;
                let others: Vec<_> = fleet.replicas.keys().filter(|name| **name != leader).cloned().collect();
                match round % 4 {
                    0 => fleet.network.partition([vec![leader.clone()], others]),
                    1 => fleet.network.block_outgoing(leader.clone()),
                    2 => fleet.network.block_incoming(leader.clone()),
                    _ => fleet.network.pause(&leader),
                }
                for step in 0..1500 {
                    let leaders = fleet.leaders();
                    assert!(leaders.len() <= 1, "{leaders:?} at once, seed {seed}, round {round}");
                    if let [leader] = &leaders[..] {
                        let leadership = fleet.view(leader).leader_id.expect("a leader");
                        assert!(leadership >= last, "{leadership} after {last}, seed {seed}");
                        last = leadership;
                    }
                    if step == 800 {
                        fleet.network.heal();
                        fleet.network.resume(&leader);
                    }
                    tokio::time::sleep(Duration::from_millis(1)).await;
                }
            }
        });
    }
}

#[test]
fn a_leader_with_a_one_way_link_is_replaced() {
    for seed in 0..20 {
        for sending in [true, false] {
            on_virtual_time(async {
                let fleet = Fleet::bootstrapped(seed, 3, default_settings).await;
                fleet.write(1).await;
                let old = fleet.leader().await;
                if sending {
                    fleet.network.block_outgoing(old.clone());
                } else {
                    fleet.network.block_incoming(old.clone());
                }
                fleet.until("the old leader steps down", |fleet| !fleet.view(&old).is_leader).await;
                fleet.until("another leads", |fleet| fleet.leaders().iter().any(|leader| *leader != old)).await;
                fleet.write(2).await;
                fleet.network.heal();
                fleet.write(3).await;
                fleet.until_all_hold(3).await;
                assert_eq!(fleet.common().numbers(), [1, 2, 3], "seed {seed}");
            });
        }
    }
}

#[test]
fn a_node_that_was_cut_off_catches_up_by_a_chunked_snapshot() {
    on_virtual_time(async {
        let fleet = Fleet::bootstrapped(3, 3, with_short_logs).await;
        let lost = fleet.advance_without_follower(200).await;
        assert!(fleet.replicas[&lost].read(|list| list.written.is_empty()));
        fleet.network.heal();
        fleet.until_all_hold(200).await;
        fleet.write(200).await;
        fleet.until_all_hold(201).await;
        assert_eq!(fleet.common().numbers(), (0..=200).collect::<Vec<_>>());
        let stored = fleet.log_stores[&lost].load().await.expect("a log store in memory");
        assert!(stored.snapshot.is_some_and(|bytes| bytes.len() > 300_000));
        assert!(stored.entries.len() <= 30, "{} entries kept", stored.entries.len());
    });
}

#[test]
fn a_fleet_continues_after_a_power_failure() {
    for seed in 0..10 {
        on_virtual_time(async {
            let mut fleet = Fleet::bootstrapped(seed, 3, with_short_logs).await;
            for number in 0..50 {
                fleet.write(number).await;
            }
            let ids: Vec<_> = fleet.replicas.values().map(Replica::id).collect();
            for name in fleet.replicas.keys().cloned().collect::<Vec<_>>() {
                fleet.kill(&name);
            }
            tokio::time::sleep(TIMEOUT).await;
            for name in ["ada", "bob", "cyd"] {
                fleet.start(name).await;
            }
            assert_eq!(fleet.replicas.values().map(Replica::id).collect::<Vec<_>>(), ids);
            fleet.write(50).await;
            fleet.until_all_hold(51).await;
            assert_eq!(fleet.common().numbers(), (0..=50).collect::<Vec<_>>());
        });
    }
}

#[test]
fn a_node_with_an_empty_store_comes_back_as_another_member() {
    on_virtual_time(async {
        let mut fleet = Fleet::bootstrapped(5, 3, default_settings).await;
        fleet.write(1).await;
        let leader = fleet.leader().await;
        let lost = fleet.replicas.keys().find(|name| **name != leader).expect("three nodes").clone();
        let former = fleet.replicas[&lost].id();
        fleet.kill(&lost);
        let present = fleet.start_empty(lost.as_str()).await;
        assert_ne!(present, former);

        // It is not a member: it neither campaigns nor counts towards a majority.
        tokio::time::sleep(TIMEOUT).await;
        let replaced_node = fleet.view(&lost);
        assert_eq!((replaced_node.term, replaced_node.leader_id, replaced_node.voters.len()), (0, None, 0));
        let leader = fleet.leader().await;
        let voters = fleet.view(&leader).voters;
        assert!(voters.contains_key(&former) && !voters.contains_key(&present));

        let leader_replica = fleet.replicas[&leader].clone();
        let new_voters: BTreeSet<_> = voters.keys().copied().filter(|id| *id != former).chain([present]).collect();
        let refused = leader_replica.set_voters(new_voters.clone(), TIMEOUT).await;
        assert_eq!(refused, Err(MemberError::NotLearner(present)));
        leader_replica.add_learner(present, lost.clone(), TIMEOUT).await.expect("a commit");
        fleet.until_all_hold(1).await;
        leader_replica.set_voters(new_voters.clone(), TIMEOUT).await.expect("a commit");
        fleet
            .until("all nodes have the new voters", |fleet| {
                fleet
                    .replicas
                    .keys()
                    .all(|name| fleet.view(name).voters.keys().copied().collect::<BTreeSet<_>>() == new_voters)
            })
            .await;
        // The other former voter fails: the vote of the new voter is needed, and granted.
        let third = fleet.replicas.keys().find(|name| ![&lost, &leader].contains(name)).expect("three nodes").clone();
        fleet.kill(&third);
        fleet.write(2).await;
        fleet.until_all_hold(2).await;
        assert_eq!(fleet.common().numbers(), [1, 2]);
    });
}

#[test]
fn undecodable_requests_are_rejected_and_counted() {
    on_virtual_time(async {
        let fleet = Fleet::bootstrapped(6, 3, default_settings).await;
        fleet.write(1).await;
        let target = fleet.on("bob").id();
        let stranger = fleet.network.bus(node("zed"));
        for call in ["vote", "append", "snapshot", "snapshot_blocks", "pre_vote", "transfer_leadership", "dance"] {
            let key = format!("consort/ward/wire/raft/{target}/{call}");
            let mut replies = stranger.query(&key, vec![1, 255, 255].into(), TIMEOUT).await.expect("a query");
            assert!(replies.recv().await.is_some_and(|reply| reply.payload.is_err()), "{call}");
        }
        assert_eq!(fleet.on("bob").rejected_requests(), 7);
        fleet.write(2).await;
        fleet.until_all_hold(2).await;
    });
}

#[test]
fn bad_links_delay_commits_and_lose_none() {
    for seed in 0..10 {
        on_virtual_time(async {
            let fleet = Fleet::bootstrapped(seed, 5, with_short_logs).await;
            fleet.write(0).await;
            let slow = Duration::from_millis(5);
            let bad = LinkModel { latency_max: slow, loss: 0.1, duplication: 0.1, ..LinkModel::LAN };
            fleet.network.set_link_model(bad);
            let mut acknowledged = BTreeMap::new();
            for number in 1..100 {
                acknowledged.insert(fleet.write(number).await, number);
            }
            fleet.network.set_link_model(LinkModel::LAN);
            acknowledged.insert(fleet.write(100).await, 100);
            let last = *acknowledged.keys().last().expect("a commit");
            fleet
                .until("all nodes have applied it", |fleet| {
                    fleet.replicas.values().all(|r| *r.applied().borrow() >= last)
                })
                .await;
            let log: BTreeMap<_, _> = fleet.common().written.into_iter().collect();
            assert!(acknowledged.iter().all(|(at, number)| log.get(at) == Some(number)), "seed {seed}");
        });
    }
}

#[test]
fn a_second_bootstrap_changes_nothing() {
    on_virtual_time(async {
        let fleet = Fleet::bootstrapped(7, 3, default_settings).await;
        let members: BTreeMap<_, _> =
            fleet.replicas.iter().map(|(name, replica)| (replica.id(), name.clone())).collect();
        // Two nodes bootstrap the same cluster; the second may call it before it receives messages
        // of the first.
        let _ = fleet.on("bob").bootstrap(members.clone()).await;
        fleet.write(1).await;
        fleet.until_all_hold(1).await;
        let again = fleet.on("cyd").bootstrap(members).await;
        assert_eq!(again, Err(BootstrapError::AlreadyBootstrapped));
        assert_eq!(fleet.common().numbers(), [1]);
    });
}

#[test]
fn a_returning_voter_does_not_depose_the_leader() {
    for seed in 0..15 {
        on_virtual_time(async {
            let fleet = Fleet::bootstrapped(seed, 5, default_settings).await;
            fleet.write(1).await;
            let leader = fleet.leader().await;
            let leadership = fleet.view(&leader).leader_id;
            let lost = fleet.replicas.keys().find(|name| **name != leader).expect("five nodes").clone();
            let others = fleet.replicas.keys().filter(|name| **name != lost).cloned().collect();
            fleet.network.partition([vec![lost.clone()], others]);
            tokio::time::sleep(TIMEOUT).await;
            fleet.network.heal();
            tokio::time::sleep(TIMEOUT).await;
            fleet.write(2).await;
            fleet.until_all_hold(2).await;
            for name in fleet.replicas.keys() {
                assert_eq!(fleet.view(name).leader_id, leadership, "{name}, seed {seed}");
            }
        });
    }
}
