//! Time without a leader, by timing preset and by the kind of failure of the last leader.

use crate::support::{Fleet, NumberCommand, default_settings, on_virtual_time};
use consort_bus::virtual_bus::LinkModel;
use consort_protocol::ids::NodeId;
use consort_protocol::timing::Timing;
use consort_raft::RaftSettings;
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::time::Instant;

/// Measures the time from the failure of the leader to the first commit of its successor, in
/// virtual milliseconds. The nodes may announce their presence.
fn failover(seed: u64, settings: fn(NodeId) -> RaftSettings, announced: bool) -> u128 {
    on_virtual_time(async {
        let mut fleet = Fleet::bootstrapped(seed, 5, settings).await;
        let _tokens = if announced { fleet.announce_all().await } else { BTreeMap::new() };
        fleet.write(1).await;
        // At a varying phase of the heartbeat.
        tokio::time::sleep(Duration::from_millis(500) + Duration::from_micros(seed * 7919 % 75_000)).await;
        let leader = fleet.leader().await;
        let killed_at = Instant::now();
        fleet.kill(&leader);
        fleet.write(2).await;
        killed_at.elapsed().as_millis()
    })
}

fn with_short_elections(node: NodeId) -> RaftSettings {
    let ms = Duration::from_millis;
    default_settings(node).with_times(ms(50), ms(150), ms(300))
}

pub(crate) fn on_wifi(node: NodeId) -> RaftSettings {
    default_settings(node).with_timing(Timing::Wifi)
}

/// Returns the median and the 99th percentile, by nearest rank.
pub(crate) fn ranks(mut times: Vec<u128>) -> (u128, u128) {
    times.sort_unstable();
    (times[(times.len() - 1) / 2], times[(times.len() * 99).div_ceil(100) - 1])
}

#[test]
#[expect(clippy::print_stderr, reason = "the test prints its measurements")]
fn failover_takes_less_than_a_second_or_four_on_bad_links() {
    for (case, settings, announced, seeds, p50_max, p99_max) in [
        ("50 / 150-300 ms", with_short_elections as fn(NodeId) -> RaftSettings, false, 200, 250, 400),
        ("lan", default_settings, false, 200, 400, 1000),
        ("wifi", on_wifi, false, 100, 3000, 4000),
        ("lan, with presence", default_settings, true, 200, 100, 250),
        ("wifi, with presence", on_wifi, true, 100, 250, 600),
    ] {
        let times: Vec<_> = (0..seeds).map(|seed| failover(seed, settings, announced)).collect();
        let (p50, p99) = ranks(times);
        eprintln!("failover after a kill, {case}, {seeds} seeds: p50 {p50} ms, p99 {p99} ms");
        assert!(p50 <= p50_max && p99 <= p99_max, "{case}");
    }
}

/// Links that lose a tenth of all messages.
pub(crate) const LOSSY: LinkModel = LinkModel { loss: 0.1, ..LinkModel::LAN };

#[test]
#[expect(clippy::print_stderr, reason = "the test prints its measurements")]
fn on_lossy_links_only_a_dead_leader_is_replaced() {
    for seed in 0..5 {
        on_virtual_time(async {
            let fleet = Fleet::bootstrapped(seed, 5, on_wifi).await;
            fleet.write(1).await;
            fleet.network.set_link_model(LOSSY);
            let leader = fleet.leader().await;
            let leadership = fleet.view(&leader).leader_id;
            for second in 0..600 {
                tokio::time::sleep(Duration::from_secs(1)).await;
                for name in fleet.replicas.keys() {
                    assert_eq!(fleet.view(name).leader_id, leadership, "{name} after {second} s, seed {seed}");
                }
                assert!(fleet.view(&leader).is_leader, "the leader lost its quorum after {second} s, seed {seed}");
            }
        });
    }
    let times = (0..100).map(|seed| {
        on_virtual_time(async {
            let mut fleet = Fleet::bootstrapped(seed, 5, on_wifi).await;
            fleet.write(1).await;
            fleet.network.set_link_model(LOSSY);
            tokio::time::sleep(Duration::from_millis(500 + seed * 7 % 250)).await;
            let leader = fleet.leader().await;
            let killed_at = Instant::now();
            fleet.kill(&leader);
            fleet.write(2).await;
            killed_at.elapsed().as_millis()
        })
    });
    let (p50, p99) = ranks(times.collect());
    eprintln!("failover after a kill, wifi, a tenth of all messages lost, 100 seeds: p50 {p50} ms, p99 {p99} ms");
    assert!(p99 <= 4000);
}

/// Measures the time until the first commit of the successor when the leader is isolated in both
/// directions, or frozen.
fn failover_after_lost_contact(seed: u64, frozen: bool) -> u128 {
    on_virtual_time(async {
        let fleet = Fleet::bootstrapped(seed, 5, default_settings).await;
        fleet.write(1).await;
        tokio::time::sleep(Duration::from_millis(500) + Duration::from_micros(seed * 7919 % 100_000)).await;
        let leader = fleet.leader().await;
        let lost_at = Instant::now();
        if frozen {
            fleet.network.pause(&leader);
        } else {
            fleet.network.isolate(leader.clone());
        }
        loop {
            let new_leaders: Vec<_> = fleet.leaders().into_iter().filter(|name| *name != leader).collect();
            if let [next] = &new_leaders[..]
                && fleet.replicas[next].propose(NumberCommand::Append(2), Duration::from_millis(500)).await.is_ok()
            {
                return lost_at.elapsed().as_millis();
            }
            assert!(lost_at.elapsed() < Duration::from_secs(20), "seed {seed}");
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    })
}

#[test]
#[expect(clippy::print_stderr, reason = "the test prints its measurements")]
fn an_unreachable_leader_is_replaced_within_five_seconds() {
    for (case, frozen) in [("link cut in both directions", false), ("leader paused", true)] {
        let (p50, p99) = ranks((0..100).map(|seed| failover_after_lost_contact(seed, frozen)).collect());
        eprintln!("failover after lost contact, {case}, lan, 100 seeds: p50 {p50} ms, p99 {p99} ms");
        assert!(p99 <= 5000, "{case}");
    }
}
