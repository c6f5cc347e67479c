//! A node's gossip without a bus, for fuzzing it with arbitrary messages.

use super::gossiper::{Action, Event, GossipError, Gossiper, GossiperStart};
use super::settings::Settings;
use super::shared::GossipState;
use bytes::Bytes;
use consort_protocol::codec::{self, CodecError};
use consort_protocol::ids::{FleetId, NodeId};
use consort_protocol::knowledge::Knowledge;
use consort_protocol::message::{Exchange, RecordUpdate};
use consort_protocol::units::NodeTime;
use consort_protocol::versions::VersionRange;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::time::Duration;

/// Source of an input message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum GossipInput {
    /// A publication by a node of its own record.
    Published(NodeId),
    /// A publication by a node of the motion of its robot.
    Motion(NodeId),
    /// A packet of failure detection.
    Packet,
    /// A peer's request to compare digests.
    Request,
    /// A peer's reply in this round.
    Reply(u64),
}

/// The input is rejected. It has changed nothing.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub struct InputError(Rejection);

#[derive(Debug, thiserror::Error)]
enum Rejection {
    /// The bytes cannot be decoded.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// A node publishes the record of another node.
    #[error("the record belongs to another node")]
    ForeignRecord,
    /// The gossiper rejects the input.
    #[error(transparent)]
    Gossip(#[from] GossipError),
}

impl<E: Into<Rejection>> From<E> for InputError {
    fn from(rejection: E) -> InputError {
        InputError(rejection.into())
    }
}

/// A node's gossip with a manually advanced clock.
pub struct GossipHarness {
    gossiper: Gossiper,
    state: GossipState,
    now: NodeTime,
}

impl GossipHarness {
    /// Creates the gossip of a node that has just started.
    pub fn new(fleet: FleetId, node: NodeId) -> GossipHarness {
        let knowledge = Knowledge::of(None);
        let (mut state, rng) = (GossipState::default(), ChaCha8Rng::seed_from_u64(1));
        let settings = Settings::new(fleet, node, 1);
        let start = GossiperStart { settings, knowledge, signer: None, rng };
        let (gossiper, _) = Gossiper::new(start, &mut state, NodeTime::ZERO);
        GossipHarness { gossiper, state, now: NodeTime::ZERO }
    }

    /// Processes an input and returns the messages that the node would send.
    ///
    /// # Errors
    /// The reason why the message is invalid. It has changed nothing.
    pub fn receive(&mut self, input: GossipInput, bytes: &[u8]) -> Result<Vec<Vec<u8>>, InputError> {
        let exchange = || codec::decode_any_version::<Exchange>(bytes);
        let event = match input {
            GossipInput::Published(owner) => {
                let statement: RecordUpdate = codec::decode_any_version(bytes)?;
                match &statement {
                    RecordUpdate::Record(record) if record.owner != owner => {
                        return Err(Rejection::ForeignRecord.into());
                    }
                    _ => Event::Published(owner, statement),
                }
            }
            GossipInput::Motion(owner) => Event::MotionPublished(owner, codec::decode(bytes)?),
            GossipInput::Packet => Event::Packet(Bytes::copy_from_slice(bytes)),
            GossipInput::Request => Event::RequestReceived(exchange()?),
            GossipInput::Reply(round) => Event::ReplyReceived(round, Some(exchange()?)),
        };
        self.handle(event)
    }

    /// Advances the time and returns the messages sent meanwhile.
    ///
    /// # Errors
    /// The error that the actor would log.
    pub fn advance(&mut self, time: Duration) -> Result<Vec<Vec<u8>>, InputError> {
        self.now = self.now + time;
        self.handle(Event::TimerFired)
    }

    /// Returns the number of nodes with a stored record.
    pub fn known_nodes(&self) -> usize {
        self.state.base.iter().count()
    }

    fn handle(&mut self, event: Event) -> Result<Vec<Vec<u8>>, InputError> {
        let actions = self.gossiper.handle(event, &mut self.state, self.now)?;
        let encoded = |action| match action {
            Action::Publish(statement) => codec::encode_for_version(VersionRange::OWN.newest, statement),
            Action::PublishMotion(update) => codec::encode(&update),
            Action::Send(_, bytes) => Ok(bytes.to_vec()),
            Action::SendRequest(_, _, exchange) | Action::SendReply(exchange) => {
                codec::encode_for_version(VersionRange::OWN.newest, exchange)
            }
        };
        Ok(actions.into_iter().map(|action| encoded(action).expect("own messages fit the size limit")).collect())
    }
}
