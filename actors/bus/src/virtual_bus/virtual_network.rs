//! The network between the nodes of a virtual fleet, with its faults.

use super::driver::Shared;
use super::endpoint::VirtualBus;
use super::faults::Faults;
use super::link::{LinkModel, NetworkCounters, TrafficByKind};
use consort_protocol::ids::NodeId;
use std::sync::Arc;
use std::time::Duration;
use zenoh_keyexpr::OwnedKeyExpr;

/// The network between the nodes of a virtual fleet. Clones share the network.
///
/// Faults may be set at any time and may name nodes that do not exist yet.
#[derive(Clone)]
pub struct VirtualNetwork {
    shared: Arc<Shared>,
}

impl VirtualNetwork {
    /// Creates a network without nodes or faults. All links follow `model`.
    ///
    /// # Panics
    /// If the model is invalid: a share outside 0 to 1, or a minimum latency above the maximum.
    pub fn new(seed: u64, model: LinkModel) -> Self {
        VirtualNetwork { shared: Shared::new(seed, model) }
    }

    /// Returns the endpoint of a node. The node is started if it is not running. After a crash it
    /// starts again without any earlier state.
    pub fn bus(&self, node: NodeId) -> VirtualBus {
        let incarnation = self.shared.with(|network| network.start(node.clone()));
        VirtualBus { shared: Arc::clone(&self.shared), node, incarnation }
    }

    /// Sets the model of all links from now on, including links with a model of their own.
    ///
    /// # Panics
    /// As [`VirtualNetwork::new`].
    pub fn set_link_model(&self, model: LinkModel) {
        self.shared.with(|network| network.set_model(model));
    }

    /// Sets the model of a single direction of a single link from now on.
    ///
    /// # Panics
    /// As [`VirtualNetwork::new`].
    pub fn set_link_model_between(&self, from: NodeId, to: NodeId, model: LinkModel) {
        self.shared.with(|network| network.set_model_between(from, to, model));
    }

    /// Sets the time for which a node that falls silent from now on counts as present.
    pub fn set_lease(&self, lease: Duration) {
        self.shared.with(|network| network.set_lease(lease));
    }

    /// Partitions the network: only nodes of the same group receive each other's messages. Nodes
    /// without a group form a further group. Replaces an earlier partition; other faults stay.
    pub fn partition(&self, groups: impl IntoIterator<Item = impl IntoIterator<Item = NodeId>>) {
        self.shared.with(|network| network.change_faults(|faults| faults.partition(groups)));
    }

    /// Drops all messages from `from` to `to`.
    pub fn cut(&self, from: NodeId, to: NodeId) {
        self.shared.with(|network| network.change_faults(|faults| faults.cut(from, to)));
    }

    /// Ends a [`cut`](Self::cut).
    pub fn restore(&self, from: NodeId, to: NodeId) {
        self.shared.with(|network| network.change_faults(|faults| faults.restore(from, to)));
    }

    /// Blocks this node's outgoing messages; it still receives messages.
    pub fn block_outgoing(&self, node: NodeId) {
        self.shared.with(|network| network.change_faults(|faults| faults.block_outgoing(node)));
    }

    /// Blocks this node's incoming messages; the other nodes still receive its messages.
    pub fn block_incoming(&self, node: NodeId) {
        self.shared.with(|network| network.change_faults(|faults| faults.block_incoming(node)));
    }

    /// Drops all queries to a node on a key expression.
    ///
    /// # Panics
    /// If the key expression is invalid.
    pub fn block_queries(&self, to: NodeId, key_expr: &str) {
        let key_expr = OwnedKeyExpr::new(key_expr).expect("a valid key expression");
        self.shared.with(|network| network.change_faults(|faults| faults.block_queries(to, key_expr)));
    }

    /// Isolates this node in both directions.
    pub fn isolate(&self, node: NodeId) {
        self.shared.with(|network| {
            network.change_faults(|faults| {
                faults.block_outgoing(node.clone());
                faults.block_incoming(node);
            });
        });
    }

    /// Ends every partition, cut, block and isolation. Link models, pauses and crashes stay.
    pub fn heal(&self) {
        self.shared.with(|network| network.change_faults(Faults::heal));
    }

    /// Holds back all messages to or from a node, including its messages to itself, as if its
    /// process were frozen. Its peers miss it after a lease. The timers of its actors continue.
    pub fn pause(&self, node: &NodeId) {
        self.shared.with(|network| network.pause(node));
    }

    /// Delivers the messages that [`pause`](Self::pause) held back, in their order.
    pub fn resume(&self, node: &NodeId) {
        self.shared.with(|network| network.resume(node));
    }

    /// Blocks a node: its operations do not return until [`unblock`](Self::unblock), as calls of a
    /// real bus may when buffers are full. Messages to the node still arrive. Without effect on a node
    /// that has never been started.
    pub fn block(&self, node: &NodeId) {
        self.shared.set_blocked(node, true);
    }

    /// Lets the operations of a [blocked](Self::block) node continue.
    pub fn unblock(&self, node: &NodeId) {
        self.shared.set_blocked(node, false);
    }

    /// Crashes a node: its streams end, its declarations vanish, and its bus rejects every
    /// operation. Messages sent earlier still arrive. Its peers notice after one latency, or after
    /// the lease if they are cut off from it.
    pub fn crash(&self, node: &NodeId) {
        self.shared.with(|network| network.crash(node));
    }

    /// Returns the message counters so far.
    pub fn counters(&self) -> NetworkCounters {
        self.shared.with(|network| network.counters)
    }

    /// Returns the traffic of a node so far, over all its restarts.
    pub fn traffic(&self, node: &NodeId) -> TrafficByKind {
        self.shared.with(|network| network.traffic(node))
    }

    /// Returns a digest of all deliveries so far, each with time, endpoints and content. Equal runs
    /// have equal digests.
    pub fn digest(&self) -> u64 {
        self.shared.with(|network| network.trace.digest())
    }
}
