//! A node that runs, and the ways in which it ends.

use super::assembly::{StartedParts, start_parts};
use super::root::{NodeMessage, Root};
use super::settings::NodeSettings;
use crate::autopilot::{Decommission, DecommissionError, DecommissionReport};
use crate::bus::{BusError, SharedBus};
use crate::cluster_membership::ClusterMembership;
use crate::gossip::SharedKnowledge;
use crate::raft::{Replica, StartError};
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
    pub membership: ClusterMembership,
    /// How it leaves.
    pub decommission_handle: Decommission,
    decommissioned: watch::Receiver<Option<DecommissionReport>>,
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
        match start_parts(settings, bus, &root).await {
            Ok(StartedParts { decommission_handle, decommissioned, membership, tasks }) => Ok(NodeHandle {
                node: decommission_handle.node.clone(),
                root,
                ended,
                cause,
                replica: decommission_handle.replica.clone(),
                knowledge: decommission_handle.knowledge.clone(),
                membership,
                decommission_handle,
                decommissioned,
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
        self.decommission_handle.replica = None;
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
        self.decommission_handle.step_down().await;
        self.shut_down().await;
    }

    /// Ends the node for good: its robot gives its role back, and its vote is taken over by another or removed.
    ///
    /// # Errors
    /// [`LeaveError`], and the node, which runs on.
    pub async fn decommission(self) -> Result<DecommissionReport, (DecommissionError, Box<NodeHandle>)> {
        match self.decommission_handle.run().await {
            Ok(farewell) => {
                self.shut_down().await;
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
    pub async fn ended_or_decommissioned(&mut self) -> Result<DecommissionReport, String> {
        let mut left = self.decommissioned.clone();
        tokio::select! {
            cause = self.ended() => Err(cause),
            Ok(farewell) = left.wait_for(Option::is_some) => Ok(farewell.clone().expect("it was waited for")),
        }
    }

    /// Ends the node without handing anything over; others are told that it leaves.
    pub async fn shut_down(mut self) {
        self.tasks = Tasks::default();
        self.decommission_handle.replica = None;
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
