//! Blocks of an encoded state, cut where its content says (content-defined chunking with a gear hash; Xia et al.,
//! *FastCDC*, 2016). A change of the state changes the blocks around it, and no others, even if it moves the bytes after it.
//! So a replica with an earlier snapshot has most blocks of a later one.

use super::records::StoredSnapshot;
use ring::digest::{SHA256, digest};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Minimum length of a block in bytes, except of the last.
const BLOCK_MIN: usize = 4 * 1024;

/// Maximum length of a block in bytes.
const BLOCK_MAX: usize = 64 * 1024;

/// Mean distance from the minimum length to the end of a block, in bytes. Raised: fewer hashes are sent, and a small change
/// costs more. A guess: a mission and its neighbors.
const BLOCK_MEAN_REST: u64 = 12 * 1024;

/// Number of latest bytes that the rolling hash depends on: each byte shifts it by a bit.
const WINDOW: usize = 64;

/// A block ends where the rolling hash is below this value.
const END_BELOW: u64 = u64::MAX / BLOCK_MEAN_REST;

/// Random number for each byte. Replicas must agree on them, else they have no blocks in common.
static GEAR: [u64; 256] = gear();

/// Returns the first numbers of splitmix64 with the seed 0.
const fn gear() -> [u64; 256] {
    let mut numbers = [0; 256];
    let (mut place, mut state) = (0, 0_u64);
    while place < numbers.len() {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        numbers[place] = mix(state);
        place += 1;
    }
    numbers
}

