//! Commit marker: a second, small file next to the ledger. It records the identity of the store and
//! the last write known to be on disk.
//!
//! `redb` falls back to the previous write when the last write is incomplete. After a crash this is
//! right, because the torn write was never acknowledged. But damage to an *acknowledged* write
//! looks exactly the same. The commit marker tells the two apart. It is written after each write
//! (without waiting for the disk, so it costs little), and synced when the node has nothing else to
//! write for a moment, and at shutdown. It never claims more than the ledger file contains.
//!
//! Two slots are written in turn, each within a sector of its own, so that at least one of them is
//! always complete.

use crate::log_store::StoreIdentity;
use redb::StorageBackend;
use std::fmt::{self, Debug};
use std::io;

/// Length of a slot in bytes, padded with spaces: text, so that people can read it.
const SLOT: usize = 128;

/// Distance between the starts of the slots, in bytes: a sector of any disk.
const SLOT_DISTANCE: u64 = 512;

/// Content of a commit marker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct MarkerRecord {
    /// Identity of the store.
    pub(super) identity: StoreIdentity,
    /// Number of the last write known to be complete.
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
        let record = MarkerRecord { identity, commits: commits.parse().ok()? };
        // Encoding the parsed record must give the same bytes, including the checksum.
        (record.to_slot() == slot).then_some(record)
    }
}

/// File of the commit marker.
pub(super) struct CommitMarker {
    file: Box<dyn StorageBackend>,
    record: MarkerRecord,
}

impl Debug for CommitMarker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.record)
    }
}

impl CommitMarker {
    /// Creates a commit marker in an empty file, and syncs it to disk.
    pub(super) fn create(file: Box<dyn StorageBackend>, record: MarkerRecord) -> io::Result<CommitMarker> {
        file.set_len(SLOT_DISTANCE * 2)?;
        let mut marker = CommitMarker { file, record };
        marker.write(record.commits)?;
        marker.sync()?;
        Ok(marker)
    }

    /// Opens a commit marker; `None` if neither slot is complete.
    pub(super) fn open(file: Box<dyn StorageBackend>) -> io::Result<Option<CommitMarker>> {
        let mut newest: Option<MarkerRecord> = None;
        for start in [0, SLOT_DISTANCE] {
            let mut slot = [0; SLOT];
            if file.len()? < start + SLOT as u64 {
                continue;
            }
            file.read(start, &mut slot)?;
            let record = MarkerRecord::from_slot(&slot);
            newest = newest.into_iter().chain(record).max_by_key(|record| record.commits);
        }
        Ok(newest.map(|record| CommitMarker { file, record }))
    }

    pub(super) fn record(&self) -> MarkerRecord {
        self.record
    }

    /// Records that the write numbered `commits` is on disk.
    pub(super) fn write(&mut self, commits: u64) -> io::Result<()> {
        let record = MarkerRecord { commits, ..self.record };
        self.file.write(commits % 2 * SLOT_DISTANCE, &record.to_slot())?;
        self.record = record;
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

    const RECORD: MarkerRecord = MarkerRecord { identity: StoreIdentity(7), commits: 41 };

    #[test]
    fn a_slot_reads_back_and_any_changed_byte_is_detected() {
        let slot = RECORD.to_slot();
        assert_eq!(MarkerRecord::from_slot(&slot), Some(RECORD));
        for place in 0..SLOT {
            let mut damaged = slot;
            damaged[place] ^= 4;
            assert_eq!(MarkerRecord::from_slot(&damaged), None, "byte {place}");
        }
    }

    #[test]
    fn the_newer_slot_counts_and_the_older_slot_replaces_it() {
        let mut marker = CommitMarker::create(Box::new(InMemoryBackend::new()), RECORD).unwrap();
        marker.write(42).unwrap();
        marker.write(43).unwrap();
        let mut marker = CommitMarker::open(marker.file).unwrap().unwrap();
        assert_eq!(marker.record().commits, 43);
        marker.file.write(SLOT_DISTANCE + 3, b"?").unwrap();
        marker = CommitMarker::open(marker.file).unwrap().unwrap();
        assert_eq!(marker.record().commits, 42);
        marker.file.write(3, b"?").unwrap();
        assert!(CommitMarker::open(marker.file).unwrap().is_none());
    }
}
