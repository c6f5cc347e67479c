//! Tree of a flat iHTN: parents, children and types of the nodes.

use super::form::{FlatNode, NO_PARENT, NodeType, diagnostic};
use crate::mission::diagnostic::{IhtnError, MissionDiagnostic, MissionErrorKind};
use std::collections::{BTreeMap, BTreeSet};

/// Checks that the nodes form a tree of alternating types. Returns its root.
///
/// # Errors
/// All problems of the tree, in the order of the nodes.
pub(super) fn find_root(nodes: &BTreeMap<String, FlatNode>) -> Result<&str, Vec<MissionDiagnostic>> {
    let mut check = TreeCheck { nodes, problems: Vec::new() };
    let root = check.find_tree();
    match check.problems.is_empty() {
        true => Ok(root.expect("a valid tree has a root")),
        false => Err(check.problems),
    }
}

struct TreeCheck<'a> {
    nodes: &'a BTreeMap<String, FlatNode>,
    problems: Vec<MissionDiagnostic>,
}

impl<'a> TreeCheck<'a> {
    fn report(&mut self, id: &str, kind: impl Into<MissionErrorKind>) {
        self.problems.push(diagnostic(self.nodes, id, kind));
    }

    fn report_for_file(&mut self, kind: IhtnError) {
        self.problems.push(MissionDiagnostic { path: "file".to_owned(), kind: kind.into() });
    }

    fn find_tree(&mut self) -> Option<&'a str> {
        let nodes = self.nodes;
        let roots: Vec<&str> =
            nodes.iter().filter(|(_, node)| node.parent == NO_PARENT).map(|(id, _)| id.as_str()).collect();
        match roots[..] {
            [] => self.report_for_file(IhtnError::NoRoot),
            [root] if nodes[root].node_type != NodeType::Task => {
                self.report(root, IhtnError::RootNotTask { found: nodes[root].node_type.as_str() });
            }
            [_] => {}
            _ => self.report_for_file(IhtnError::SeveralRoots { nodes: roots.join(", ") }),
        }
        for (id, node) in nodes {
            self.check_parent(id, node);
            self.check_children(id, node);
        }
        self.find_cycles();
        roots.first().copied()
    }

    fn check_parent(&mut self, id: &str, node: &FlatNode) {
        if node.parent == NO_PARENT {
            return;
        }
        let Some(parent) = self.nodes.get(&node.parent) else {
            return self.report(id, IhtnError::NoSuchParent { parent: node.parent.clone() });
        };
        if !parent.children.0.iter().any(|child| child == id) {
            self.report(id, IhtnError::NotAmongChildren { parent: node.parent.clone() });
        }
        for agent in node.agents.0.iter().filter(|agent| !parent.agents.0.contains(agent)) {
            self.report(id, IhtnError::AgentNotInParent { agent: agent.clone() });
        }
    }

    fn check_children(&mut self, id: &str, node: &FlatNode) {
        let takes = match node.node_type {
            NodeType::Task => "1 method",
            NodeType::Method => "tasks and actions",
            NodeType::Action => "no children",
        };
        let mut seen = BTreeSet::new();
        for name in &node.children.0 {
            let Some(child) = self.nodes.get(name) else {
                self.report(id, IhtnError::NoSuchChild { child: name.clone() });
                continue;
            };
            if !seen.insert(name) {
                self.report(id, IhtnError::ChildTwice { child: name.clone() });
            } else if child.parent != id {
                self.report(id, IhtnError::WrongParent { child: name.clone(), parent: child.parent.clone() });
            }
            let fits = match node.node_type {
                NodeType::Task => child.node_type == NodeType::Method,
                NodeType::Method => child.node_type != NodeType::Method,
                NodeType::Action => false,
            };
            if !fits {
                let (parent, found) = (node.node_type.as_str(), child.node_type.as_str());
                self.report(id, IhtnError::WrongType { parent, child: name.clone(), found, takes });
            }
        }
        match node.node_type {
            NodeType::Task if node.children.0.len() != 1 => {
                self.report(id, IhtnError::NotOneMethod { found: node.children.0.len() });
            }
            NodeType::Method if node.children.0.is_empty() => self.report(id, MissionErrorKind::EmptyMethod),
            NodeType::Task | NodeType::Method | NodeType::Action => {}
        }
    }

    /// Follows the parents of each node: in a tree every path ends at the root, otherwise a path
    /// reaches its start again.
    fn find_cycles(&mut self) {
        let mut rooted: BTreeSet<&str> = BTreeSet::new();
        let nodes = self.nodes;
        for start in nodes.keys() {
            let mut trail: Vec<&str> = Vec::new();
            let mut at = start.as_str();
            while let Some(node) = nodes.get(at) {
                if rooted.contains(at) {
                    break;
                }
                if let Some(first) = trail.iter().position(|id| *id == at) {
                    let mut cycle = trail[first..].to_vec();
                    cycle.push(at);
                    cycle.reverse();
                    self.report(at, IhtnError::Cycle { cycle: cycle.join(" > ") });
                    break;
                }
                trail.push(at);
                at = &node.parent;
            }
            rooted.extend(trail);
        }
    }
}
