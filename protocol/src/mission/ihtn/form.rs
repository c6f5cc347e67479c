//! Nodes of a flat iHTN as parsed.

use crate::mission::diagnostic::{MissionDiagnostic, MissionErrorKind};
use crate::mission::file::unique_keys;
use serde::Deserialize;
use std::collections::BTreeMap;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum NodeType {
    Task,
    Method,
    Action,
}

impl NodeType {
    pub(super) fn as_str(self) -> &'static str {
        match self {
            NodeType::Task => "task",
            NodeType::Method => "method",
            NodeType::Action => "action",
        }
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::mission) struct FlatNode {
    pub(super) name: String,
    #[serde(rename = "type")]
    pub(super) node_type: NodeType,
    pub(super) parent: String,
    #[serde(default)]
    pub(super) agents: ListOrEmpty,
    #[serde(default)]
    pub(super) locations: ListOrEmpty,
    #[serde(default)]
    pub(super) children: ListOrEmpty,
}

/// List, or a text that is `""` for an empty list and otherwise the only entry.
#[derive(Debug, Default, Deserialize)]
#[serde(from = "ListForm")]
pub(super) struct ListOrEmpty(pub(super) Vec<String>);

#[derive(Deserialize)]
#[serde(untagged, expecting = "a list of texts, or a text")]
enum ListForm {
    Text(String),
    List(Vec<String>),
}

impl From<ListForm> for ListOrEmpty {
    fn from(form: ListForm) -> Self {
        match form {
            ListForm::Text(text) if text.is_empty() => Self(vec![]),
            ListForm::Text(text) => Self(vec![text]),
            ListForm::List(list) => Self(list),
        }
    }
}

#[derive(Deserialize)]
#[serde(transparent)]
pub(super) struct FlatFile(#[serde(deserialize_with = "unique_keys")] pub(super) BTreeMap<String, FlatNode>);

/// Parent of the root.
pub(super) const NO_PARENT: &str = "-1";

/// Returns the diagnostic of a node.
pub(super) fn diagnostic(
    nodes: &BTreeMap<String, FlatNode>,
    id: &str,
    kind: impl Into<MissionErrorKind>,
) -> MissionDiagnostic {
    let name = nodes.get(id).map_or("?", |node| &node.name);
    MissionDiagnostic { path: format!("node {id} ({name})"), kind: kind.into() }
}
