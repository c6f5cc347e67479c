//! A node's gossip without a bus, for those who try it with messages of their own.

use super::gossiper::{Action, Event, Gossiper};
use super::settings::Settings;
use super::shared::Known;
use bytes::Bytes;
use consort_protocol::codec;
use consort_protocol::ids::{FleetId, NodeId};
use consort_protocol::knowledge::Knowledge;
use consort_protocol::message::{Exchange, Statement};
use consort_protocol::units::NodeTime;
use consort_protocol::versions::Versions;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::time::Duration;

/// How something was said to it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Said {
    /// A node published what it says of itself.
    Published(NodeId),
    /// A packet of failure detection.
    Packet,
    /// A peer asked, comparing what both know.
    Asked,
    /// A peer answered in this round.
    Answered(u64),
}

/// A node's gossip, on time that passes as it is told.
pub struct Listener {
    gossiper: Gossiper,
    known: Known,
    now: NodeTime,
}

impl Listener {
    /// A node that has just started.
    pub fn new(fleet: FleetId, node: NodeId) -> Listener {
        let knowledge = Knowledge {
            may_vote: true,
            stationary: false,
            mains_powered: false,
            replica: None,
            cluster: None,
            leaving: false,
            speaks: Versions::OWN,
            worker: None,
        };
        let (mut known, rng) = (Known::default(), ChaCha8Rng::seed_from_u64(1));
        let settings = Settings::new(fleet, node, 1);
        let (gossiper, _) = Gossiper::new(settings, knowledge, None, rng, &mut known, NodeTime::ZERO);
        Listener { gossiper, known, now: NodeTime::ZERO }
    }

    /// Hears something, and gives the messages that it would send upon it.
    ///
    /// # Errors
    /// What is wrong with the message, which has changed nothing.
    pub fn hear(&mut self, said: Said, bytes: &[u8]) -> Result<Vec<Vec<u8>>, String> {
        let exchange = || codec::decode_any::<Exchange>(bytes).map_err(|problem| problem.to_string());
        let event = match said {
            Said::Published(owner) => {
                let statement: Statement = codec::decode_any(bytes).map_err(|problem| problem.to_string())?;
                match &statement {
                    Statement::Record(record) if record.owner != owner => return Err("it is another's".to_owned()),
                    _ => Event::Published(owner, statement),
                }
            }
            Said::Packet => Event::Packet(Bytes::copy_from_slice(bytes)),
            Said::Asked => Event::Asked(exchange()?),
            Said::Answered(round) => Event::Answered(round, Some(exchange()?)),
        };
        self.handle(event)
    }

    /// Time passes; gives the messages that it sends meanwhile.
    ///
    /// # Errors
    /// As the actor logs them.
    pub fn wait(&mut self, time: Duration) -> Result<Vec<Vec<u8>>, String> {
        self.now = self.now + time;
        self.handle(Event::Woke)
    }

    /// How many nodes it knows something of.
    pub fn knows(&self) -> usize {
        self.known.base.iter().count()
    }

    fn handle(&mut self, event: Event) -> Result<Vec<Vec<u8>>, String> {
        let actions = self.gossiper.handle(event, &mut self.known, self.now)?;
        let written = |action| match action {
            Action::Publish(statement) => {
                codec::encode_for(Versions::OWN.newest, statement).map_err(|problem| problem.to_string())
            }
            Action::Send(_, bytes) => Ok(bytes.to_vec()),
            Action::Ask(_, _, exchange) | Action::Answer(exchange) => {
                codec::encode_for(Versions::OWN.newest, exchange).map_err(|problem| problem.to_string())
            }
        };
        Ok(actions.into_iter().map(|action| written(action).expect("what it says fits a message")).collect())
    }
}
