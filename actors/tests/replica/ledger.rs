//! Elections, crashes, partitions, restarts: one ledger, whatever happens.

use crate::support::{Fleet, NumberCommand, TIMEOUT, default_settings, node, on_virtual_time, with_short_logs};
use consort_actors::bus::Bus as _;
use consort_actors::bus::virtual_bus::LinkModel;
use consort_actors::raft::{
    BootstrapError, LeaderId, LeadershipView, LogStore as _, MemberError, ProposeError, Replica,
};
use consort_protocol::ids::NodeId;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tokio::time::Instant;

#[test]
fn three_and_five_nodes_elect_one_leader_and_apply_all_writes_in_one_order() {
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
                let believed = fleet.view(name);
                assert_eq!(believed.leader, Some(leader.clone()));
                assert_eq!(believed.voters.len(), size);
                assert_eq!(believed.is_leader, *name == leader);
            }
        });
    }
}

#[test]
fn a_killed_leader_is_replaced_and_nothing_acknowledged_is_lost() {
    for seed in 0..50 {
        on_virtual_time(async {
            let mut fleet = Fleet::bootstrapped(seed, 5, default_settings).await;
            let mut acknowledged = BTreeMap::new();
            for round in 0..2 {
                for number in round * 100..round * 100 + 20 {
                    acknowledged.insert(fleet.write(number).await, number);
                }
                // One more is under way when the leader dies: whether it is committed, nobody can say.
                let leader = fleet.leader().await;
                let dying = fleet.replicas[&leader].clone();
                let open =
                    tokio::spawn(async move { dying.propose(NumberCommand::Append(1_000_000 + round), TIMEOUT).await });
                tokio::time::sleep(Duration::from_micros(500)).await;
                open.abort();
                fleet.kill(&leader);
                acknowledged.insert(fleet.write(round * 100 + 50).await, round * 100 + 50);
            }
            fleet.until_all_hold(acknowledged.len()).await;
            fleet.until_all_agree().await;
            let held: BTreeMap<_, _> = fleet.common().written.into_iter().collect();
            for (at, number) in acknowledged {
                assert_eq!(held.get(&at), Some(&number), "at {at}, seed {seed}");
            }
        });
    }
}

/// What happened when: virtual time, term and leader, on every change that any node believes in.
type Chronicle = Vec<(Duration, NodeId, u64, Option<NodeId>, bool)>;

