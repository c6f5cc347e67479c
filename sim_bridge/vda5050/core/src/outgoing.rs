//! Messages to a vehicle. The versions differ in few fields that fleet control needs; `to_json`
//! writes those of a version.

use crate::identity::Version;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// Which other activities an action of a vehicle excludes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum BlockingType {
    /// None: the vehicle may drive and act.
    None,
    /// Driving; other actions are allowed.
    Soft,
    /// Other actions; driving is allowed. Since version 3.0.
    Single,
    /// Everything else.
    #[default]
    Hard,
}

impl BlockingType {
    /// Returns the text in messages.
    pub fn as_str(self) -> &'static str {
        match self {
            BlockingType::None => "NONE",
            BlockingType::Soft => "SOFT",
            BlockingType::Single => "SINGLE",
            BlockingType::Hard => "HARD",
        }
    }
}

/// An action of a vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct VehicleAction {
    /// Id, unique for the vehicle.
    pub id: String,
    /// Type, for example `pick`.
    pub kind: String,
    /// What the action excludes.
    pub blocking: BlockingType,
    /// Parameters, by key.
    pub parameters: BTreeMap<String, Value>,
}

impl VehicleAction {
    fn to_json(&self, blocking: BlockingType) -> Value {
        let mut action = json!({ "actionId": self.id, "actionType": self.kind, "blockingType": blocking.as_str() });
        if !self.parameters.is_empty() {
            let parameters = self.parameters.iter().map(|(key, value)| json!({ "key": key, "value": value }));
            action["actionParameters"] = Value::Array(parameters.collect());
        }
        action
    }
}

/// Second name of the list of instant actions in version 2.0. Some vehicles and fleet controls of 2.0 know only this name, others
/// only `actions`, so a message has both lists, and either is accepted.
pub(crate) const INSTANT_ACTIONS_2_0: &str = "instantActions";

/// Returns the body of a message with instant actions.
pub fn instant_actions(actions: &[VehicleAction], version: Version) -> Map<String, Value> {
    let json = |action: &VehicleAction| match version {
        // Version 3.0 allows no other blocking type for instant actions.
        Version::V3_0 => action.to_json(BlockingType::None),
        // Before version 3.0 a cancel has no parameters.
        _ if action.kind == "cancelOrder" => {
            VehicleAction { parameters: BTreeMap::new(), ..action.clone() }.to_json(action.blocking)
        }
        _ => action.to_json(action.blocking),
    };
    let list = Value::Array(actions.iter().map(json).collect());
    let mut body = Map::from_iter([("actions".to_owned(), list.clone())]);
    if version == Version::V2_0 {
        body.insert(INSTANT_ACTIONS_2_0.to_owned(), list);
    }
    body
}

/// A node of an order.
#[derive(Debug, Clone, PartialEq)]
pub struct OrderNode {
    /// Id.
    pub id: String,
    /// Number in the order: even, and growing by 2.
    pub sequence: u64,
    /// True if the node belongs to the base, which the vehicle may drive; false for the horizon.
    pub released: bool,
    /// Position on the map, in metres.
    pub at_m: Option<(f64, f64)>,
    /// Heading on arrival in radians, if the vehicle has to take it.
    pub yaw_rad: Option<f64>,
    /// Actions on the node.
    pub actions: Vec<VehicleAction>,
}

/// An edge of an order, between the nodes before and after it.
#[derive(Debug, Clone, PartialEq)]
pub struct OrderEdge {
    /// Number in the order: odd.
    pub sequence: u64,
    /// True if the edge belongs to the base.
    pub released: bool,
    /// Node at the start.
    pub from: String,
    /// Node at the end.
    pub to: String,
    /// Highest allowed speed in metres per second.
    pub speed_max_mps: Option<f64>,
}

/// An order, or an update of the order with the same id.
#[derive(Debug, Clone, PartialEq)]
pub struct Order {
    /// Id.
    pub id: String,
    /// 0 for a new order, and growing by 1 with each update.
    pub update: u64,
    /// Map of the positions.
    pub map: String,
    /// Nodes; an update begins with the last node of the base.
    pub nodes: Vec<OrderNode>,
    /// Edges between the nodes, in their order.
    pub edges: Vec<OrderEdge>,
}

