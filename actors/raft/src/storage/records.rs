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
    pub(crate) state: Vec<u8>,
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
