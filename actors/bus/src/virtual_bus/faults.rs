//! Faults in force: the links that carry no messages at present, and the reasons.

use std::collections::{BTreeMap, BTreeSet};

use consort_protocol::ids::NodeId;
use zenoh_keyexpr::OwnedKeyExpr;

/// Faults in force. Nodes are identified by name and need not exist yet.
#[derive(Debug, Default)]
pub(super) struct Faults {
    /// Group of each node while the network is partitioned. Nodes without a group form a further
    /// group.
    groups: BTreeMap<NodeId, usize>,
    /// Links cut in a single direction: the sender and the receiver of the lost messages.
    cuts: BTreeSet<(NodeId, NodeId)>,
    /// Nodes with blocked outgoing messages.
    outgoing_blocked: BTreeSet<NodeId>,
    /// Nodes with blocked incoming messages.
    incoming_blocked: BTreeSet<NodeId>,
    /// Queries that a node does not receive.
    queries_blocked: Vec<(NodeId, OwnedKeyExpr)>,
}

impl Faults {
    /// Checks whether messages from `from` never reach `to`.
    pub(super) fn blocks(&self, from: &NodeId, to: &NodeId) -> bool {
        from != to
            && (self.outgoing_blocked.contains(from)
                || self.incoming_blocked.contains(to)
                || self.groups.get(from) != self.groups.get(to)
                || (!self.cuts.is_empty() && self.cuts.contains(&(from.clone(), to.clone()))))
    }

    pub(super) fn partition(&mut self, groups: impl IntoIterator<Item = impl IntoIterator<Item = NodeId>>) {
        self.groups = groups
            .into_iter()
            .enumerate()
            .flat_map(|(number, group)| group.into_iter().map(move |node| (node, number)))
            .collect();
    }

    pub(super) fn cut(&mut self, from: NodeId, to: NodeId) {
        self.cuts.insert((from, to));
    }

    pub(super) fn restore(&mut self, from: NodeId, to: NodeId) {
        self.cuts.remove(&(from, to));
    }

    pub(super) fn block_outgoing(&mut self, node: NodeId) {
        self.outgoing_blocked.insert(node);
    }

    pub(super) fn block_incoming(&mut self, node: NodeId) {
        self.incoming_blocked.insert(node);
    }

    pub(super) fn block_queries(&mut self, to: NodeId, key_expr: OwnedKeyExpr) {
        self.queries_blocked.push((to, key_expr));
    }

    /// Checks whether a node does not receive queries on a key.
    pub(super) fn blocks_query(&self, to: &NodeId, key: &OwnedKeyExpr) -> bool {
        self.queries_blocked.iter().any(|(node, blocked)| node == to && blocked.intersects(key))
    }

    pub(super) fn heal(&mut self) {
        *self = Faults::default();
    }
}
