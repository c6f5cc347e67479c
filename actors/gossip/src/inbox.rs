//! Decoding and verification of incoming messages.

use super::gossiper::{Event, GossipError};
use super::shared::SharedKnowledge;
use super::swim::packet_sender;
use consort_bus::Author;
use consort_bus::record_signer::{ProofStatus, SharedRecordSigner};
use consort_bus::{Presence, Sample};
use consort_protocol::codec::{self, CodecError};
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::knowledge::MotionUpdate;
use consort_protocol::message::{Exchange, RecordUpdate};
use std::fmt::Display;

/// A message is unusable. It has changed nothing.
#[derive(Debug, thiserror::Error)]
pub(super) enum MessageError {
    /// The bytes cannot be decoded.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// A node publishes the record of another node.
    #[error("record of {owner} on key {key:?}")]
    ForeignRecord { owner: NodeId, key: String },
    /// A node sends a packet in the name of another node.
    #[error("packet of {sender} by {author}")]
    ForeignPacket { sender: NodeId, author: Author },
    /// The key of a record update or of a motion names no node.
    #[error("knowledge on key {0:?}")]
    UnexpectedKey(String),
    /// The key of a presence token names no node.
    #[error("key {0:?} is not a node's presence token")]
    NoNodeToken(String),
    /// The gossiper rejects the message.
    #[error(transparent)]
    Rejected(#[from] GossipError),
}

/// Decoder of incoming messages.
pub(super) struct Inbox {
    pub(super) node: NodeId,
    pub(super) keys: Keys,
    /// Verifier of forwarded records, if the fleet has certificates.
    pub(super) signer: Option<SharedRecordSigner>,
    pub(super) shared: SharedKnowledge,
}

impl Inbox {
    /// Decodes a peer's exchange and removes the records without a valid proof of their owner. A record
    /// that cannot be verified yet is removed, too, whatever version the fleet writes: the peer may have
    /// forged it. The verification requests the missing certificate, and a later round repeats the record.
    pub(super) fn read_exchange(&self, bytes: &[u8]) -> Result<Exchange, MessageError> {
        let mut exchange: Exchange = codec::decode_any_version(bytes)?;
        let Some(signer) = &self.signer else { return Ok(exchange) };
        exchange.records.retain(|record| {
            // An older record changes nothing, so it is not verified.
            let is_stored = self
                .shared
                .read(|base| base.get(&record.owner).is_some_and(|stored| stored.record.stamp >= record.stamp));
            if is_stored {
                return false;
            }
            match signer.verify(record) {
                ProofStatus::Valid => true,
                ProofStatus::Unproven => false,
                ProofStatus::Forged(problem) => {
                    self.count_malformed(&problem);
                    false
                }
            }
        });
        Ok(exchange)
    }

    /// Decodes a published record update.
    pub(super) fn read_update(&self, sample: &Sample) -> Result<Event, MessageError> {
        let update: RecordUpdate = codec::decode_any_version(&sample.payload)?;
        match (self.keys.read(&sample.key), &update) {
            (Some(Key::Knowledge(node)), RecordUpdate::Record(record)) if node != record.owner => {
                Err(MessageError::ForeignRecord { owner: record.owner.clone(), key: sample.key.clone() })
            }
            (Some(Key::Knowledge(node)), _) => Ok(Event::Published(node, update)),
            _ => Err(MessageError::UnexpectedKey(sample.key.clone())),
        }
    }

    /// Decodes the published motion of a robot.
    pub(super) fn read_motion(&self, sample: &Sample) -> Result<Event, MessageError> {
        let update: MotionUpdate = codec::decode(&sample.payload)?;
        match self.keys.read(&sample.key) {
            Some(Key::Motion(node)) => Ok(Event::MotionPublished(node, update)),
            _ => Err(MessageError::UnexpectedKey(sample.key.clone())),
        }
    }

