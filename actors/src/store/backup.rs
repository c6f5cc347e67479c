//! A copy of the mission ledger that a fleet gives out while it works, and that a new fleet can be founded on.

use super::DurableStore;
use crate::replica::{Epoch, Journal as _, sole_voter_with};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use consort_protocol::codec;
use consort_protocol::ids::{ClusterId, FleetId, NodeId};
use consort_protocol::ledger::Ledger;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::io;

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
    /// The CRC-32 of the ledger's bytes (IEEE 802.3).
    pub crc32: u32,
    /// The ledger, in base64: a version byte, then bincode.
    pub ledger: String,
}

impl Backup {
    /// A copy of this ledger, whose last entry is `last`.
    ///
    /// # Errors
    /// In words, if it cannot be written down.
    pub fn of(ledger: &Ledger, last: Epoch, fleet: FleetId, by: NodeId, at_ms: u64) -> Result<Backup, String> {
        let bytes = codec::encode_record(ledger).map_err(|problem| problem.to_string())?;
        Ok(Backup {
            fleet,
            by,
            at_ms,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            term: last.term,
            index: last.index,
            missions: ledger.missions().count(),
            under_way: ledger.live().len(),
            crc32: crc32fast::hash(&bytes),
            ledger: STANDARD.encode(bytes),
        })
    }

    /// The ledger, and the place of its last entry.
    ///
    /// # Errors
    /// In words, if it is damaged or of another release.
    pub fn open(&self) -> Result<(Ledger, Epoch), String> {
        let bytes = STANDARD.decode(&self.ledger).map_err(|problem| format!("ledger: it is damaged: {problem}"))?;
        if crc32fast::hash(&bytes) != self.crc32 {
            return Err("ledger: it is damaged: its bytes are not those that crc32 was made of".to_owned());
        }
        let ledger = codec::decode_record(&bytes).map_err(|problem| format!("ledger: {problem}"))?;
        Ok((ledger, Epoch { term: self.term, index: self.index }))
    }
}

/// Makes an empty store that of its fleet's only voter, with this ledger, as that of `cluster`, an id that no other founding has;
/// blocks until it is on disk. Whoever still holds the former ledger is a stranger to it.
///
/// # Errors
/// The store holds something already, or cannot be written.
pub fn restore(store: &DurableStore, mut ledger: Ledger, last: Epoch, cluster: ClusterId) -> io::Result<()> {
    let there = store.recorded()?;
    if there.snapshot.is_some() || !there.entries.is_empty() || there.vote.is_some() {
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, "it holds a ledger already"));
    }
    ledger.refound(cluster);
    store.replace(sole_voter_with(&ledger, last, &store.owner().node, store.identity())?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_copy_reads_back_and_damage_is_noticed() {
        let last = Epoch { term: 3, index: 9 };
        let (fleet, by) = (FleetId::new("ward").unwrap(), NodeId::new("ada").unwrap());
        let backup = Backup::of(&Ledger::default(), last, fleet, by, 7).unwrap();
        let text = serde_json::to_string(&backup).unwrap();
        let read: Backup = serde_json::from_str(&text).unwrap();
        assert_eq!(read.open(), Ok((Ledger::default(), last)));
        let mut bytes = STANDARD.decode(&read.ledger).unwrap();
        for at in 0..bytes.len() {
            bytes[at] ^= 1;
            let damaged = Backup { ledger: STANDARD.encode(&bytes), ..read.clone() };
            assert!(damaged.open().unwrap_err().contains("it is damaged"), "at {at}");
            bytes[at] ^= 1;
        }
        assert!(Backup { ledger: "?".to_owned(), ..read }.open().unwrap_err().contains("it is damaged"));
    }
}
