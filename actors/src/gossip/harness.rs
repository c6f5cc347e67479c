//! A node's gossip without a bus, for those who try it with messages of their own.

use super::gossiper::{Action, Event, Gossiper};
use super::settings::Settings;
use super::shared::GossipState;
use bytes::Bytes;
use consort_protocol::codec;
use consort_protocol::ids::{FleetId, NodeId};
use consort_protocol::knowledge::Knowledge;
use consort_protocol::message::{Exchange, RecordUpdate};
use consort_protocol::units::NodeTime;
use consort_protocol::versions::VersionRange;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::time::Duration;

/// How something was said to it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum GossipInput {
    /// A node published what it says of itself.
    Published(NodeId),
    /// A packet of failure detection.
    Packet,
    /// A peer asked, comparing what both know.
    Request,
    /// A peer answered in this round.
    Reply(u64),
}

/// A node's gossip, on time that passes as it is told.
pub struct GossipHarness {
    gossiper: Gossiper,
    known: GossipState,
    now: NodeTime,
}

impl GossipHarness {
    /// A node that has just started.
    pub fn new(fleet: FleetId, node: NodeId) -> GossipHarness {
        let knowledge = Knowledge {
            may_vote: true,
            stationary: false,
            mains_powered: false,
            replica: None,
            cluster: None,
            leaving: false,
            supported_versions: VersionRange::OWN,
            robot: None,
        };
        let (mut known, rng) = (GossipState::default(), ChaCha8Rng::seed_from_u64(1));
        let settings = Settings::new(fleet, node, 1);
        let (gossiper, _) = Gossiper::new(settings, knowledge, None, rng, &mut known, NodeTime::ZERO);
        GossipHarness { gossiper, known, now: NodeTime::ZERO }
    }

    /// Hears something, and gives the messages that it would send upon it.
    ///
    /// # Errors
    /// What is wrong with the message, which has changed nothing.
    pub fn receive(&mut self, said: GossipInput, bytes: &[u8]) -> Result<Vec<Vec<u8>>, String> {
        let exchange = || codec::decode_any_version::<Exchange>(bytes).map_err(|problem| problem.to_string());
        let event = match said {
            GossipInput::Published(owner) => {
                let statement: RecordUpdate =
                    codec::decode_any_version(bytes).map_err(|problem| problem.to_string())?;
                match &statement {
                    RecordUpdate::Record(record) if record.owner != owner => return Err("it is another's".to_owned()),
                    _ => Event::Published(owner, statement),
                }
            }
            GossipInput::Packet => Event::Packet(Bytes::copy_from_slice(bytes)),
            GossipInput::Request => Event::RequestReceived(exchange()?),
            GossipInput::Reply(round) => Event::ReplyReceived(round, Some(exchange()?)),
        };
        self.handle(event)
    }

    /// Time passes; gives the messages that it sends meanwhile.
    ///
    /// # Errors
    /// As the actor logs them.
    pub fn advance(&mut self, time: Duration) -> Result<Vec<Vec<u8>>, String> {
        self.now = self.now + time;
        self.handle(Event::TimerFired)
    }

    /// How many nodes it knows something of.
    pub fn known_nodes(&self) -> usize {
        self.known.base.iter().count()
    }

    fn handle(&mut self, event: Event) -> Result<Vec<Vec<u8>>, String> {
        let actions = self.gossiper.handle(event, &mut self.known, self.now)?;
        let written = |action| match action {
            Action::Publish(statement) => {
                codec::encode_for_version(VersionRange::OWN.newest, statement).map_err(|problem| problem.to_string())
            }
            Action::Send(_, bytes) => Ok(bytes.to_vec()),
            Action::SendRequest(_, _, exchange) | Action::SendReply(exchange) => {
                codec::encode_for_version(VersionRange::OWN.newest, exchange).map_err(|problem| problem.to_string())
            }
        };
        Ok(actions.into_iter().map(|action| written(action).expect("what it says fits a message")).collect())
    }
}
