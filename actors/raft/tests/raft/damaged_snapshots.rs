//! A snapshot that is damaged on its way is not installed; the leader sends it again.

use crate::support::{Fleet, NumberCommand, on_virtual_time, with_short_logs};
use async_trait::async_trait;
use bytes::Bytes;
use consort_bus::{
    Bus, BusError, Delivery, Encoding, Link, Presence, PresenceToken, Query, Reply, Sample, ServiceSelection,
    SharedBus, Stream,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

const TIMEOUT: Duration = Duration::from_secs(2);
const DAMAGED_CHUNKS: u32 = 3;

/// Bus that changes a byte in the first large chunks of snapshots.
struct DamagingBus {
    inner: SharedBus,
    damaged: Arc<AtomicU32>,
}

impl DamagingBus {
    fn damage(&self, key: &str, payload: Bytes) -> Bytes {
        let is_due =
            || self.damaged.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |n| (n < DAMAGED_CHUNKS).then_some(n + 1));
        if !key.ends_with("/snapshot") || payload.len() < 10_000 || is_due().is_err() {
            return payload;
        }
        let mut bytes = payload.to_vec();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        bytes.into()
    }
}

#[async_trait]
impl Bus for DamagingBus {
    async fn publish_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        attachment: Bytes,
        encoding: Encoding,
        delivery: Delivery,
    ) -> Result<(), BusError> {
        self.inner.publish_with_attachment(key, payload, attachment, encoding, delivery).await
    }

    async fn subscribe(&self, key_expr: &str) -> Result<Stream<Sample>, BusError> {
        self.inner.subscribe(key_expr).await
    }

    async fn query_with(
        &self,
        key_expr: &str,
        payload: Bytes,
        attachment: Bytes,
        timeout: Duration,
        target: ServiceSelection,
    ) -> Result<Stream<Reply>, BusError> {
        let payload = self.damage(key_expr, payload);
        self.inner.query_with(key_expr, payload, attachment, timeout, target).await
    }

    async fn serve(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        self.inner.serve(key_expr).await
    }

    async fn serve_complete(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        self.inner.serve_complete(key_expr).await
    }

    async fn announce(&self, key: &str) -> Result<PresenceToken, BusError> {
        self.inner.announce(key).await
    }

    async fn watch(&self, key_expr: &str) -> Result<Stream<Presence>, BusError> {
        self.inner.watch(key_expr).await
    }

    async fn links(&self) -> Vec<Link> {
        self.inner.links().await
    }
}

#[test]
fn a_snapshot_damaged_on_its_way_is_sent_again() {
    on_virtual_time(async {
        let damaged = Arc::<AtomicU32>::default();
        let counter = Arc::clone(&damaged);
        let damaging = move |inner| Arc::new(DamagingBus { inner, damaged: Arc::clone(&counter) }) as SharedBus;
        let fleet = Fleet::bootstrapped_on(3, 3, with_short_logs, Box::new(damaging)).await;
        let leader = fleet.leader().await;
        let lost = fleet.replicas.keys().find(|name| **name != leader).expect("three nodes").clone();
        let others = fleet.replicas.keys().filter(|name| **name != lost).cloned().collect();
        fleet.network.partition([vec![lost.clone()], others]);
        fleet.replicas[&leader].propose(NumberCommand::Grow(300_000), TIMEOUT).await.expect("a commit");
        for number in 0..100 {
            fleet.replicas[&leader].propose(NumberCommand::Append(number), TIMEOUT).await.expect("a commit");
        }
        fleet.network.heal();
        fleet.until_all_hold(100).await;
        assert_eq!(damaged.load(Ordering::SeqCst), DAMAGED_CHUNKS);
        fleet.write(100).await;
        fleet.until_all_hold(101).await;
        assert_eq!(fleet.common().numbers(), (0..=100).collect::<Vec<_>>());
    });
}
