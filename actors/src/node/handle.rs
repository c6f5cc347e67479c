//! A node that runs, and the ways in which it ends.

use super::assembly::{Assembled, assemble};
use super::root::{NodeMessage, Root};
use super::settings::NodeSettings;
use crate::allegiance::Allegiance;
use crate::autopilot::{Farewell, LeaveError, Leaver};
use crate::bus::{BusError, SharedBus};
use crate::gossip::SharedKnowledge;
use crate::replica::{Replica, StartError};
use crate::tasks::Tasks;
use consort_protocol::ids::NodeId;
use consort_protocol::ledger::Ledger;
use ractor::{Actor, ActorRef, SpawnErr};
use std::sync::{Arc, OnceLock};
use tokio::sync::watch;
use tokio::task::JoinHandle;

/// Why a node did not start. Nothing of it runs.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    /// The bus is closed, or a key was refused.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The copy of the ledger could not be taken up.
    #[error(transparent)]
    Ledger(#[from] StartError),
    /// An actor could not start.
    #[error("an actor could not start: {0}")]
    Actor(String),
}

impl From<SpawnErr> for NodeError {
    fn from(problem: SpawnErr) -> NodeError {
        NodeError::Actor(problem.to_string())
    }
}

/// A node that runs. Dropping it leaves it running; see [`kill`](NodeHandle::kill), [`stop`](NodeHandle::stop) and
/// [`leave`](NodeHandle::leave).
pub struct NodeHandle {
    /// Its name.
    pub node: NodeId,
    root: ActorRef<NodeMessage>,
    ended: JoinHandle<()>,
    cause: Arc<OnceLock<String>>,
    /// Its copy of the ledger, if it keeps one.
    pub replica: Option<Replica<Ledger>>,
    /// What it has heard.
    pub knowledge: SharedKnowledge,
    /// Which cluster it belongs to.
    pub allegiance: Allegiance,
    /// How it leaves.
    pub leaver: Leaver,
    left: watch::Receiver<Option<Farewell>>,
    tasks: Tasks,
}

impl NodeHandle {
    /// Starts everything that the settings name.
    ///
    /// # Errors
    /// [`NodeError`]; nothing of the node runs then.
    pub async fn start(settings: NodeSettings, bus: SharedBus) -> Result<NodeHandle, NodeError> {
        let cause = Arc::<OnceLock<String>>::default();
        let (root, ended) = Actor::spawn(None, Root { cause: Arc::clone(&cause) }, settings.node.clone()).await?;
        match assemble(settings, bus, &root).await {
            Ok(Assembled { leaver, left, allegiance, tasks }) => Ok(NodeHandle {
                node: leaver.node.clone(),
                root,
                ended,
                cause,
                replica: leaver.replica.clone(),
                knowledge: leaver.knowledge.clone(),
                allegiance,
                leaver,
                left,
                tasks,
            }),
            Err(problem) => {
                root.kill();
                Err(problem)
            }
        }
    }

    /// Ends the node as a crash would: nothing is said to anybody.
    pub async fn kill(mut self) {
        self.tasks = Tasks::default();
        self.leaver.replica = None;
        for child in self.root.get_children() {
            child.kill();
        }
        self.root.kill();
        // It ends in one way or the other; how is of no interest.
        let _ = self.ended.await;
    }

    /// Ends the node for a while: if it coordinates it hands over first, and others are told that it leaves. Its vote, and
    /// its robot's role, wait in its store.
    pub async fn stop(self) {
        self.leaver.step_down().await;
        self.end().await;
    }

    /// Ends the node for good: its robot gives its role back, and its vote is taken over by another or removed.
    ///
    /// # Errors
    /// [`LeaveError`], and the node, which runs on.
    pub async fn leave(self) -> Result<Farewell, (LeaveError, Box<NodeHandle>)> {
        match self.leaver.for_good().await {
            Ok(farewell) => {
                self.end().await;
                Ok(farewell)
            }
            Err(problem) => Err((problem, Box::new(self))),
        }
    }

    /// Waits until the node has left for good because somebody asked it to on `api/leave/{node}`, and is to be
    /// [ended](Self::end); or until it has ended by itself, and says why as [`ended`](Self::ended) does.
    ///
    /// # Errors
    /// Why it ended by itself.
    pub async fn ended_or_left(&mut self) -> Result<Farewell, String> {
        let mut left = self.left.clone();
        tokio::select! {
            cause = self.ended() => Err(cause),
            Ok(farewell) = left.wait_for(Option::is_some) => Ok(farewell.clone().expect("it was waited for")),
        }
    }

    /// Ends the node without handing anything over; others are told that it leaves.
    pub async fn end(mut self) {
        self.tasks = Tasks::default();
        self.leaver.replica = None;
        for child in self.root.get_children() {
            child.stop(None);
        }
        if let Some(replica) = self.replica.take() {
            replica.shutdown().await;
        }
        self.root.stop(None);
        // See above.
        let _ = self.ended.await;
    }

    /// Whether the node has ended by itself: an actor of it failed.
    pub fn has_ended(&self) -> bool {
        self.ended.is_finished()
    }

    /// Waits until the node has ended by itself, and says why: an actor of it failed, or its copy of the ledger did.
    pub async fn ended(&mut self) -> String {
        // See above.
        let _ = (&mut self.ended).await;
        self.cause.get().cloned().unwrap_or_else(|| "nobody said why".to_owned())
    }
}
