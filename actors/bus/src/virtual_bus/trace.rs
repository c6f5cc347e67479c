//! Digest of all deliveries, for comparing two runs without storing them.

use super::ids::NodeIndex;
use tokio::time::Instant;

/// Hash over every delivery: time, sender, receiver, name and content.
pub(super) struct Trace {
    start: Instant,
    digest: u64,
}

impl Trace {
    pub(super) fn new(start: Instant) -> Self {
        Trace { start, digest: 0 }
    }

    pub(super) fn record(&mut self, now: Instant, from: NodeIndex, to: NodeIndex, name: u64, content: &[u8]) {
        let elapsed = u64::try_from((now - self.start).as_nanos()).unwrap_or(u64::MAX);
        for word in [elapsed, from as u64, to as u64, name, content.len() as u64] {
            self.mix(word);
        }
        for chunk in content.chunks(8) {
            let mut word = [0; 8];
            word[..chunk.len()].copy_from_slice(chunk);
            self.mix(u64::from_le_bytes(word));
        }
    }

    /// A step of FxHash: fast, and sufficient to distinguish runs without malicious input.
    fn mix(&mut self, word: u64) {
        self.digest = (self.digest.rotate_left(5) ^ word).wrapping_mul(0x517c_c1b7_2722_0a95);
    }

    pub(super) fn digest(&self) -> u64 {
        self.digest
    }
}