    /// Checks that a packet of failure detection is by its sender.
    pub(super) fn read_packet(&self, sample: Sample) -> Result<Event, MessageError> {
        let sender = packet_sender(&sample.payload).map_err(GossipError::from)?;
        if !sample.author.may_be(sender.as_str()) {
            return Err(MessageError::ForeignPacket { sender, author: sample.author });
        }
        Ok(Event::Packet(sample.payload))
    }

    /// Reads the change of a presence token.
    pub(super) fn read_presence(&self, presence: Presence) -> Result<Event, MessageError> {
        match self.keys.read(&presence.key) {
            Some(Key::AliveNode(node)) => Ok(Event::Token(node, presence.alive)),
            _ => Err(MessageError::NoNodeToken(presence.key)),
        }
    }

    /// Counts and logs an unusable message: as a warning when the count has doubled since the last
    /// warning.
    pub(super) fn count_malformed(&self, problem: &impl Display) {
        let count = {
            let mut known = self.shared.lock();
            known.counters.malformed += 1;
            known.counters.malformed
        };
        let (node, problem) = (&self.node, problem.to_string());
        if count.is_power_of_two() {
            tracing::warn!(%node, count, problem, "dropped a malformed message");
        } else {
            tracing::debug!(%node, count, problem, "dropped a malformed message");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_bus::record_signer::RecordSigner;
    use consort_protocol::ids::FleetId;
    use consort_protocol::knowledge::{Digest, DigestScope, Knowledge, Proof, Record, RecordStamp};
    use consort_protocol::trust::{Fingerprint, SIGNATURE_BYTES};
    use std::sync::Arc;

    /// Certificate of Bob.
    const OF_BOB: Fingerprint = Fingerprint([1; 16]);
    /// A certificate that no node has.
    const INVENTED: Fingerprint = Fingerprint([2; 16]);

    fn proof(by: Fingerprint) -> Proof {
        Proof::new(by, &[0; SIGNATURE_BYTES]).unwrap()
    }

    /// Signer of a node that has received a single certificate, Bob's.
    struct KnowsBob;

    impl RecordSigner for KnowsBob {
        fn sign(&self, _: &Record) -> Proof {
            proof(INVENTED)
        }

        fn verify(&self, record: &Record) -> ProofStatus {
            match &record.proof {
                Some(proof) if proof.by() == OF_BOB => match record.owner.as_str() {
                    "bob" => ProofStatus::Valid,
                    other => ProofStatus::Forged(format!("record of {other} is signed by bob")),
                },
                _ => ProofStatus::Unproven,
            }
        }
    }

    /// Returns a forwarded record.
    fn record(owner: &str, proof: Option<Proof>) -> Record {
        let stamp = RecordStamp { incarnation: 1, version: 1 };
        Record { owner: NodeId::new(owner).unwrap(), stamp, knowledge: Knowledge::of(None), proof }
    }

    /// Returns the records of an exchange, encoded for a wire version, that a node of a closed fleet
    /// which has just started accepts.
    fn accepted(wire: u8, records: Vec<Record>) -> Vec<Record> {
        let inbox = Inbox {
            node: NodeId::new("ada").unwrap(),
            keys: Keys::new(&FleetId::new("ward").unwrap()),
            signer: Some(Arc::new(KnowsBob)),
            shared: SharedKnowledge::default(),
        };
        let exchange = Exchange { sums: vec![], scope: DigestScope::ALL, digest: Digest::new(), records };
        let bytes = codec::encode_for_version(wire, exchange).unwrap();
        inbox.read_exchange(&bytes).unwrap().records
    }

    #[test]
    fn a_node_that_has_just_started_accepts_no_record_with_an_invented_proof() {
        let forged = [None, Some(proof(INVENTED)), Some(proof(OF_BOB))].map(|proof| record("cyd", proof));
        let genuine = record("bob", Some(proof(OF_BOB)));
        let records = forged.into_iter().chain([genuine.clone()]).collect();
        assert_eq!(accepted(2, records), [genuine]);
    }

    #[test]
    fn a_version_without_proofs_admits_no_record() {
        assert!(accepted(1, vec![record("bob", Some(proof(OF_BOB))), record("cyd", None)]).is_empty());
    }
}
