//! The snapshot that a replica is receiving from its leader. openraft stops for good if an installation fails, so the
//! checksum is checked before it begins.

use super::blocks::{Block, OwnBlocks};
use super::snapshot_id::{has_checksum, is_intact};
use std::time::Duration;
use tokio::time::Instant;

/// Time after the latest part from which a snapshot counts as abandoned: its leader has stopped, or sends entries instead. Raised:
/// its state stays in memory for longer; lowered: a snapshot over a link that is often interrupted begins anew. A guess: longer
/// than a leader repeats a part without a reply.
const ABANDONED_AFTER: Duration = Duration::from_secs(60);

/// A part of a snapshot is rejected. The leader sends the snapshot again from its start.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum PartError {
    /// Another snapshot is being received, or an earlier part is missing.
    #[error("the part does not follow the received parts")]
    Unexpected,
    /// The state of the received snapshot was discarded.
    #[error("the snapshot is damaged: its checksum differs")]
    Damaged,
}

/// State of a snapshot, as far as it has been received.
#[derive(Default)]
pub(crate) struct ReceivedSnapshot {
    id: String,
    state: Vec<u8>,
    own: OwnBlocks,
    /// Arrival of the latest part; `None` if no snapshot is being received.
    latest_part_at: Option<Instant>,
}

/// State of a snapshot with all its parts, which is not checked yet: that takes long for a large one.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct CompleteSnapshot {
    id: String,
    state: Vec<u8>,
}

impl CompleteSnapshot {
    /// Returns the state if its checksum is that of the id.
    pub(crate) fn check(self) -> Result<Vec<u8>, PartError> {
        if is_intact(&self.id, &self.state) { Ok(self.state) } else { Err(PartError::Damaged) }
    }
}

impl ReceivedSnapshot {
    /// Notes that a part has arrived.
    pub(crate) fn note_part(&mut self, now: Instant) {
        self.latest_part_at = (!self.id.is_empty()).then_some(now);
    }

    /// Returns the time at which the snapshot counts as abandoned, unless a part arrives before; `None` if no snapshot is
    /// being received.
    pub(crate) fn abandoned_at(&self) -> Option<Instant> {
        Some(self.latest_part_at? + ABANDONED_AFTER)
    }

    /// Discards the snapshot if it is abandoned.
    pub(crate) fn discard_abandoned(&mut self, now: Instant) {
        if self.abandoned_at().is_some_and(|at| at <= now) {
            *self = ReceivedSnapshot::default();
        }
    }

    /// Checks whether the snapshot with this id is being received.
    fn is_of(&self, id: &str) -> bool {
        self.id == id
    }

    /// Checks whether a request with blocks needs the blocks of this replica: the snapshot has not begun, or a chunk
    /// has begun it. An id without a checksum needs none, since its blocks are rejected.
    pub(crate) fn needs_own_blocks(&self, id: &str) -> bool {
        has_checksum(id) && (!self.is_of(id) || self.own.is_empty())
    }

    /// Begins to receive a snapshot, unless it is being received. The parts of another are discarded. Blocks are copied from
    /// `own`.
    pub(crate) fn begin(&mut self, id: &str, own: OwnBlocks) {
        if !self.is_of(id) {
            *self = ReceivedSnapshot { id: id.to_owned(), own, ..ReceivedSnapshot::default() };
        } else if self.own.is_empty() {
            self.own = own;
        }
    }

    /// Adds a chunk; the first begins a snapshot. Returns the snapshot with the chunk at its end (`done`).
    pub(crate) fn add(
        &mut self,
        id: &str,
        offset: u64,
        chunk: &[u8],
        done: bool,
    ) -> Result<Option<CompleteSnapshot>, PartError> {
        if offset == 0 {
            self.begin(id, OwnBlocks::default());
        }
        let start = self.position(id, offset)?;
        part_of(&mut self.state, start, chunk.len()).copy_from_slice(chunk);
        if !done {
            return Ok(None);
        }
        let ReceivedSnapshot { id, mut state, .. } = std::mem::take(self);
        state.truncate(start + chunk.len());
        Ok(Some(CompleteSnapshot { id, state }))
    }

