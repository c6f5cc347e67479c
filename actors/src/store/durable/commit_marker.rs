//! A second, small file beside the ledger: which store it belongs to, and up to which write it is known to be on disk.
//!
//! `redb` falls back on the write before when the last one is not whole: after a crash that is right, for what was torn
//! was never acknowledged. But damage to a write that *was* acknowledged looks just the same. The seal tells them apart.
//! It is written after each write (without waiting for the disk, so it is no burden), and brought to disk when the node
//! has nothing else to write for a moment, and at its end. It never claims more than the ledger's file holds.
//!
//! Two slots are written in turn, each within a sector of its own, so that one of them is always whole.

use crate::raft::StoreIdentity;
use redb::StorageBackend;
use std::fmt::{self, Debug};
use std::io;

/// A slot's length in bytes, padded with spaces: text, so that people can look at it.
const SLOT: usize = 128;

/// From one slot to the next: a sector of any disk.
const SLOT_DISTANCE: u64 = 512;

/// What the seal says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct MarkerRecord {
    /// The store that it belongs to.
    pub(super) identity: StoreIdentity,
    /// The last write that is known to have come to an end.
    pub(super) commits: u64,
}

impl fmt::Display for MarkerRecord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "consort ledger seal, store {:032x}, write {:020}", self.identity.0, self.commits)
    }
}

impl MarkerRecord {
    fn to_slot(self) -> [u8; SLOT] {
        let text = self.to_string();
        let line = format!("{text}, crc {:08x}", crc32fast::hash(text.as_bytes()));
        let mut slot = [b' '; SLOT];
        slot[..line.len()].copy_from_slice(line.as_bytes());
        slot[SLOT - 1] = b'\n';
        slot
    }

    fn from_slot(slot: &[u8]) -> Option<MarkerRecord> {
        let text = std::str::from_utf8(slot).ok()?;
        let rest = text.strip_prefix("consort ledger seal, store ")?;
        let (identity, rest) = rest.split_once(", write ")?;
        let (commits, _) = rest.split_once(", crc ")?;
        let identity = StoreIdentity(u128::from_str_radix(identity, 16).ok()?);
        let claim = MarkerRecord { identity, commits: commits.parse().ok()? };
        // The text is fixed by what it says, the sum of it included.
        (claim.to_slot() == slot).then_some(claim)
    }
}

/// The seal's file.
pub(super) struct CommitMarker {
    file: Box<dyn StorageBackend>,
    claim: MarkerRecord,
}

impl Debug for CommitMarker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.claim)
    }
}

impl CommitMarker {
    /// Makes one in an empty file, and brings it to disk.
    pub(super) fn create(file: Box<dyn StorageBackend>, claim: MarkerRecord) -> io::Result<CommitMarker> {
        file.set_len(SLOT_DISTANCE * 2)?;
        let mut seal = CommitMarker { file, claim };
        seal.write(claim.commits)?;
        seal.sync()?;
        Ok(seal)
    }

    /// Reads one; `None` if neither slot is whole.
    pub(super) fn open(file: Box<dyn StorageBackend>) -> io::Result<Option<CommitMarker>> {
        let mut newest: Option<MarkerRecord> = None;
        for start in [0, SLOT_DISTANCE] {
            let mut slot = [0; SLOT];
            if file.len()? < start + SLOT as u64 {
                continue;
            }
            file.read(start, &mut slot)?;
            let claim = MarkerRecord::from_slot(&slot);
            newest = newest.into_iter().chain(claim).max_by_key(|claim| claim.commits);
        }
        Ok(newest.map(|claim| CommitMarker { file, claim }))
    }

    pub(super) fn record(&self) -> MarkerRecord {
        self.claim
    }

    /// Says that the write numbered `commits` is on disk.
    pub(super) fn write(&mut self, commits: u64) -> io::Result<()> {
        let claim = MarkerRecord { commits, ..self.claim };
        self.file.write(commits % 2 * SLOT_DISTANCE, &claim.to_slot())?;
        self.claim = claim;
        Ok(())
    }

    pub(super) fn sync(&self) -> io::Result<()> {
        self.file.sync_data()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use redb::backends::InMemoryBackend;

    const CLAIM: MarkerRecord = MarkerRecord { identity: StoreIdentity(7), commits: 41 };

    #[test]
    fn a_slot_is_read_back_and_no_byte_of_it_may_differ() {
        let slot = CLAIM.to_slot();
        assert_eq!(MarkerRecord::from_slot(&slot), Some(CLAIM));
        for place in 0..SLOT {
            let mut damaged = slot;
            damaged[place] ^= 4;
            assert_eq!(MarkerRecord::from_slot(&damaged), None, "byte {place}");
        }
    }

    #[test]
    fn the_newer_slot_counts_and_the_older_one_stands_in_for_it() {
        let mut seal = CommitMarker::create(Box::new(InMemoryBackend::new()), CLAIM).unwrap();
        seal.write(42).unwrap();
        seal.write(43).unwrap();
        let mut seal = CommitMarker::open(seal.file).unwrap().unwrap();
        assert_eq!(seal.record().commits, 43);
        seal.file.write(SLOT_DISTANCE + 3, b"?").unwrap();
        seal = CommitMarker::open(seal.file).unwrap().unwrap();
        assert_eq!(seal.record().commits, 42);
        seal.file.write(3, b"?").unwrap();
        assert!(CommitMarker::open(seal.file).unwrap().is_none());
    }
}
