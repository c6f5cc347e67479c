//! Snapshots on their way from the leader: a follower receives only the blocks that it lacks, and installs no damaged
//! snapshot.

use crate::support::{Fleet, NumberCommand, TIMEOUT, on_virtual_time, with_short_logs};
use bytes::Bytes;
use consort_bus::{BusError, Layer, MessageContent, SharedBus};
use consort_raft::LogStore as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};
use std::time::Duration;
use tokio::time::{Instant, sleep};

/// Size of the state, in bytes.
const STATE: usize = 300_000;

/// Messages with parts of snapshots, and their faults.
#[derive(Default)]
struct Traffic {
    /// Size of all chunks so far, in bytes.
    chunk_bytes: AtomicUsize,
    /// Number of requests with the hashes of blocks.
    block_requests: AtomicUsize,
    /// Number of large chunks to be damaged.
    to_damage: AtomicU32,
    /// Requests with the hashes of blocks do not arrive as such, so that they are rejected as by a voter of an earlier release.
    rejects_blocks: bool,
}

impl Traffic {
    fn pass(&self, key: &str, payload: Bytes) -> Bytes {
        if key.ends_with("/snapshot_blocks") {
            self.block_requests.fetch_add(1, Ordering::SeqCst);
            return if self.rejects_blocks { Bytes::from_static(&[1, 255, 255]) } else { payload };
        }
        if !key.ends_with("/snapshot") {
            return payload;
        }
        self.chunk_bytes.fetch_add(payload.len(), Ordering::SeqCst);
        let is_due = || self.to_damage.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |left| left.checked_sub(1));
        if payload.len() < 1000 || is_due().is_err() {
            return payload;
        }
        let mut bytes = payload.to_vec();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        bytes.into()
    }
}

/// A bus that counts the bytes of snapshots, and damages a part of one.
struct SnapshotBus {
    inner: SharedBus,
    traffic: Arc<Traffic>,
}

impl Layer for SnapshotBus {
    type QueryState = ();

    fn inner(&self) -> &SharedBus {
        &self.inner
    }

    fn outgoing_query(
        &self,
        key_expr: &str,
        MessageContent { payload, attachment }: MessageContent,
    ) -> Result<(MessageContent, ()), BusError> {
        Ok((MessageContent { payload: self.traffic.pass(key_expr, payload), attachment }, ()))
    }
}

async fn fleet_with(traffic: &Arc<Traffic>) -> Fleet {
    let traffic = Arc::clone(traffic);
    let layer = move |inner| Arc::new(SnapshotBus { inner, traffic: Arc::clone(&traffic) }) as SharedBus;
    Fleet::bootstrapped_on(3, 3, with_short_logs, Box::new(layer)).await
}

#[test]
fn a_snapshot_damaged_on_its_way_is_sent_again() {
    on_virtual_time(async {
        let traffic = Arc::new(Traffic { to_damage: AtomicU32::new(3), ..Traffic::default() });
        let fleet = fleet_with(&traffic).await;
        fleet.advance_without_follower(100).await;
        fleet.network.heal();
        fleet.until_all_hold(100).await;
        assert_eq!(traffic.to_damage.load(Ordering::SeqCst), 0);
        fleet.write(100).await;
        fleet.until_all_hold(101).await;
        assert_eq!(fleet.common().numbers(), (0..=100).collect::<Vec<_>>());
    });
}

/// Lets a follower with an earlier snapshot catch up by a later one, of which a small part differs. Returns the size of all
/// chunks in bytes, and the number of requests with hashes of blocks.
async fn catch_up(traffic: Traffic) -> (usize, usize) {
    let traffic = Arc::new(traffic);
    let fleet = fleet_with(&traffic).await;
    let leader = fleet.leader().await;
    fleet.replicas[&leader].propose(NumberCommand::Fill(STATE), TIMEOUT).await.expect("a commit");
    for number in 0..30 {
        fleet.write(number).await;
    }
    fleet.until_all_hold(30).await;
    let began = Instant::now();
    for store in fleet.log_stores.values() {
        let snapshot = async || store.load().await.expect("it is in memory").snapshot;
        while snapshot().await.is_none_or(|snapshot| snapshot.len() < STATE) {
            assert!(began.elapsed() < Duration::from_secs(20), "not all replicas have taken a snapshot");
            sleep(Duration::from_millis(1)).await;
        }
    }
    let sent_before = traffic.chunk_bytes.load(Ordering::SeqCst);
    fleet.advance_without_follower(200).await;
    fleet.network.heal();
    fleet.until_all_hold(230).await;
    fleet.until_all_agree().await;
    assert_eq!(fleet.common().numbers(), (0..30).chain(0..200).collect::<Vec<_>>());
    (traffic.chunk_bytes.load(Ordering::SeqCst) - sent_before, traffic.block_requests.load(Ordering::SeqCst))
}

#[test]
fn a_follower_with_an_earlier_snapshot_receives_only_the_changed_blocks() {
    let (chunk_bytes, block_requests) = on_virtual_time(catch_up(Traffic::default()));
    // An earlier and a later snapshot may be sent, each with one or two changed blocks.
    assert!((1..STATE / 2).contains(&chunk_bytes), "{chunk_bytes} bytes were sent of {STATE}");
    assert!(block_requests >= 1);
}

#[test]
fn a_damaged_block_makes_the_leader_send_the_whole_snapshot() {
    let damaged = Traffic { to_damage: AtomicU32::new(1), ..Traffic::default() };
    let (chunk_bytes, block_requests) = on_virtual_time(catch_up(damaged));
    assert!(chunk_bytes > STATE, "{chunk_bytes} bytes");
    assert!(block_requests >= 1);
}

#[test]
fn a_follower_that_does_not_know_blocks_receives_the_whole_snapshot() {
    let (chunk_bytes, block_requests) =
        on_virtual_time(catch_up(Traffic { rejects_blocks: true, ..Traffic::default() }));
    assert!(chunk_bytes > STATE, "{chunk_bytes} bytes");
    assert!(block_requests >= 1);
}