impl Order {
    /// Returns the body of the message.
    pub fn to_json(&self, version: Version) -> Map<String, Value> {
        let node = |node: &OrderNode| {
            let actions: Vec<Value> = node.actions.iter().map(|action| action.to_json(action.blocking)).collect();
            let mut json = json!({
                "nodeId": node.id, "sequenceId": node.sequence, "released": node.released, "actions": actions,
            });
            if let Some((x_m, y_m)) = node.at_m {
                json["nodePosition"] = json!({ "x": x_m, "y": y_m, "mapId": self.map });
                if let Some(yaw_rad) = node.yaw_rad {
                    json["nodePosition"]["theta"] = json!(yaw_rad);
                }
            }
            json
        };
        let edge = |edge: &OrderEdge| {
            let mut json = json!({
                "edgeId": format!("{}_{}", edge.from, edge.to), "sequenceId": edge.sequence, "released": edge.released,
                "actions": [],
            });
            if version < Version::V3_0 {
                (json["startNodeId"], json["endNodeId"]) = (json!(edge.from), json!(edge.to));
            }
            if let Some(speed_mps) = edge.speed_max_mps {
                let key = if version == Version::V3_0 { "maximumSpeed" } else { "maxSpeed" };
                json[key] = json!(speed_mps);
            }
            json
        };
        Map::from_iter([
            ("orderId".to_owned(), json!(self.id)),
            ("orderUpdateId".to_owned(), json!(self.update)),
            ("nodes".to_owned(), Value::Array(self.nodes.iter().map(node).collect())),
            ("edges".to_owned(), Value::Array(self.edges.iter().map(edge).collect())),
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cancel_names_its_order_since_version_3() {
        let parameters = BTreeMap::from([("orderId".to_owned(), json!("o"))]);
        let (id, kind) = ("i".to_owned(), "cancelOrder".to_owned());
        let cancel = VehicleAction { id, kind, blocking: BlockingType::Hard, parameters };
        let sent = |version| instant_actions(std::slice::from_ref(&cancel), version)["actions"][0].clone();
        let old = json!({ "actionId": "i", "actionType": "cancelOrder", "blockingType": "HARD" });
        assert_eq!(sent(Version::V2_1), old);
        assert_eq!(sent(Version::V3_0)["blockingType"], "NONE");
        assert_eq!(sent(Version::V3_0)["actionParameters"], json!([{ "key": "orderId", "value": "o" }]));
    }

    #[test]
    fn instant_actions_of_2_0_have_both_names() {
        let names = |version| instant_actions(&[], version).into_iter().map(|(name, _)| name).collect::<Vec<_>>();
        assert_eq!(names(Version::V2_0), ["actions", "instantActions"]);
        assert_eq!(names(Version::V2_1), ["actions"]);
    }

    #[test]
    fn an_edge_names_its_nodes_before_version_3() {
        let (from, to) = ("a".to_owned(), "b".to_owned());
        let edge = OrderEdge { sequence: 1, released: true, from, to, speed_max_mps: Some(0.5) };
        let order = Order { id: "o".to_owned(), update: 0, map: "m".to_owned(), nodes: vec![], edges: vec![edge] };
        let common = json!({ "edgeId": "a_b", "sequenceId": 1, "released": true, "actions": [] });
        let with = |extra: Value| {
            let mut edge = common.clone();
            edge.as_object_mut().unwrap().extend(extra.as_object().unwrap().clone());
            json!([edge])
        };
        let old = with(json!({ "startNodeId": "a", "endNodeId": "b", "maxSpeed": 0.5 }));
        assert_eq!(order.to_json(Version::V2_1)["edges"], old);
        assert_eq!(order.to_json(Version::V3_0)["edges"], with(json!({ "maximumSpeed": 0.5 })));
    }
}
