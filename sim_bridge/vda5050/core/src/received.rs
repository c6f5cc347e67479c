//! Orders and instant actions as a vehicle receives them.

use crate::identity::{Topic, Vehicle, Version};
use crate::incoming::{Malformed, list, read, text, whole};
use crate::outgoing::VehicleAction;
use serde_json::Value;

/// A node of a received order.
#[derive(Debug, Clone, PartialEq)]
pub struct ReceivedNode {
    /// Id.
    pub id: String,
    /// Number in the order: even.
    pub sequence: u64,
    /// True for the base, false for the horizon.
    pub released: bool,
    /// Position on the map, in metres.
    pub at_m: Option<(f64, f64)>,
    /// Map of the position.
    pub map: Option<String>,
    /// Heading on arrival in radians, if the vehicle has to take it.
    pub yaw_rad: Option<f64>,
    /// Distance within which the vehicle is on the node, in metres; 0 leaves it to the vehicle.
    pub deviation_m: f64,
    /// Actions on the node.
    pub actions: Vec<VehicleAction>,
}

/// An edge of a received order.
#[derive(Debug, Clone, PartialEq)]
pub struct ReceivedEdge {
    /// Id.
    pub id: String,
    /// Number in the order: odd.
    pub sequence: u64,
    /// True for the base, false for the horizon.
    pub released: bool,
    /// Highest allowed speed in metres per second.
    pub speed_max_mps: Option<f64>,
    /// True if the edge has actions.
    pub has_actions: bool,
}

/// An order, or an update of the order with the same id.
#[derive(Debug, Clone, PartialEq)]
pub struct ReceivedOrder {
    /// Id.
    pub id: String,
    /// Number of the update.
    pub update: u64,
    /// Nodes.
    pub nodes: Vec<ReceivedNode>,
    /// Edges between the nodes.
    pub edges: Vec<ReceivedEdge>,
}

impl ReceivedOrder {
    /// Checks what the schema cannot: numbers grow by 1 over nodes and edges, and the base comes before the
    /// horizon. Returns the problem.
    pub(crate) fn problem(&self) -> Option<String> {
        let Some(first) = self.nodes.first() else { return Some("the order has no nodes".to_owned()) };
        if self.edges.len() + 1 != self.nodes.len() {
            return Some(format!("{} nodes have {} edges", self.nodes.len(), self.edges.len()));
        }
        let sequences = self.nodes.iter().zip((0_u64..).step_by(2)).map(|(node, step)| (node.sequence, step));
        let of_edges = self.edges.iter().zip((1_u64..).step_by(2)).map(|(edge, step)| (edge.sequence, step));
        let is_wrong = |(sequence, step): &(u64, u64)| *sequence != first.sequence.saturating_add(*step);
        if let Some((sequence, _)) = sequences.chain(of_edges).find(is_wrong) {
            return Some(format!("the sequenceId {sequence} does not continue those before it"));
        }
        let base = self.nodes.iter().take_while(|node| node.released).count();
        if base == 0 || self.nodes.iter().skip(base).any(|node| node.released) {
            return Some("released nodes follow a node that is not released".to_owned());
        }
        let ends = self.nodes.iter().skip(1);
        let is_unlike = self.edges.iter().zip(ends).any(|(edge, end)| edge.released != end.released);
        is_unlike.then(|| "an edge and the node at its end are not released together".to_owned())
    }
}

/// Reads an order.
///
/// # Errors
/// The message is refused.
pub fn read_order(vehicle: &Vehicle, bytes: &[u8]) -> Result<ReceivedOrder, Malformed> {
    let message = read(vehicle, Topic::Order, bytes)?;
    let speed = if vehicle.version() == Version::V3_0 { "maximumSpeed" } else { "maxSpeed" };
    let edge = |edge: &Value| ReceivedEdge {
        id: text(&edge["edgeId"]),
        sequence: whole(&edge["sequenceId"]),
        released: edge["released"] == true,
        speed_max_mps: edge[speed].as_f64(),
        has_actions: list(&edge["actions"]).next().is_some(),
    };
    Ok(ReceivedOrder {
        id: text(&message["orderId"]),
        update: whole(&message["orderUpdateId"]),
        nodes: list(&message["nodes"]).map(node).collect(),
        edges: list(&message["edges"]).map(edge).collect(),
    })
}

/// Reads instant actions.
///
/// # Errors
/// The message is refused.
pub fn read_instant_actions(vehicle: &Vehicle, bytes: &[u8]) -> Result<Vec<VehicleAction>, Malformed> {
    let message = read(vehicle, Topic::InstantActions, bytes)?;
    Ok(list(&message["actions"]).map(action).collect())
}

