//! A session on a ROS 2 graph over Zenoh.

use hiroz::Builder;
use hiroz::context::{ZContext, ZContextBuilder};
use hiroz::node::ZNode;
use hiroz::qos::{QosDurability, QosHistory, QosProfile, QosReliability};

/// An operation on the ROS 2 graph failed. Nothing was declared there.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("ROS 2 over Zenoh: cannot {operation}: {problem}")]
pub struct RosError {
    /// The attempted operation.
    pub operation: String,
    /// The error of Zenoh or hiroz.
    pub problem: String,
}

impl RosError {
    pub(crate) fn of(operation: impl Into<String>, problem: impl std::fmt::Display) -> RosError {
        RosError { operation: operation.into(), problem: problem.to_string() }
    }
}

/// Settings of a ROS 2 graph.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RosSettings {
    /// Routers of `rmw_zenoh` to connect to; the default is its own default `tcp/localhost:7447`.
    /// Connections are retried until they succeed.
    pub routers: Vec<String>,
    /// `ROS_DOMAIN_ID`: graphs with different numbers are separate. Default 0.
    pub domain: usize,
    /// Name of the own node.
    pub node: String,
}

impl Default for RosSettings {
    fn default() -> Self {
        RosSettings { routers: vec!["tcp/localhost:7447".to_owned()], domain: 0, node: "consort".to_owned() }
    }
}

/// A session on a ROS 2 graph, with a single node. Declarations of the node are removed from the
/// graph with it.
pub struct Ros {
    /// The node.
    pub node: ZNode,
    context: ZContext,
}

impl std::fmt::Debug for Ros {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Ros").field("context", &self.context).finish_non_exhaustive()
    }
}

impl Ros {
    /// Joins a graph like a node of `rmw_zenoh`: as a Zenoh peer that listens on loopback and finds
    /// the others through the router. Must be called within a multi-threaded tokio runtime.
    ///
    /// # Errors
    /// [`RosError`] if the session cannot be opened.
    pub fn join(settings: &RosSettings) -> Result<Ros, RosError> {
        let failed = |problem| RosError::of("join the graph", problem);
        let context = ZContextBuilder::default()
            .with_domain_id(settings.domain)
            .with_connect_endpoints(settings.routers.iter().cloned())
            .with_listen_endpoints(["tcp/127.0.0.1:0"])
            .build()
            .map_err(failed)?;
        // Parameters would add six services without use here.
        let node = context.create_node(&settings.node).without_parameters().build().map_err(failed)?;
        Ok(Ros { node, context })
    }

    /// Leaves the graph; the other nodes are notified at once.
    ///
    /// # Errors
    /// [`RosError`] of Zenoh; the session is unusable in either case.
    pub fn leave(&self) -> Result<(), RosError> {
        self.context.shutdown().map_err(|problem| RosError::of("leave the graph", problem))
    }
}

fn reliable(durability: QosDurability, depth: usize) -> QosProfile {
    let (reliability, history) = (QosReliability::Reliable, QosHistory::from_depth(depth));
    QosProfile { reliability, durability, history, ..QosProfile::default() }
}

/// `rmw_qos_profile_services_default`.
pub(crate) fn services() -> QosProfile {
    reliable(QosDurability::Volatile, 10)
}

/// `rmw_qos_profile_default`, used by actions for feedback.
pub(crate) fn feedback() -> QosProfile {
    reliable(QosDurability::Volatile, 10)
}

/// `rcl_action_qos_profile_status_default`: a late subscriber receives the latest message.
pub(crate) fn status() -> QosProfile {
    reliable(QosDurability::TransientLocal, 1)
}
