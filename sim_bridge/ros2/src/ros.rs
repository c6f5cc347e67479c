//! Our place on a ROS 2 graph over Zenoh.

use hiroz::Builder;
use hiroz::context::{ZContext, ZContextBuilder};
use hiroz::node::ZNode;
use hiroz::qos::{QosDurability, QosHistory, QosProfile, QosReliability};

/// Why something could not be done on the ROS 2 graph. Nothing was declared there.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("ROS 2 over Zenoh: cannot {what}: {problem}")]
pub struct RosError {
    /// What was attempted.
    pub what: String,
    /// What Zenoh or hiroz said.
    pub problem: String,
}

impl RosError {
    pub(crate) fn of(what: impl Into<String>, problem: impl std::fmt::Display) -> RosError {
        RosError { what: what.into(), problem: problem.to_string() }
    }
}

/// Where a ROS 2 graph is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RosSettings {
    /// The routers of `rmw_zenoh` to connect to, as `tcp/localhost:7447`: its own default. They are tried again until they can
    /// be reached.
    pub routers: Vec<String>,
    /// `ROS_DOMAIN_ID`: graphs with different numbers do not see one another. Default 0.
    pub domain: usize,
    /// The name of our node.
    pub node: String,
}

impl Default for RosSettings {
    fn default() -> Self {
        RosSettings { routers: vec!["tcp/localhost:7447".to_owned()], domain: 0, node: "consort".to_owned() }
    }
}

/// A session on a ROS 2 graph, with one node. What is declared on the node vanishes from the graph with it.
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
    /// Joins a graph, as a node of `rmw_zenoh` does: as a Zenoh peer that listens on loopback and finds the others through
    /// the router. Called within a multi-threaded tokio runtime.
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
        // Parameters are half a dozen services that nobody needs here.
        let node = context.create_node(&settings.node).without_parameters().build().map_err(failed)?;
        Ok(Ros { node, context })
    }

    /// Leaves the graph: everybody there is told at once.
    ///
    /// # Errors
    /// [`RosError`] if Zenoh says so; the session is of no further use in either case.
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

/// `rmw_qos_profile_default`, which actions have for feedback.
pub(crate) fn feedback() -> QosProfile {
    reliable(QosDurability::Volatile, 10)
}

/// `rcl_action_qos_profile_status_default`: who comes late is told the latest.
pub(crate) fn status() -> QosProfile {
    reliable(QosDurability::TransientLocal, 1)
}
