//! Backup of the mission ledger: taken from a running fleet, restored as the start of a new
//! cluster.

use super::durable::DurableStore;
use crate::log_store::LogStore as _;
use crate::offline_recovery::restore_as_only_voter;
use crate::types::Epoch;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use consort_protocol::codec::{self, CodecError};
use consort_protocol::ids::{ClusterId, FleetId, NodeId};
use consort_protocol::ledger::Ledger;
use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::io::{self, Read as _, Write as _};

/// Backup of a ledger: readable key figures, and the whole ledger.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Backup {
    /// Fleet.
    #[schemars(with = "String")]
    pub fleet: FleetId,
    /// Node that made the backup.
    #[schemars(with = "String")]
    pub by: NodeId,
    /// Time of the backup, in milliseconds since 1970, by that node's clock.
    pub at_ms: u64,
    /// Version of the program.
    pub version: String,
    /// Term of the last entry in the backup.
    pub term: u64,
    /// Index of that entry.
    pub index: u64,
    /// Number of missions in the ledger.
    pub missions: usize,
    /// Number of missions that had not ended.
    pub under_way: usize,
    /// Ledger: a version byte, then bincode; compressed by gzip, which has a checksum, and encoded
    /// in base64.
    pub ledger: String,
}

/// The backup cannot be made or read.
#[derive(Debug, thiserror::Error)]
pub enum BackupError {
    /// A bug.
    #[error("{0}")]
    Unencodable(CodecError),
    /// Out of memory.
    #[error("{0}")]
    Uncompressible(io::Error),
    /// The text was changed.
    #[error("ledger: it is damaged: {0}")]
    NotBase64(base64::DecodeError),
    /// The checksum does not match.
    #[error("ledger: it is damaged: {0}")]
    Damaged(io::Error),
    /// Written by another release.
    #[error("ledger: {0}")]
    Undecodable(CodecError),
}

impl Backup {
    /// Creates a backup of this ledger up to the entry `last`.
    ///
    /// # Errors
    /// [`BackupError`] if the ledger cannot be encoded.
    pub fn new(ledger: &Ledger, last: Epoch, fleet: FleetId, by: NodeId, at_ms: u64) -> Result<Backup, BackupError> {
        let bytes = codec::encode_record(ledger).map_err(BackupError::Unencodable)?;
        Ok(Backup {
            fleet,
            by,
            at_ms,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            term: last.term,
            index: last.index,
            missions: ledger.missions().count(),
            under_way: ledger.active_missions().len(),
            ledger: STANDARD.encode(compress(&bytes).map_err(BackupError::Uncompressible)?),
        })
    }

    /// Returns the ledger and the position of its last entry.
    ///
    /// # Errors
    /// [`BackupError`] if the backup is damaged, or was made by another release.
    pub fn decode(&self) -> Result<(Ledger, Epoch), BackupError> {
        let bytes = STANDARD.decode(&self.ledger).map_err(BackupError::NotBase64)?;
        let bytes = decompress(&bytes).map_err(BackupError::Damaged)?;
        let ledger = codec::decode_record(&bytes).map_err(BackupError::Undecodable)?;
        Ok((ledger, Epoch { term: self.term, index: self.index }))
    }
}

fn compress(bytes: &[u8]) -> io::Result<Vec<u8>> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes)?;
    encoder.finish()
}

/// Decompresses `bytes`, up to just above the size limit of a record.
fn decompress(bytes: &[u8]) -> io::Result<Vec<u8>> {
    let size_max = u64::try_from(codec::RECORD_BYTES_MAX).unwrap_or(u64::MAX);
    let mut output = Vec::new();
    GzDecoder::new(bytes).take(size_max + 1).read_to_end(&mut output)?;
    Ok(output)
}

/// Turns an empty store into that of its fleet's only voter with this ledger, as the ledger of
/// `cluster`, an id that no other bootstrap has used. Blocks until it is on disk. Nodes with the
/// former ledger belong to a different cluster.
///
/// # Errors
/// The store is not empty, or cannot be written.
pub fn restore(store: &DurableStore, mut ledger: Ledger, last: Epoch, cluster: ClusterId) -> io::Result<()> {
    let existing = store.persistent_state()?;
    if existing.snapshot.is_some() || !existing.entries.is_empty() || existing.vote.is_some() {
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, "the store contains a ledger already"));
    }
    ledger.replace_cluster(cluster);
    store.replace(restore_as_only_voter(&ledger, last, &store.owner().node, store.identity())?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_backup_reads_back_and_damage_is_detected() {
        let last = Epoch { term: 3, index: 9 };
        let (fleet, by) = (FleetId::new("ward").unwrap(), NodeId::new("ada").unwrap());
        let backup = Backup::new(&Ledger::default(), last, fleet, by, 7).unwrap();
        let text = serde_json::to_string(&backup).unwrap();
        let read: Backup = serde_json::from_str(&text).unwrap();
        assert_eq!(read.decode().unwrap(), (Ledger::default(), last));
        let mut bytes = STANDARD.decode(&read.ledger).unwrap();
        // The header of gzip is not checked: it contains the time and system of the compression.
        for at in 10..bytes.len() {
            bytes[at] ^= 1;
            let damaged = Backup { ledger: STANDARD.encode(&bytes), ..read.clone() };
            assert!(damaged.decode().unwrap_err().to_string().contains("it is damaged"), "at {at}");
            bytes[at] ^= 1;
        }
        assert!(Backup { ledger: "?".to_owned(), ..read }.decode().unwrap_err().to_string().contains("it is damaged"));
    }
}