/// Mixes the bits of a number, as splitmix64 does.
const fn mix(number: u64) -> u64 {
    let mixed = (number ^ (number >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ (mixed >> 31)
}

/// Identifies a block by its length and the first half of its SHA-256, so nobody can write a mission of which a voter
/// takes an earlier block for a later one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub(crate) struct Block {
    length: u32,
    hash: u128,
}

impl Block {
    fn of(bytes: &[u8]) -> Block {
        let hash = digest(&SHA256, bytes);
        let first_half = hash.as_ref().first_chunk().copied().unwrap_or_default();
        Block { length: bytes.len() as u32, hash: u128::from_be_bytes(first_half) }
    }

    /// Returns the length in bytes.
    pub(crate) fn length(&self) -> usize {
        self.length as usize
    }

    /// Checks whether a block may have this length.
    pub(crate) fn is_valid(&self) -> bool {
        (1..=BLOCK_MAX).contains(&self.length())
    }
}

/// Returns the blocks of an encoded state, in order.
pub(crate) fn blocks_of(state: &[u8]) -> Vec<Block> {
    let mut rest = state;
    let mut blocks = vec![];
    while !rest.is_empty() {
        let (block, after) = rest.split_at(first_length(rest));
        blocks.push(Block::of(block));
        rest = after;
    }
    blocks
}

/// Returns the length of the first block.
fn first_length(bytes: &[u8]) -> usize {
    let longest = bytes.len().min(BLOCK_MAX);
    let mut hash = 0_u64;
    for (place, byte) in bytes[..longest].iter().enumerate().skip(BLOCK_MIN - WINDOW) {
        hash = (hash << 1).wrapping_add(GEAR[usize::from(*byte)]);
        let length = place + 1;
        if length >= BLOCK_MIN && hash < END_BELOW {
            return length;
        }
    }
    longest
}

/// Blocks of a replica's latest snapshot.
#[derive(Default)]
pub(crate) struct OwnBlocks {
    snapshot: Option<Arc<StoredSnapshot>>,
    /// Offset of each block in the encoded state.
    offsets: BTreeMap<Block, usize>,
}

impl OwnBlocks {
    /// Cuts the state of a snapshot.
    pub(super) fn of(snapshot: Arc<StoredSnapshot>) -> OwnBlocks {
        let mut offset = 0;
        let mut offsets = BTreeMap::new();
        for block in blocks_of(&snapshot.state) {
            offsets.insert(block, offset);
            offset += block.length();
        }
        OwnBlocks { snapshot: Some(snapshot), offsets }
    }

    /// Checks whether there is no block.
    pub(super) fn is_empty(&self) -> bool {
        self.offsets.is_empty()
    }

    /// Returns the content of a block, if the snapshot contains it.
    pub(super) fn get(&self, block: &Block) -> Option<&[u8]> {
        let offset = *self.offsets.get(block)?;
        self.snapshot.as_ref()?.state.get(offset..offset + block.length())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::types::SnapshotMeta;
    use rand::{Rng as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;
    use std::collections::BTreeSet;

    fn random(seed: u64, length: usize) -> Vec<u8> {
        let mut bytes = vec![0; length];
        ChaCha8Rng::seed_from_u64(seed).fill_bytes(&mut bytes);
        bytes
    }

    #[test]
    fn blocks_cover_the_state_within_their_limits() {
        for length in [0, 1, BLOCK_MIN - 1, BLOCK_MIN, 100_000, 2_000_000] {
            let blocks = blocks_of(&random(3, length));
            assert_eq!(blocks.iter().map(Block::length).sum::<usize>(), length);
            assert!(blocks.iter().all(Block::is_valid), "{length} bytes");
            let all_but_last = &blocks[..blocks.len().saturating_sub(1)];
            assert!(all_but_last.iter().all(|block| block.length() >= BLOCK_MIN), "{length} bytes");
        }
        let count = blocks_of(&random(3, 2_000_000)).len();
        assert!((80..200).contains(&count), "{count} blocks of about 16 KiB in 2 MB");
    }

    #[test]
    fn an_insertion_changes_only_the_blocks_around_it() {
        let state = random(4, 600_000);
        let before: BTreeSet<Block> = blocks_of(&state).into_iter().collect();
        for place in [0, 17, 300_000, 599_999, 600_000] {
            for inserted in [&b"x"[..], &[7; 1000]] {
                let changed = [&state[..place], inserted, &state[place..]].concat();
                let new = blocks_of(&changed).iter().filter(|block| !before.contains(block)).count();
                assert!((1..=4).contains(&new), "{new} new blocks after an insertion at {place}");
            }
        }
    }

    #[test]
    fn equal_bytes_are_cut_into_equal_blocks() {
        let blocks: BTreeSet<Block> = blocks_of(&[7; 10 * BLOCK_MAX]).into_iter().collect();
        assert_eq!(blocks.iter().map(Block::length).collect::<Vec<_>>(), [BLOCK_MAX]);
    }

    #[test]
    fn the_blocks_of_a_state_stay_the_same_in_all_releases() {
        let state: Vec<u8> = (0..100_000).map(|number| (mix(number) >> 56) as u8).collect();
        let blocks = blocks_of(&state);
        assert_eq!(blocks.iter().map(Block::length).collect::<Vec<_>>(), [28_889, 9691, 7969, 28_568, 24_883]);
        assert_eq!(blocks[0].hash, 0x3087_574f_2175_4d53_dac6_fff1_ac70_a766);
    }

    #[test]
    fn own_blocks_are_found_by_length_and_hash() {
        let state = random(5, 300_000);
        let snapshot = StoredSnapshot { meta: SnapshotMeta::default(), state: state.clone() };
        let own = OwnBlocks::of(Arc::new(snapshot));
        let mut rest = &state[..];
        for block in blocks_of(&state) {
            let (bytes, after) = rest.split_at(block.length());
            assert!(own.get(&block) == Some(bytes));
            assert!(own.get(&Block { length: block.length - 1, ..block }).is_none());
            assert!(own.get(&Block { hash: block.hash ^ 1, ..block }).is_none());
            rest = after;
        }
        assert!(OwnBlocks::default().get(&Block::of(b"x")).is_none());
    }
}
