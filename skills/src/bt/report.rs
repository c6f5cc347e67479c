//! Report on the nodes of a description, for trees of other programs.

use super::builtin::Builtin;
use super::manifest::NodeKind;
use super::registry::Registry;
use super::spec::{NodeSpec, TreeSpec};
use consort_text::AllowedNames;

/// A node of a description, with the origin of its implementation.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NodeReport {
    /// The tree that contains the node.
    pub tree: String,
    /// Line in the file, from 1; `None` if the description was not read from a file.
    pub line: Option<u32>,
    /// The node type, or the name of the tree for a sub-tree.
    pub id: String,
    /// The display name of this use of the node.
    pub name: Option<String>,
    /// Kind of the node; `None` for an unknown node in compact XML, which does not contain it.
    pub kind: Option<NodeKind>,
    /// Origin of the implementation.
    pub origin: NodeOrigin,
}

/// Origin of the implementation of a node.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NodeOrigin {
    /// The node is built into the engine.
    BuiltIn,
    /// The node is registered.
    Registered,
    /// The node is a use of another tree of the description.
    Tree,
    /// There is no such node or tree.
    Unknown {
        /// The most similar name of a node, or of a tree for a sub-tree; `None` if no name is
        /// similar.
        nearest: Option<String>,
    },
}

/// Reports every node of a description: trees in the order of their names, each node before its
/// children. Unlike [`Registry::check`], it accepts unknown nodes and does not examine ports,
/// scripts and the number of children.
pub fn report_nodes<C>(spec: &TreeSpec, registry: &Registry<C>) -> Vec<NodeReport> {
    let mut reports = Vec::new();
    for (tree, root) in &spec.trees {
        add(root, tree, spec, registry, &mut reports);
    }
    reports
}

fn add<C>(node: &NodeSpec, tree: &str, spec: &TreeSpec, registry: &Registry<C>, reports: &mut Vec<NodeReport>) {
    let (kind, origin) = classify(node, spec, registry);
    let (id, name) = (node.id.clone(), node.name.clone());
    reports.push(NodeReport { tree: tree.to_owned(), line: node.line, id, name, kind, origin });
    for child in &node.children {
        add(child, tree, spec, registry, reports);
    }
}

fn classify<C>(node: &NodeSpec, spec: &TreeSpec, registry: &Registry<C>) -> (Option<NodeKind>, NodeOrigin) {
    let unknown =
        |names: Vec<&str>| NodeOrigin::Unknown { nearest: AllowedNames::suggest_for(&node.id, names).nearest };
    if node.kind == Some(NodeKind::SubTree) {
        let is_known = spec.trees.contains_key(&node.id);
        let origin = if is_known { NodeOrigin::Tree } else { unknown(spec.trees.keys().map(String::as_str).collect()) };
        return (node.kind, origin);
    }
    if let Some(builtin) = Builtin::by_id(&node.id) {
        return (Some(builtin.kind()), NodeOrigin::BuiltIn);
    }
    match registry.leaf(&node.id) {
        Some(leaf) => (Some(leaf.manifest.kind), NodeOrigin::Registered),
        None => (node.kind, unknown(registry.node_ids().collect())),
    }
}
