//! Questions to people, as the file of a tree states them.

use super::ask_person::{ASK_PERSON, ESCALATE_AFTER, ESCALATE_TO, MESSAGE, PATIENCE, ROLE};
use crate::bt::{NodeKind, NodeSpec, TreeSpec, key_of};
use std::collections::BTreeMap;

/// Question to people in a tree. A value that only the running tree determines is its key: `{key}`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StatedQuestion {
    /// Role of the people.
    pub role: String,
    /// The question.
    pub message: String,
    /// Seconds after which it expires; `None` if it does not.
    pub patience_s: Option<String>,
    /// Role to which it is escalated.
    pub escalate_to: Option<String>,
    /// Seconds after which it is escalated.
    pub escalate_after_s: Option<String>,
}

/// Values of keys that are known before the tree runs; `None` for a key that stays empty.
pub(crate) type KnownValues = BTreeMap<String, Option<String>>;

/// Returns the questions of a checked tree, in the order of the file. `values` are those of keys of
/// the main tree.
pub(crate) fn stated_questions(tree: &TreeSpec, values: &KnownValues) -> Vec<StatedQuestion> {
    let mut found = vec![];
    if let Some(root) = tree.trees.get(&tree.main) {
        add(tree, root, values, &mut found);
    }
    found
}

/// Adds the questions below a node. It ends, since the sub-trees of a checked tree form no cycle.
fn add(tree: &TreeSpec, node: &NodeSpec, values: &KnownValues, found: &mut Vec<StatedQuestion>) {
    if node.kind == Some(NodeKind::SubTree) {
        if let Some(root) = tree.trees.get(&node.id) {
            add(tree, root, &values_inside(node, values), found);
        }
        return;
    }
    if node.id == ASK_PERSON {
        let value = |port: &str| {
            let text = node.ports.get(port)?;
            let Some(key) = key_of(port, text) else { return Some(text.clone()) };
            values.get(key).cloned().unwrap_or_else(|| Some(format!("{{{key}}}")))
        };
        found.push(StatedQuestion {
            role: value(ROLE).unwrap_or_default(),
            message: value(MESSAGE).unwrap_or_default(),
            patience_s: value(PATIENCE),
            escalate_to: value(ESCALATE_TO),
            escalate_after_s: value(ESCALATE_AFTER),
        });
    }
    node.children.iter().for_each(|child| add(tree, child, values, found));
}

/// Returns the values of keys inside a sub-tree.
fn values_inside(node: &NodeSpec, values: &KnownValues) -> KnownValues {
    let mut inside = if node.autoremap { values.clone() } else { KnownValues::new() };
    for (port, text) in &node.ports {
        let value = match key_of(port, text) {
            Some(key) => values.get(key).cloned(),
            None => Some(Some(text.clone())),
        };
        match value {
            Some(value) => inside.insert(port.clone(), value),
            None => inside.remove(port),
        };
    }
    inside
}
