//! Handle of a running node, and the ways to end it.

use super::assembly::{StartedParts, start_parts};
use super::error::{NodeEnded, NodeError};
use super::root::{NodeMessage, Root};
use super::settings::NodeSettings;
use crate::autopilot::{Decommission, DecommissionReport};
use consort_bus::SharedBus;
use consort_bus::cluster_membership::ClusterMembership;
use consort_bus::tasks::Tasks;
use consort_gossip::SharedKnowledge;
use consort_protocol::ids::NodeId;
use consort_protocol::ledger::Ledger;
use consort_raft::Replica;
use ractor::{Actor, ActorRef};
use std::sync::{Arc, OnceLock};
use tokio::sync::watch;
use tokio::task::JoinHandle;

/// Handle of a running node. Dropping it leaves the node running; see [`kill`](NodeHandle::kill),
/// [`stop`](NodeHandle::stop) and [`Decommission`].
pub struct NodeHandle {
    /// Id of the node.
    pub node: NodeId,
    root: ActorRef<NodeMessage>,
    ended: JoinHandle<()>,
    cause: Arc<OnceLock<String>>,
    /// Its copy of the ledger, if it keeps a copy.
    pub replica: Option<Replica<Ledger>>,
    /// Records received from other nodes.
    pub knowledge: SharedKnowledge,
    /// Cluster membership of the node.
    pub membership: ClusterMembership,
    /// Decommission procedure of the node.
    pub decommission_handle: Decommission,
    decommissioned: watch::Receiver<Option<DecommissionReport>>,
    tasks: Tasks,
}

impl NodeHandle {
    /// Starts everything that the settings contain.
    ///
    /// # Errors
    /// [`NodeError`]; no part of the node runs then.
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

    /// Ends the node as a crash would: no message is sent.
    pub async fn kill(mut self) {
        self.tasks = Tasks::default();
        self.decommission_handle.replica = None;
        for child in self.root.get_children() {
            child.kill();
        }
        self.root.kill();
        // The result is irrelevant: the actor has ended.
        let _ = self.ended.await;
    }

    /// Ends the node for a while: a leader first transfers its leadership, and gossip announces the
    /// departure. The node's vote and the robot's role stay in the store.
    pub async fn stop(self) {
        self.decommission_handle.step_down().await;
        self.shut_down().await;
    }

    /// Waits until the node was decommissioned by a request on `api/leave/{node}`; the caller then
    /// ends it with [`shut_down`](Self::shut_down). Also returns when the node has ended by itself,
    /// like [`ended`](Self::ended).
    ///
    /// # Errors
    /// [`NodeEnded`], if the node has ended by itself.
    pub async fn ended_or_decommissioned(&mut self) -> Result<DecommissionReport, NodeEnded> {
        let mut decommissioned = self.decommissioned.clone();
        tokio::select! {
            cause = self.ended() => Err(NodeEnded(cause)),
            Ok(report) = decommissioned.wait_for(Option::is_some) => Ok(report.clone().expect("the report is present")),
        }
    }

    /// Ends the node without a transfer of leadership. Gossip announces the departure.
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

    /// Checks whether the node has ended by itself, because an actor failed.
    pub fn has_ended(&self) -> bool {
        self.ended.is_finished()
    }

    /// Returns the cause, if the node has ended by itself.
    pub fn end_cause(&self) -> Option<&str> {
        self.has_ended().then(|| self.cause.get().map_or("unknown cause", String::as_str))
    }

    /// Waits until the node has ended by itself and returns the cause: an actor failed, or the copy
    /// of the ledger did.
    pub async fn ended(&mut self) -> String {
        // See above.
        let _ = (&mut self.ended).await;
        self.cause.get().cloned().unwrap_or_else(|| "unknown cause".to_owned())
    }
}
