//! Records of a log store, and the values that log and state machine share.

use super::snapshot_id::is_intact;
use crate::types::{LogId, SnapshotMeta};
use consort_protocol::codec;
use serde::{Deserialize, Serialize};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Locks a mutex. No code of the storage panics while it holds a lock.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

pub(crate) fn decode_record<T: serde::de::DeserializeOwned>(bytes: &[u8]) -> std::io::Result<T> {
    codec::decode_record(bytes).map_err(|error| std::io::Error::new(std::io::ErrorKind::InvalidData, error.to_string()))
}

pub(crate) fn encode_record<T: Serialize>(value: &T) -> std::io::Result<Vec<u8>> {
    codec::encode_record(value).map_err(|error| std::io::Error::new(std::io::ErrorKind::InvalidData, error.to_string()))
}

/// Snapshot as stored in the log store.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct StoredSnapshot {
    pub(crate) meta: SnapshotMeta,
    #[serde(with = "raw_bytes")]
    pub(crate) state: Vec<u8>,
}

/// Bytes as a whole, in the layout of a list of numbers. serde writes and reads such a list number by number.
mod raw_bytes {
    use serde::de::{Error, Visitor};
    use serde::{Deserializer, Serializer};
    use std::fmt;

    pub(super) fn serialize<S: Serializer>(bytes: &[u8], serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_bytes(bytes)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<u8>, D::Error> {
        deserializer.deserialize_byte_buf(BytesVisitor)
    }

    struct BytesVisitor;

    impl Visitor<'_> for BytesVisitor {
        type Value = Vec<u8>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("bytes")
        }

        fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<Vec<u8>, E> {
            Ok(bytes.to_vec())
        }

        fn visit_byte_buf<E: Error>(self, bytes: Vec<u8>) -> Result<Vec<u8>, E> {
            Ok(bytes)
        }
    }
}

impl StoredSnapshot {
    /// Decodes a stored snapshot, and checks its state against the checksum in its id.
    pub(crate) fn decode(bytes: &[u8]) -> Result<StoredSnapshot, SnapshotError> {
        let stored: StoredSnapshot = decode_record(bytes).map_err(SnapshotError::Undecodable)?;
        match is_intact(&stored.meta.snapshot_id, &stored.state) {
            true => Ok(stored),
            false => Err(SnapshotError::Damaged(stored.meta.snapshot_id)),
        }
    }
}

/// A stored snapshot cannot be read.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SnapshotError {
    /// It has another layout.
    #[error("{0}")]
    Undecodable(std::io::Error),
    /// Its state does not have the checksum in its id.
    #[error("the snapshot {0} is damaged: its checksum differs")]
    Damaged(String),
}

impl From<SnapshotError> for std::io::Error {
    fn from(error: SnapshotError) -> std::io::Error {
        std::io::Error::new(std::io::ErrorKind::InvalidData, error.to_string())
    }
}

/// Error: a received snapshot was not stored, with the cause.
#[derive(Debug, Clone, thiserror::Error)]
#[error("{0}")]
pub(super) struct SnapshotNotStored(pub(super) String);

/// Last entry covered by the stored snapshot, or the reason why a received snapshot was not stored.
pub(super) type Covered = Result<Option<LogId>, SnapshotNotStored>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_snapshot_has_the_layout_of_its_fields() {
        let meta = SnapshotMeta { snapshot_id: "T1-N2-3".to_owned(), ..SnapshotMeta::default() };
        for size in [0, 1, 250, 251, 70_000] {
            let state = vec![7; size];
            let record = encode_record(&StoredSnapshot { meta: meta.clone(), state: state.clone() }).unwrap();
            assert!(record == encode_record(&(&meta, &state)).unwrap(), "{size} bytes");
            let read: StoredSnapshot = decode_record(&record).unwrap();
            assert!((read.meta, read.state) == (meta.clone(), state), "{size} bytes");
            let incomplete = StoredSnapshot::decode(&record[..record.len() - 1]);
            assert!(matches!(incomplete, Err(SnapshotError::Undecodable(_))), "{size} bytes");
        }
    }
}
