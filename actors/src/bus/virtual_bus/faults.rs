//! Which links carry nothing at present, and why.

use std::collections::{BTreeMap, BTreeSet};

use consort_protocol::ids::NodeId;

/// Faults in force. Nodes are named and need not exist yet.
#[derive(Debug, Default)]
pub(super) struct Faults {
    /// Group of each node while the network is partitioned. Nodes without one share a further group.
    groups: BTreeMap<NodeId, usize>,
    /// Links cut in one direction, from and to.
    cuts: BTreeSet<(NodeId, NodeId)>,
    /// Nodes that nobody hears.
    muted: BTreeSet<NodeId>,
    /// Nodes that hear nobody.
    deafened: BTreeSet<NodeId>,
}

impl Faults {
    /// Whether what `from` says never reaches `to`.
    pub(super) fn blocks(&self, from: &NodeId, to: &NodeId) -> bool {
        from != to
            && (self.muted.contains(from)
                || self.deafened.contains(to)
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
        self.muted.insert(node);
    }

    pub(super) fn block_incoming(&mut self, node: NodeId) {
        self.deafened.insert(node);
    }

    pub(super) fn heal(&mut self) {
        *self = Faults::default();
    }
}
