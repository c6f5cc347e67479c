//! The root actor: supervises the actors of a node, and ends the node if any of them fails.

use consort_protocol::ids::NodeId;
use ractor::{Actor, ActorProcessingErr, ActorRef, SupervisionEvent};
use std::sync::{Arc, OnceLock};
use tracing::error;

/// Supervisor of a node's actors.
pub(super) struct Root {
    /// Cause of the node's end, once the node has ended by itself.
    pub(super) cause: Arc<OnceLock<String>>,
}

pub(super) enum NodeMessage {
    /// The local copy of the ledger has failed, with the error.
    LedgerFailed(String),
    /// The fleet writes a wire version that this program cannot read, with advice.
    UnsupportedWireVersion(String),
}

impl Root {
    fn end(&self, myself: &ActorRef<NodeMessage>, cause: String) {
        for child in myself.get_children() {
            child.kill();
        }
        myself.stop(Some(cause.clone()));
        // The first cause counts.
        let _ = self.cause.set(cause);
    }
}

#[ractor::async_trait]
impl Actor for Root {
    type Msg = NodeMessage;
    type State = NodeId;
    type Arguments = NodeId;

    async fn pre_start(&self, _: ActorRef<NodeMessage>, node: NodeId) -> Result<NodeId, ActorProcessingErr> {
        Ok(node)
    }

    async fn handle(
        &self,
        myself: ActorRef<NodeMessage>,
        message: NodeMessage,
        node: &mut NodeId,
    ) -> Result<(), ActorProcessingErr> {
        match message {
            NodeMessage::LedgerFailed(problem) => {
                error!(%node, %problem, "the local copy of the ledger failed: the node stops");
                self.end(&myself, format!("its copy of the ledger failed: {problem}"));
            }
            NodeMessage::UnsupportedWireVersion(advice) => {
                error!(%node, %advice, "the fleet writes an unsupported wire version: the node stops");
                self.end(&myself, advice);
            }
        }
        Ok(())
    }

    async fn handle_supervisor_evt(
        &self,
        myself: ActorRef<NodeMessage>,
        event: SupervisionEvent,
        node: &mut NodeId,
    ) -> Result<(), ActorProcessingErr> {
        if let SupervisionEvent::ActorFailed(actor, problem) = event {
            error!(%node, actor = %actor.get_id(), %problem, "an actor failed: the node stops");
            self.end(&myself, format!("an actor failed, see the log: {problem}"));
        }
        Ok(())
    }
}