    /// Adds consecutive blocks that this replica has, and leaves room for the others. Returns for each block whether it is
    /// missing. The id must contain a checksum, since the room may never be filled.
    pub(crate) fn add_blocks(&mut self, id: &str, offset: u64, blocks: &[Block]) -> Result<Vec<bool>, PartError> {
        let mut start = self.position(id, offset)?;
        if !has_checksum(id) {
            return Err(PartError::Unexpected);
        }
        let mut missing = Vec::with_capacity(blocks.len());
        for block in blocks {
            let part = part_of(&mut self.state, start, block.length());
            let found = self.own.get(block);
            if let Some(bytes) = found {
                part.copy_from_slice(bytes);
            }
            missing.push(found.is_none());
            start += block.length();
        }
        Ok(missing)
    }

    /// Returns the place of a part that begins within the received state, or at its end.
    fn position(&self, id: &str, offset: u64) -> Result<usize, PartError> {
        let start = usize::try_from(offset).ok().filter(|start| *start <= self.state.len());
        start.filter(|_| self.is_of(id)).ok_or(PartError::Unexpected)
    }
}

/// Returns a part of the state, which grows if it ends earlier.
fn part_of(state: &mut Vec<u8>, start: usize, length: usize) -> &mut [u8] {
    let end = start + length;
    if state.len() < end {
        state.resize(end, 0);
    }
    &mut state[start..end]
}

#[cfg(test)]
mod tests {
    use super::super::blocks::blocks_of;
    use super::super::records::StoredSnapshot;
    use super::super::snapshot_id::snapshot_id;
    use super::*;
    use crate::log_store::StoreIdentity;
    use crate::types::SnapshotMeta;
    use std::sync::Arc;

    const STORE: StoreIdentity = StoreIdentity(42);

    #[test]
    fn repeated_chunks_count_once_and_missing_or_damaged_chunks_are_detected() {
        let state: Vec<u8> = (0..200).collect();
        let id = snapshot_id("T1-N2-3", STORE, &state);
        let mut received = ReceivedSnapshot::default();
        let add = |received: &mut ReceivedSnapshot, part: usize| {
            let chunk = &state[part * 60..(part * 60 + 60).min(state.len())];
            received.add(&id, part as u64 * 60, chunk, part == 3)
        };
        for part in [0, 1, 1, 0, 2] {
            assert_eq!(add(&mut received, part), Ok(None));
        }
        assert_eq!(checked(add(&mut received, 3)), Ok(state.clone()));
        assert_eq!(add(&mut received, 3), Err(PartError::Unexpected), "it is complete");
        assert_eq!(add(&mut received, 0), Ok(None));
        assert_eq!(add(&mut received, 2), Err(PartError::Unexpected), "a chunk is missing");
        assert_eq!(add(&mut received, 1), Ok(None));
        assert_eq!(add(&mut received, 2), Ok(None));
        assert_eq!(received.add(&id, 60, &[7; 60], false), Ok(None));
        assert_eq!(checked(add(&mut received, 3)), Err(PartError::Damaged));
        assert_eq!(received.add("another", 0, &[1], false), Ok(None));
        for part in [0, 1, 2] {
            assert_eq!(add(&mut received, part), Ok(None));
        }
        assert_eq!(checked(add(&mut received, 3)), Ok(state.clone()), "another was received before");
    }

    /// Returns the state of a complete snapshot, if it is intact.
    fn checked(added: Result<Option<CompleteSnapshot>, PartError>) -> Result<Vec<u8>, PartError> {
        added?.expect("the snapshot is complete").check()
    }

    #[test]
    fn an_abandoned_snapshot_is_discarded() {
        let (start, state) = (Instant::now(), [7; 200]);
        let id = snapshot_id("T1-N2-3", STORE, &state);
        let mut received = ReceivedSnapshot::default();
        received.note_part(start);
        assert_eq!(received.abandoned_at(), None, "no snapshot is being received");
        for (seconds, offset) in [(0, 0), (50, 60)] {
            assert_eq!(received.add(&id, offset, &state[..60], false), Ok(None));
            received.note_part(start + Duration::from_secs(seconds));
        }
        assert_eq!(received.abandoned_at(), Some(start + Duration::from_secs(50) + ABANDONED_AFTER));
        let kept_bytes = [109, 110].map(|seconds| {
            received.discard_abandoned(start + Duration::from_secs(seconds));
            received.state.capacity().min(120)
        });
        assert_eq!(kept_bytes, [120, 0]);
        assert_eq!(received.abandoned_at(), None);
        assert_eq!(received.add(&id, 120, &state[..60], false), Err(PartError::Unexpected), "it begins anew");
    }

