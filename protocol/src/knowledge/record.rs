//! Record of a node: its owner, its position in the owner's history, and its signature.

use super::content::Knowledge;
use crate::codec;
use crate::ids::{FleetId, NodeId};
use crate::trust::{Fingerprint, SIGNATURE_BYTES};
use serde::{Deserialize, Serialize};

/// Record of a node about itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Node that wrote the record.
    pub owner: NodeId,
    /// Incarnation and version of the record.
    pub stamp: RecordStamp,
    /// Content of the record.
    pub knowledge: Knowledge,
    /// Signature of the owner, for nodes that receive the record from others; if the fleet has
    /// certificates.
    pub proof: Option<Proof>,
}

impl Record {
    /// Returns the bytes that the owner signs: the purpose of the signature, the fleet, and the
    /// record except its proof.
    pub fn signed_part(&self, fleet: &FleetId) -> Vec<u8> {
        let bytes = codec::encode_record(&(fleet, &self.owner, self.stamp, &self.knowledge));
        let bytes = bytes.expect("a record that fits a message fits storage");
        [b"consort record\0", &bytes[..]].concat()
    }
}

/// Signature of a record by its owner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Proof {
    by: Fingerprint,
    signature: [[u8; SIGNATURE_BYTES / 2]; 2],
}

impl Proof {
    /// Creates a proof from a signature by the principal with this certificate; `None` if the
    /// signature has the wrong length.
    pub fn new(by: Fingerprint, signature: &[u8]) -> Option<Proof> {
        let (first, second) = signature.split_first_chunk()?;
        Some(Proof { by, signature: [*first, second.try_into().ok()?] })
    }

    /// Returns the certificate of the claimed author.
    pub fn by(&self) -> Fingerprint {
        self.by
    }

    /// Returns the bytes of the signature.
    pub fn signature(&self) -> Vec<u8> {
        self.signature.concat()
    }
}

/// Position of a record in the history of its owner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
pub struct RecordStamp {
    /// Grows with each start of the owner.
    pub incarnation: u64,
    /// Grows with each change of the record.
    pub version: u64,
}
