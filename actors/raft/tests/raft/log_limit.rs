//! The log is limited in size, because each replica keeps it in memory.

use crate::support::{Fleet, NumberCommand, TIMEOUT, default_settings, on_virtual_time};
use consort_raft::LogStore as _;
use std::time::Duration;
use tokio::time::{Instant, sleep};

/// Commits entries of 40 kB.
async fn commit(fleet: &Fleet, entries: usize) {
    let leader = fleet.leader().await;
    for _ in 0..entries {
        fleet.replicas[&leader].propose(NumberCommand::Pad(vec![7; 40_000]), TIMEOUT).await.expect("a commit");
    }
}

/// Returns the number of nodes with a snapshot.
async fn snapshots(fleet: &Fleet) -> usize {
    let mut count = 0;
    for store in fleet.log_stores.values() {
        count += usize::from(store.load().await.expect("it is in memory").snapshot.is_some());
    }
    count
}

#[test]
fn large_entries_are_covered_by_a_snapshot_before_there_are_many() {
    on_virtual_time(async {
        let fleet = Fleet::bootstrapped(7, 3, default_settings).await;
        commit(&fleet, 100).await;
        sleep(Duration::from_secs(1)).await;
        assert_eq!(snapshots(&fleet).await, 0, "4 MB are few");
        commit(&fleet, 150).await;
        let began = Instant::now();
        while snapshots(&fleet).await < 3 {
            assert!(began.elapsed() < Duration::from_secs(20), "not all replicas have taken a snapshot");
            sleep(Duration::from_millis(10)).await;
        }
    });
}

#[test]
fn the_log_may_grow_by_the_size_of_a_large_snapshot() {
    on_virtual_time(async {
        let fleet = Fleet::bootstrapped(8, 1, default_settings).await;
        let leader = fleet.leader().await;
        let snapshot = async || fleet.log_stores[&leader].load().await.expect("it is in memory").snapshot;
        fleet.replicas[&leader].propose(NumberCommand::Grow(12_000_000), TIMEOUT).await.expect("a commit");
        commit(&fleet, 230).await;
        let began = Instant::now();
        while snapshot().await.is_none() {
            assert!(began.elapsed() < Duration::from_secs(20), "no snapshot after 9 MB");
            sleep(Duration::from_millis(10)).await;
        }
        let first = snapshot().await;
        commit(&fleet, 230).await;
        sleep(Duration::from_secs(1)).await;
        assert!(snapshot().await == first, "another snapshot of 12 MB after 9 MB");
        commit(&fleet, 120).await;
        let began = Instant::now();
        while snapshot().await == first {
            assert!(began.elapsed() < Duration::from_secs(20), "no snapshot after 14 MB");
            sleep(Duration::from_millis(10)).await;
        }
    });
}