    /// Returns two states of 300 kB with a common end.
    fn states() -> [Vec<u8>; 2] {
        let common: Vec<u8> = (0..300_000_u32).map(|number| (number.wrapping_mul(0x9e37_79b1) >> 24) as u8).collect();
        [[&b"former"[..], &common].concat(), [&b"the latter"[..], &common].concat()]
    }

    fn own(state: Vec<u8>) -> OwnBlocks {
        OwnBlocks::of(Arc::new(StoredSnapshot { meta: SnapshotMeta::default(), state }))
    }

    #[test]
    fn own_blocks_and_sent_chunks_make_up_the_state() {
        let [former, state] = states();
        let id = snapshot_id("T1-N2-3", STORE, &state);
        for damage in [false, true] {
            let mut received = ReceivedSnapshot::default();
            received.begin(&id, own(former.clone()));
            let (mut offset, mut sent) = (0, 0);
            for batch in blocks_of(&state).chunks(3) {
                let missing = received.add_blocks(&id, offset as u64, batch).unwrap();
                // A repeated request has the same reply.
                assert_eq!(received.add_blocks(&id, offset as u64, batch), Ok(missing.clone()));
                for (block, is_missing) in batch.iter().zip(missing) {
                    let mut bytes = state[offset..offset + block.length()].to_vec();
                    if is_missing {
                        bytes[0] ^= u8::from(damage);
                        assert_eq!(received.add(&id, offset as u64, &bytes, false), Ok(None));
                        sent += bytes.len();
                    }
                    offset += block.length();
                }
            }
            assert!((1..150_000).contains(&sent), "{sent} bytes of {}", state.len());
            let expected = if damage { Err(PartError::Damaged) } else { Ok(state.clone()) };
            assert!(checked(received.add(&id, state.len() as u64, &[], true)) == expected, "damage: {damage}");
        }
    }

    #[test]
    fn own_blocks_are_found_of_a_snapshot_that_began_with_a_chunk() {
        let [former, state] = states();
        let id = snapshot_id("T1-N2-3", STORE, &state);
        let blocks = blocks_of(&state);
        let mut received = ReceivedSnapshot::default();
        assert!(!received.needs_own_blocks("T1-N2-3@0000000000000000000000000000002a"), "an id of an earlier release");
        assert_eq!(received.add(&id, 0, &state[..100], false), Ok(None));
        assert!(received.needs_own_blocks(&id));
        received.begin(&id, own(former));
        assert!(!received.needs_own_blocks(&id));
        let missing = received.add_blocks(&id, 0, &blocks).unwrap();
        assert!(missing.contains(&false), "{} blocks", missing.len());
        assert!(received.needs_own_blocks(&snapshot_id("T1-N2-4", STORE, &state)), "another snapshot");
    }

    #[test]
    fn a_replica_without_a_snapshot_lacks_all_blocks() {
        let [_, state] = states();
        let id = snapshot_id("T1-N2-3", STORE, &state);
        let blocks = blocks_of(&state);
        let mut received = ReceivedSnapshot::default();
        received.begin(&id, OwnBlocks::default());
        assert_eq!(received.add_blocks(&id, 0, &blocks), Ok(vec![true; blocks.len()]));
        let complete = received.add(&id, state.len() as u64, &[], true);
        assert_eq!(checked(complete), Err(PartError::Damaged), "no block was sent");
    }

    #[test]
    fn blocks_are_rejected_that_do_not_follow_or_have_no_checksum() {
        let [_, state] = states();
        let blocks = blocks_of(&state);
        let mut received = ReceivedSnapshot::default();
        let id = snapshot_id("T1-N2-3", STORE, &state);
        assert_eq!(received.add_blocks(&id, 0, &blocks), Err(PartError::Unexpected), "it has not begun");
        received.begin(&id, own(state.clone()));
        for offset in [1, u64::MAX] {
            assert_eq!(received.add_blocks(&id, offset, &blocks), Err(PartError::Unexpected), "{offset}");
        }
        let id = "T1-N2-3@0000000000000000000000000000002a";
        received.begin(id, own(state));
        assert_eq!(received.add_blocks(id, 0, &blocks), Err(PartError::Unexpected), "an id of an earlier release");
    }
}
