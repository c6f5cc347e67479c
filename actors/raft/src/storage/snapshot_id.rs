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

/// Returns the id of a snapshot of `state` up to the entry `last`, built on `store`.
pub(crate) fn snapshot_id(last: &str, store: StoreIdentity, state: &[u8]) -> String {
    format!("{last}@{:032x}-crc{:08x}", store.0, crc32fast::hash(state))
}

/// Checks the state of a snapshot against its id.
pub(crate) fn is_intact(id: &str, state: &[u8]) -> bool {
    checksum(id).is_none_or(|expected| expected == crc32fast::hash(state))
}

/// Checks whether an id contains a checksum.
pub(crate) fn has_checksum(id: &str) -> bool {
    checksum(id).is_some()
}

fn checksum(id: &str) -> Option<u32> {
    let (_, checksum) = id.rsplit_once("-crc")?;
    u32::from_str_radix(checksum, 16).ok()
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
}
