//! Watches over a node's actors: if one of them fails, the node ends.

use consort_protocol::ids::NodeId;
use ractor::{Actor, ActorProcessingErr, ActorRef, SupervisionEvent};
use std::sync::{Arc, OnceLock};
use tracing::error;

/// The supervisor of a node's actors.
pub(super) struct Root {
    /// Why the node ended by itself, once it has.
    pub(super) cause: Arc<OnceLock<String>>,
}

pub(super) enum NodeMessage {
    /// The copy of the ledger can no longer be kept, and why.
    LedgerFailed(String),
    /// The fleet writes what this program does not read, and what to do.
    UnsupportedWireVersion(String),
}

impl Root {
    fn end(&self, myself: &ActorRef<NodeMessage>, cause: String) {
        for child in myself.get_children() {
            child.kill();
        }
        myself.stop(Some(cause.clone()));
        // The first cause is the one that counts.
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
                error!(%node, %problem, "the copy of the ledger can no longer be kept: the node stops");
                self.end(&myself, format!("its copy of the ledger can no longer be kept: {problem}"));
            }
            NodeMessage::UnsupportedWireVersion(advice) => {
                error!(%node, %advice, "the fleet has gone on without this program: the node stops");
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
        if let SupervisionEvent::ActorFailed(who, problem) = event {
            error!(%node, actor = %who.get_id(), %problem, "an actor failed: the node stops");
            self.end(&myself, format!("an actor of it failed, as the log says: {problem}"));
        }
        Ok(())
    }
}
