//! A snapshot that is damaged on its way is not installed; the leader sends it again.

use crate::support::{Fleet, on_virtual_time, with_short_logs};
use bytes::Bytes;
use consort_bus::{BusError, Layer, MessageContent, SharedBus};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

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

impl Layer for DamagingBus {
    type QueryState = ();

    fn inner(&self) -> &SharedBus {
        &self.inner
    }

    fn outgoing_query(
        &self,
        key_expr: &str,
        MessageContent { payload, attachment }: MessageContent,
    ) -> Result<(MessageContent, ()), BusError> {
        Ok((MessageContent { payload: self.damage(key_expr, payload), attachment }, ()))
    }
}

#[test]
fn a_snapshot_damaged_on_its_way_is_sent_again() {
    on_virtual_time(async {
        let damaged = Arc::<AtomicU32>::default();
        let counter = Arc::clone(&damaged);
        let damaging = move |inner| Arc::new(DamagingBus { inner, damaged: Arc::clone(&counter) }) as SharedBus;
        let fleet = Fleet::bootstrapped_on(3, 3, with_short_logs, Box::new(damaging)).await;
        fleet.advance_without_follower(100).await;
        fleet.network.heal();
        fleet.until_all_hold(100).await;
        assert_eq!(damaged.load(Ordering::SeqCst), DAMAGED_CHUNKS);
        fleet.write(100).await;
        fleet.until_all_hold(101).await;
        assert_eq!(fleet.common().numbers(), (0..=100).collect::<Vec<_>>());
    });
}