fn node(node: &Value) -> ReceivedNode {
    let position = &node["nodePosition"];
    // A radius before version 3.0, and then the half-axes of an ellipse.
    let deviation = &position["allowedDeviationXY"];
    let smaller_axis = || Some(deviation["a"].as_f64()?.min(deviation["b"].as_f64()?));
    ReceivedNode {
        id: text(&node["nodeId"]),
        sequence: whole(&node["sequenceId"]),
        released: node["released"] == true,
        at_m: position["x"].as_f64().zip(position["y"].as_f64()),
        map: position["mapId"].as_str().map(str::to_owned),
        yaw_rad: position["theta"].as_f64(),
        deviation_m: deviation.as_f64().or_else(smaller_axis).unwrap_or_default(),
        actions: list(&node["actions"]).map(action).collect(),
    }
}

fn action(action: &Value) -> VehicleAction {
    let parameters = list(&action["actionParameters"]);
    VehicleAction {
        id: text(&action["actionId"]),
        kind: text(&action["actionType"]),
        // The schema has checked the text.
        blocking: serde_json::from_value(action["blockingType"].clone()).unwrap_or_default(),
        parameters: parameters.map(|parameter| (text(&parameter["key"]), parameter["value"].clone())).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outgoing::{BlockingType, Order, OrderEdge, OrderNode};
    use serde_json::json;
    use std::collections::BTreeMap;

    #[test]
    fn either_name_of_instant_actions_is_read_in_2_0_only() {
        let vehicle = |version| Vehicle::new("uagv", version, "ACME", "7").unwrap();
        let cancel = json!([{ "actionId": "i", "actionType": "cancelOrder", "blockingType": "HARD" }]);
        let read = |version, name: &str| {
            let body = serde_json::Map::from_iter([(name.to_owned(), cancel.clone())]);
            let message = vehicle(version).message(0, "2026-01-01T00:00:00.00Z", body);
            read_instant_actions(&vehicle(version), message.to_string().as_bytes()).map(|actions| actions.len())
        };
        assert_eq!(read(Version::V2_0, "actions"), Ok(1));
        assert_eq!(read(Version::V2_0, "instantActions"), Ok(1));
        assert_eq!(read(Version::V2_1, "actions"), Ok(1));
        let refused = read(Version::V2_1, "instantActions").unwrap_err().to_string();
        assert_eq!(refused, "/: `actions` is missing (schema: /required)");
    }

    fn order() -> Order {
        let parameters = BTreeMap::from([("loadId".to_owned(), json!("L-7"))]);
        let (id, kind, blocking) = ("x".to_owned(), "pick".to_owned(), BlockingType::Soft);
        let action = VehicleAction { id, kind, blocking, parameters };
        let node = |id: &str, sequence: u64, released, actions| OrderNode {
            id: id.to_owned(),
            sequence,
            released,
            at_m: Some((sequence as f64, 0.0)),
            yaw_rad: None,
            actions,
        };
        let edge = |from: &str, to: &str, sequence, released| OrderEdge {
            sequence,
            released,
            from: from.to_owned(),
            to: to.to_owned(),
            speed_max_mps: Some(0.5),
        };
        Order {
            id: "o".to_owned(),
            update: 1,
            map: "m".to_owned(),
            nodes: vec![node("a", 0, true, vec![]), node("b", 2, true, vec![action]), node("c", 4, false, vec![])],
            edges: vec![edge("a", "b", 1, true), edge("b", "c", 3, false)],
        }
    }

    fn received(version: Version) -> ReceivedOrder {
        let vehicle = Vehicle::new("uagv", version, "ACME", "7").unwrap();
        let message = vehicle.message(0, "2026-01-01T00:00:00.000Z", order().to_json(version));
        read_order(&vehicle, message.to_string().as_bytes()).unwrap()
    }

    #[test]
    fn a_vehicle_reads_what_fleet_control_writes() {
        for version in Version::ALL {
            let received = received(version);
            assert_eq!((received.id.as_str(), received.update, received.problem()), ("o", 1, None));
            assert_eq!(received.nodes[1].actions, order().nodes[1].actions);
            assert_eq!((received.nodes[2].at_m, received.nodes[2].released), (Some((4.0, 0.0)), false));
            assert_eq!((received.edges[0].speed_max_mps, received.edges[1].sequence), (Some(0.5), 3));
        }
    }

    #[test]
    fn an_order_with_gaps_is_no_order() {
        let with = |change: fn(&mut ReceivedOrder)| {
            let mut order = received(Version::V2_1);
            change(&mut order);
            order.problem().unwrap()
        };
        assert!(with(|order| order.nodes.clear()).contains("no nodes"));
        assert!(with(|order| drop(order.edges.pop())).contains("1 edges"));
        assert!(with(|order| order.edges[1].sequence = 5).contains("sequenceId 5"));
        assert!(with(|order| order.nodes[0].released = false).contains("not released"));
        assert!(with(|order| order.edges[1].released = true).contains("released together"));
    }
}
