//! Ids of snapshots. An id contains a checksum of the state, which accompanies a snapshot from the
//! replica that builds it to the disks of the replicas that install it.
//!
//! ```text
//!   T3-N7-12@0000000000000000000000000000002a-crc1f3d5b79
//!   └ last entry  └ store of the builder          └ CRC-32 of the encoded state
//! ```
//!
//! Two replicas may encode the same state differently, so the id includes the store. Ids of earlier
//! releases contain no checksum; their snapshots count as intact.

use crate::log_store::StoreIdentity;
use crate::settings::SNAPSHOT_CHUNK;
use consort_protocol::codec::RECORD_BYTES_MAX;
use crc32fast::Hasher;
use std::collections::BTreeMap;

/// Maximum number of chunks of a snapshot.
const CHUNKS_MAX: usize = RECORD_BYTES_MAX / SNAPSHOT_CHUNK + 1;

/// Returns the id of a snapshot of `state` up to the entry `last`, built on `store`.
pub(crate) fn snapshot_id(last: &str, store: StoreIdentity, state: &[u8]) -> String {
    format!("{last}@{:032x}-crc{:08x}", store.0, crc32fast::hash(state))
}

/// Checks the state of a snapshot against its id.
pub(crate) fn is_intact(id: &str, state: &[u8]) -> bool {
    checksum(id).is_none_or(|expected| expected == crc32fast::hash(state))
}

fn checksum(id: &str) -> Option<u32> {
    let (_, checksum) = id.rsplit_once("-crc")?;
    u32::from_str_radix(checksum, 16).ok()
}

/// Checksums of the chunks received of a snapshot. openraft keeps the chunks themselves, and stops for
/// good if the installation fails, so they are checked before it begins.
#[derive(Debug, Default)]
pub(crate) struct ReceivedChunks {
    id: String,
    /// Checksum of each chunk, by its offset.
    chunks: BTreeMap<u64, Hasher>,
}

impl ReceivedChunks {
    /// Adds a chunk. A chunk of another snapshot discards those of the former, and so does a chunk
    /// beyond the maximum number. A repeated chunk replaces itself.
    pub(crate) fn add(&mut self, id: &str, offset: u64, chunk: &[u8]) {
        if self.id != id || self.chunks.len() >= CHUNKS_MAX {
            *self = ReceivedChunks { id: id.to_owned(), chunks: BTreeMap::new() };
        }
        let mut hasher = Hasher::new();
        hasher.update(chunk);
        self.chunks.insert(offset, hasher);
    }

    /// Ends the snapshot, and checks whether the chunks together have the checksum in its id.
    pub(crate) fn finish(&mut self) -> bool {
        let ReceivedChunks { id, chunks } = std::mem::take(self);
        let mut all = Hasher::new();
        for chunk in chunks.values() {
            all.combine(chunk);
        }
        checksum(&id).is_none_or(|expected| expected == all.finalize())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STORE: StoreIdentity = StoreIdentity(42);

    #[test]
    fn any_changed_bit_of_a_snapshot_is_detected() {
        let state: Vec<u8> = (0..200).collect();
        let id = snapshot_id("T1-N2-3", STORE, &state);
        assert!(is_intact(&id, &state));
        for bit in 0..state.len() * 8 {
            let mut damaged = state.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(!is_intact(&id, &damaged), "bit {bit}");
        }
        assert!(is_intact("T1-N2-3@0000000000000000000000000000002a", &state), "an id of an earlier release");
    }

    #[test]
    fn the_number_of_chunks_is_bounded() {
        let mut received = ReceivedChunks::default();
        for offset in 0..3 * CHUNKS_MAX as u64 {
            received.add("T1-N2-3@2a-crc00000000", offset, &[1]);
            assert!(received.chunks.len() <= CHUNKS_MAX, "{offset}");
        }
        assert!(!received.finish());
    }

    #[test]
    fn repeated_chunks_count_once_and_missing_or_damaged_chunks_are_detected() {
        let state: Vec<u8> = (0..200).collect();
        let id = snapshot_id("T1-N2-3", STORE, &state);
        let mut received = ReceivedChunks::default();
        let add = |received: &mut ReceivedChunks, part: usize| {
            let chunk = &state[part * 60..(part * 60 + 60).min(state.len())];
            received.add(&id, part as u64 * 60, chunk);
        };
        for part in [0, 1, 1, 0, 2, 3] {
            add(&mut received, part);
        }
        assert!(received.finish());
        for part in [0, 2, 3] {
            add(&mut received, part);
        }
        assert!(!received.finish(), "a chunk is missing");
        for part in [0, 1, 2, 3] {
            add(&mut received, part);
        }
        received.add(&id, 60, &[7; 60]);
        assert!(!received.finish(), "a chunk is damaged");
        received.add("another", 0, &[1]);
        for part in [0, 1, 2, 3] {
            add(&mut received, part);
        }
        assert!(received.finish(), "a chunk of another snapshot was received before");
    }
}
