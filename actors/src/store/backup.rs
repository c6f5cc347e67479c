//! A copy of the mission ledger that a fleet gives out while it works, and that a new fleet can be founded on.

use super::DurableStore;
use crate::raft::{Epoch, LogStore as _, restore_as_only_voter};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use consort_protocol::codec;
use consort_protocol::ids::{ClusterId, FleetId, NodeId};
use consort_protocol::ledger::Ledger;
use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::io::{self, Read as _, Write as _};

/// A copy of a ledger: what can be read of it, and the whole.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Backup {
    /// Of which fleet.
    #[schemars(with = "String")]
    pub fleet: FleetId,
    /// The node that gave it.
    #[schemars(with = "String")]
    pub by: NodeId,
    /// When, in milliseconds since 1970, by that node's clock.
    pub at_ms: u64,
    /// Which version of the program it was.
    pub version: String,
    /// The term of the last entry that is in it.
    pub term: u64,
    /// The index of that entry.
    pub index: u64,
    /// How many missions are in it.
    pub missions: usize,
    /// How many of them had not ended.
    pub under_way: usize,
    /// The ledger: a version byte, then bincode; packed by gzip, which has a checksum, and written in base64.
    pub ledger: String,
}

impl Backup {
    /// A copy of this ledger, whose last entry is `last`.
    ///
    /// # Errors
    /// In words, if it cannot be written down.
    pub fn new(ledger: &Ledger, last: Epoch, fleet: FleetId, by: NodeId, at_ms: u64) -> Result<Backup, String> {
        let bytes = codec::encode_record(ledger).map_err(|problem| problem.to_string())?;
        Ok(Backup {
            fleet,
            by,
            at_ms,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            term: last.term,
            index: last.index,
            missions: ledger.missions().count(),
            under_way: ledger.active_missions().len(),
            ledger: STANDARD.encode(packed(&bytes).map_err(|problem| problem.to_string())?),
        })
    }

    /// The ledger, and the place of its last entry.
    ///
    /// # Errors
    /// In words, if it is damaged or of another release.
    pub fn decode(&self) -> Result<(Ledger, Epoch), String> {
        let bytes = STANDARD.decode(&self.ledger).map_err(|problem| format!("ledger: it is damaged: {problem}"))?;
        let bytes = unpacked(&bytes).map_err(|problem| format!("ledger: it is damaged: {problem}"))?;
        let ledger = codec::decode_record(&bytes).map_err(|problem| format!("ledger: {problem}"))?;
        Ok((ledger, Epoch { term: self.term, index: self.index }))
    }
}

fn packed(bytes: &[u8]) -> io::Result<Vec<u8>> {
    let mut packed = GzEncoder::new(Vec::new(), Compression::default());
    packed.write_all(bytes)?;
    packed.finish()
}

/// What was packed, if it is not more than a record may be.
fn unpacked(bytes: &[u8]) -> io::Result<Vec<u8>> {
    let most = u64::try_from(codec::RECORD_BYTES_MAX).unwrap_or(u64::MAX);
    let mut unpacked = Vec::new();
    GzDecoder::new(bytes).take(most + 1).read_to_end(&mut unpacked)?;
    Ok(unpacked)
}

/// Makes an empty store that of its fleet's only voter, with this ledger, as that of `cluster`, an id that no other founding has;
/// blocks until it is on disk. Whoever still holds the former ledger is a stranger to it.
///
/// # Errors
/// The store holds something already, or cannot be written.
pub fn restore(store: &DurableStore, mut ledger: Ledger, last: Epoch, cluster: ClusterId) -> io::Result<()> {
    let there = store.persistent_state()?;
    if there.snapshot.is_some() || !there.entries.is_empty() || there.vote.is_some() {
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, "it holds a ledger already"));
    }
    ledger.replace_cluster(cluster);
    store.replace(restore_as_only_voter(&ledger, last, &store.owner().node, store.identity())?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_copy_reads_back_and_damage_is_noticed() {
        let last = Epoch { term: 3, index: 9 };
        let (fleet, by) = (FleetId::new("ward").unwrap(), NodeId::new("ada").unwrap());
        let backup = Backup::new(&Ledger::default(), last, fleet, by, 7).unwrap();
        let text = serde_json::to_string(&backup).unwrap();
        let read: Backup = serde_json::from_str(&text).unwrap();
        assert_eq!(read.decode(), Ok((Ledger::default(), last)));
        let mut bytes = STANDARD.decode(&read.ledger).unwrap();
        // The head of gzip says what nobody needs: when it was packed, and where.
        for at in 10..bytes.len() {
            bytes[at] ^= 1;
            let damaged = Backup { ledger: STANDARD.encode(&bytes), ..read.clone() };
            assert!(damaged.decode().unwrap_err().contains("it is damaged"), "at {at}");
            bytes[at] ^= 1;
        }
        assert!(Backup { ledger: "?".to_owned(), ..read }.decode().unwrap_err().contains("it is damaged"));
    }
}
