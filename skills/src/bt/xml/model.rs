//! Defaults of sub-trees: `<TreeNodesModel>` can declare the ports of a sub-tree with default
//! bindings, as in BehaviorTree.CPP 4. The rest of the model is for editors.

use crate::bt::manifest::NodeKind;
use crate::bt::spec::NodeSpec;
use roxmltree::Node;
use std::collections::BTreeMap;

/// Default bindings by tree and port.
#[derive(Debug, Default)]
pub(super) struct SubTreeDefaults(BTreeMap<String, BTreeMap<String, String>>);

impl SubTreeDefaults {
    /// Adds the defaults of a `<TreeNodesModel>`.
    pub(super) fn read(&mut self, model: Node<'_, '_>) {
        for tree in model.children().filter(|node| node.has_tag_name("SubTree")) {
            let ports = tree.children().filter_map(|port| Some((port.attribute("name")?, port.attribute("default")?)));
            let ports = ports.map(|(name, default)| (name.to_owned(), default.to_owned()));
            self.0.entry(tree.attribute("ID").unwrap_or_default().to_owned()).or_default().extend(ports);
        }
    }

    /// Binds the ports that uses of sub-trees omit. A sub-tree with `_autoremap` keeps its keys.
    pub(super) fn apply(&self, node: &mut NodeSpec) {
        if node.kind == Some(NodeKind::SubTree)
            && !node.autoremap
            && let Some(defaults) = self.0.get(&node.id)
        {
            for (port, default) in defaults {
                node.ports.entry(port.clone()).or_insert_with(|| default.clone());
            }
        }
        for child in &mut node.children {
            self.apply(child);
        }
    }
}