/// Tells a run with two dead leaders, and the digest of all its messages.
async fn chronicle(seed: u64) -> (Chronicle, u64) {
    let mut fleet = Fleet::bootstrapped(seed, 5, default_settings).await;
    let mut told = Vec::new();
    let mut last: BTreeMap<NodeId, LeadershipView> = BTreeMap::new();
    let mut number = 0;
    for step in 0..3000 {
        for name in fleet.replicas.keys() {
            let believed = fleet.view(name);
            if last.get(name) != Some(&believed) {
                let leader = believed.leader.clone();
                told.push((fleet.began.elapsed(), name.clone(), believed.term, leader, believed.is_leader));
                last.insert(name.clone(), believed);
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
    (told, fleet.network.digest())
}

#[test]
fn one_seed_gives_one_run_and_another_gives_another() {
    let runs: Vec<_> = (0..6).map(|seed| on_virtual_time(chronicle(seed))).collect();
    for (seed, run) in (0..).zip(&runs) {
        assert!(run.0.len() > 20, "{run:#?}");
        assert_eq!(*run, on_virtual_time(chronicle(seed)), "seed {seed}");
    }
    assert_eq!(runs.iter().collect::<BTreeSet<_>>().len(), runs.len());
}

#[test]
fn a_leader_in_the_minority_knows_it_and_refuses_while_the_majority_goes_on() {
    for seed in 0..20 {
        on_virtual_time(async {
            let fleet = Fleet::bootstrapped(seed, 5, default_settings).await;
            fleet.write(1).await;
            let old = fleet.leader().await;
            let companion = fleet.replicas.keys().find(|name| **name != old).expect("five nodes").clone();
            let majority: Vec<_> =
                fleet.replicas.keys().filter(|name| ![&old, &companion].contains(name)).cloned().collect();
            let old_reign = fleet.view(&old).leader_id.expect("a reign");
            fleet.network.partition([vec![old.clone(), companion.clone()], majority.clone()]);

            // It cannot know yet: what it proposes now is open for ever, as far as the caller can tell.
            let cut_at = Instant::now();
            let limit = Duration::from_millis(100);
            let open = fleet.replicas[&old].propose(NumberCommand::Append(2), limit).await;
            assert_eq!(open, Err(ProposeError::TimedOut { limit }));
            assert!(cut_at.elapsed() <= limit + Duration::from_millis(2), "{:?}", cut_at.elapsed());

            let mut believed = fleet.replicas[&old].leadership();
            believed.wait_for(|now| !now.is_leader).await.expect("a replica");
            let doubted_after = cut_at.elapsed();
            assert!(doubted_after <= Duration::from_millis(281), "{doubted_after:?}, seed {seed}");
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
            let new_reign = fleet.view(&new).leader_id.expect("a reign");
            assert!(new_reign > old_reign);
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
fn at_no_instant_do_two_nodes_count_themselves_leader() {
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
                        let reign = fleet.view(leader).leader_id.expect("a reign");
                        assert!(reign >= last, "{reign} after {last}, seed {seed}");
                        last = reign;
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
fn a_leader_that_no_one_hears_is_replaced_and_a_leader_that_hears_no_one_steps_down() {
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
                fleet.until("the old leader doubts", |fleet| !fleet.view(&old).is_leader).await;
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
fn a_node_that_was_cut_off_for_long_catches_up_by_a_snapshot_of_many_chunks() {
    on_virtual_time(async {
        let fleet = Fleet::bootstrapped(3, 3, with_short_logs).await;
        let leader = fleet.leader().await;
        let lost = fleet.replicas.keys().find(|name| **name != leader).expect("three nodes").clone();
        let others = fleet.replicas.keys().filter(|name| **name != lost).cloned().collect();
        fleet.network.partition([vec![lost.clone()], others]);
        fleet.replicas[&leader].propose(NumberCommand::Grow(300_000), TIMEOUT).await.expect("a commit");
        for number in 0..200 {
            fleet.replicas[&leader].propose(NumberCommand::Append(number), TIMEOUT).await.expect("a commit");
        }
        assert!(fleet.replicas[&lost].read(|tally| tally.written.is_empty()));
        fleet.network.heal();
        fleet.until_all_hold(200).await;
        fleet.write(200).await;
        fleet.until_all_hold(201).await;
        assert_eq!(fleet.common().numbers(), (0..=200).collect::<Vec<_>>());
        let kept = fleet.log_stores[&lost].load().await.expect("a memory journal");
        assert!(kept.snapshot.is_some_and(|bytes| bytes.len() > 300_000));
        assert!(kept.entries.len() <= 30, "{} entries kept", kept.entries.len());
    });
}

#[test]
fn a_fleet_that_lost_power_takes_up_where_its_journals_end() {
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
fn a_node_that_comes_back_empty_is_another_voter_and_may_take_the_place_of_the_former() {
    on_virtual_time(async {
        let mut fleet = Fleet::bootstrapped(5, 3, default_settings).await;
        fleet.write(1).await;
        let leader = fleet.leader().await;
        let lost = fleet.replicas.keys().find(|name| **name != leader).expect("three nodes").clone();
        let former = fleet.replicas[&lost].id();
        fleet.kill(&lost);
        let present = fleet.start_empty(lost.as_str()).await;
        assert_ne!(present, former);

        // It is nobody to Raft: it neither stands for election nor counts towards a majority.
        tokio::time::sleep(TIMEOUT).await;
        let newcomer = fleet.view(&lost);
        assert_eq!((newcomer.term, newcomer.leader_id, newcomer.voters.len()), (0, None, 0));
        let leader = fleet.leader().await;
        let voters = fleet.view(&leader).voters;
        assert!(voters.contains_key(&former) && !voters.contains_key(&present));

        let chief = fleet.replicas[&leader].clone();
        let kept: BTreeSet<_> = voters.keys().copied().filter(|id| *id != former).chain([present]).collect();
        let refused = chief.set_voters(kept.clone(), TIMEOUT).await;
        assert_eq!(refused, Err(MemberError::NotLearner(present)));
        chief.add_learner(present, lost.clone(), TIMEOUT).await.expect("a commit");
        fleet.until_all_hold(1).await;
        chief.set_voters(kept.clone(), TIMEOUT).await.expect("a commit");
        fleet
            .until("all know", |fleet| {
                fleet
                    .replicas
                    .keys()
                    .all(|name| fleet.view(name).voters.keys().copied().collect::<BTreeSet<_>>() == kept)
            })
            .await;
        // The other old voter dies: the newcomer's vote is needed, and given.
        let third = fleet.replicas.keys().find(|name| ![&lost, &leader].contains(name)).expect("three nodes").clone();
        fleet.kill(&third);
        fleet.write(2).await;
        fleet.until_all_hold(2).await;
        assert_eq!(fleet.common().numbers(), [1, 2]);
    });
}

#[test]
fn what_cannot_be_read_is_refused_and_counted_and_what_is_too_large_is_not_proposed() {
    on_virtual_time(async {
        let fleet = Fleet::bootstrapped(6, 3, default_settings).await;
        fleet.write(1).await;
        let target = fleet.on("bob").id();
        let stranger = fleet.network.bus(node("zed"));
        for verb in ["vote", "append", "snapshot", "canvass", "succeed", "dance"] {
            let key = format!("consort/ward/wire/raft/{target}/{verb}");
            let mut replies = stranger.query(&key, vec![1, 255, 255].into(), TIMEOUT).await.expect("a query");
            assert!(replies.recv().await.is_some_and(|reply| reply.payload.is_err()), "{verb}");
        }
        assert_eq!(fleet.on("bob").rejected_requests(), 6);
        fleet.write(2).await;
        fleet.until_all_hold(2).await;
    });
}

#[test]
fn a_bad_link_delays_commits_and_loses_none() {
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
                .until("all have applied it", |fleet| fleet.replicas.values().all(|r| *r.applied().borrow() >= last))
                .await;
            let held: BTreeMap<_, _> = fleet.common().written.into_iter().collect();
            assert!(acknowledged.iter().all(|(at, number)| held.get(at) == Some(number)), "seed {seed}");
        });
    }
}

#[test]
fn founding_twice_changes_nothing() {
    on_virtual_time(async {
        let fleet = Fleet::bootstrapped(7, 3, default_settings).await;
        let members: BTreeMap<_, _> =
            fleet.replicas.iter().map(|(name, replica)| (replica.id(), name.clone())).collect();
        // Two of them founded the same fleet, the second perhaps before it heard of the first.
        let _ = fleet.on("bob").bootstrap(members.clone()).await;
        fleet.write(1).await;
        fleet.until_all_hold(1).await;
        let again = fleet.on("cyd").bootstrap(members).await;
        assert_eq!(again, Err(BootstrapError::AlreadyBootstrapped));
        assert_eq!(fleet.common().numbers(), [1]);
    });
}

#[test]
fn a_voter_that_returns_does_not_unseat_the_leader() {
    for seed in 0..15 {
        on_virtual_time(async {
            let fleet = Fleet::bootstrapped(seed, 5, default_settings).await;
            fleet.write(1).await;
            let leader = fleet.leader().await;
            let reign = fleet.view(&leader).leader_id;
            let lost = fleet.replicas.keys().find(|name| **name != leader).expect("five nodes").clone();
            let others = fleet.replicas.keys().filter(|name| **name != lost).cloned().collect();
            fleet.network.partition([vec![lost.clone()], others]);
            tokio::time::sleep(TIMEOUT).await;
            fleet.network.heal();
            tokio::time::sleep(TIMEOUT).await;
            fleet.write(2).await;
            fleet.until_all_hold(2).await;
            for name in fleet.replicas.keys() {
                assert_eq!(fleet.view(name).leader_id, reign, "{name}, seed {seed}");
            }
        });
    }
}
