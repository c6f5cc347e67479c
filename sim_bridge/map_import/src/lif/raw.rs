//! The file as written. Unused members are ignored: manufacturers add their own.

use serde::Deserialize;
use serde_json::Value;

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct File {
    pub(super) meta_information: MetaInformation,
    pub(super) layouts: Vec<Layout>,
}

/// The part of a file of any version.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Head {
    pub(super) meta_information: MetaInformation,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct MetaInformation {
    pub(super) project_identification: Option<String>,
    pub(super) lif_version: String,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Layout {
    pub(super) layout_id: String,
    pub(super) layout_level_id: Option<String>,
    pub(super) nodes: Vec<Node>,
    pub(super) edges: Vec<Edge>,
    #[serde(default)]
    pub(super) stations: Vec<Station>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Node {
    pub(super) node_id: String,
    pub(super) node_name: Option<String>,
    pub(super) node_position: Point,
    #[serde(default)]
    pub(super) vehicle_type_node_properties: Vec<NodeProperties>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
pub(super) struct Point {
    pub(super) x: f64,
    pub(super) y: f64,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct NodeProperties {
    pub(super) theta: Option<f64>,
    #[serde(default)]
    pub(super) actions: Vec<Action>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Action {
    pub(super) action_type: String,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Edge {
    pub(super) edge_id: String,
    pub(super) start_node_id: String,
    pub(super) end_node_id: String,
    #[serde(default)]
    pub(super) vehicle_type_edge_properties: Vec<EdgeProperties>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct EdgeProperties {
    pub(super) vehicle_type_id: String,
    pub(super) vehicle_orientation: Option<f64>,
    pub(super) orientation_type: Option<String>,
    pub(super) max_speed: Option<f64>,
    pub(super) load_restriction: Option<Value>,
    pub(super) max_height: Option<f64>,
    #[serde(default)]
    pub(super) actions: Vec<Action>,
    pub(super) trajectory: Option<Trajectory>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Trajectory {
    #[serde(default)]
    pub(super) control_points: Vec<Point>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Station {
    #[serde(default)]
    pub(super) interaction_node_ids: Vec<String>,
}
