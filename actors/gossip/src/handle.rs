//! Handle of a running gossip actor.

use super::actor::{Gossip, GossipStart, Message};
use super::shared::SharedKnowledge;
use consort_protocol::knowledge::{Knowledge, Motion};
use ractor::concurrency::JoinHandle;
use ractor::{Actor, ActorCell, ActorRef, SpawnErr};

/// Gossip has stopped. Nothing was changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("gossip has stopped")]
pub struct GossipStopped;

/// Handle of a node's gossip.
#[derive(Clone)]
pub struct GossipHandle {
    actor: ActorRef<Message>,
    shared: SharedKnowledge,
}

impl GossipHandle {
    /// Starts gossip, linked to a supervisor if given. The supervisor is notified of a failure, for
    /// example when the bus closes.
    ///
    /// # Errors
    /// If the bus rejects a declaration.
    pub async fn start(
        start: GossipStart,
        supervisor: Option<ActorCell>,
    ) -> Result<(GossipHandle, JoinHandle<()>), Box<SpawnErr>> {
        let shared = start.shared.clone();
        let (actor, end) = match supervisor {
            Some(supervisor) => Actor::spawn_linked(None, Gossip, start, supervisor).await?,
            None => Actor::spawn(None, Gossip, start).await?,
        };
        Ok((GossipHandle { actor, shared }, end))
    }

    /// Replaces the node's knowledge. It is published at once, unless it is unchanged.
    ///
    /// # Errors
    /// [`GossipStopped`].
    pub fn update(&self, knowledge: Knowledge) -> Result<(), GossipStopped> {
        self.update_with(move |own| *own = knowledge)
    }

    /// Changes a part of the node's knowledge. A record larger than 3 KiB is rejected and logged.
    ///
    /// # Errors
    /// [`GossipStopped`].
    pub fn update_with(&self, change: impl FnOnce(&mut Knowledge) + Send + 'static) -> Result<(), GossipStopped> {
        self.actor.cast(Message::ChangeKnowledge(Box::new(change))).map_err(|_| GossipStopped)
    }

    /// Publishes the motion of the node's robot to the nodes that receive motion, without a change of the record.
    ///
    /// # Errors
    /// [`GossipStopped`].
    pub fn move_robot(&self, motion: Motion) -> Result<(), GossipStopped> {
        self.actor.cast(Message::MoveRobot(motion)).map_err(|_| GossipStopped)
    }

    /// Sets whether the node receives the motion of robots and the heartbeats of a large fleet.
    ///
    /// # Errors
    /// [`GossipStopped`].
    pub fn receive_motion(&self, receives: bool) -> Result<(), GossipStopped> {
        self.actor.cast(Message::ReceiveMotion(receives)).map_err(|_| GossipStopped)
    }

    /// Returns the knowledge received from all nodes.
    pub fn shared(&self) -> &SharedKnowledge {
        &self.shared
    }

    /// Returns the actor, to link, stop or kill it. A stopped actor announces that the node leaves;
    /// a killed actor does not.
    pub fn cell(&self) -> ActorCell {
        self.actor.get_cell()
    }
}
