//! Decoding and verification of incoming messages.

use super::gossiper::{Event, GossipError};
use super::shared::SharedKnowledge;
use super::swim::packet_sender;
use consort_bus::Author;
use consort_bus::record_signer::{ProofStatus, SharedRecordSigner};
use consort_bus::wire_version::WireVersion;
use consort_bus::{Presence, Sample};
use consort_protocol::codec::{self, CodecError, VersionedMessage};
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
    pub(super) wire_version: WireVersion,
    /// Verifier of forwarded records, if the fleet has certificates.
    pub(super) signer: Option<SharedRecordSigner>,
    pub(super) shared: SharedKnowledge,
}

impl Inbox {
    /// Checks whether forwarded records carry proofs. While the fleet writes a version without
    /// proofs, proofs cannot be required.
    pub(super) fn with_proofs(&self) -> bool {
        self.wire_version.get() >= Exchange::SINCE
    }

    /// Decodes a peer's exchange and removes the records without a valid proof of their owner.
    pub(super) fn read_exchange(&self, bytes: &[u8]) -> Result<Exchange, MessageError> {
        let mut exchange: Exchange = codec::decode_any_version(bytes)?;
        let Some(signer) = &self.signer else { return Ok(exchange) };
        let with_proofs = self.with_proofs();
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
                ProofStatus::Unproven => !with_proofs,
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
