//! Messages of a vehicle, in a form that does not depend on the version.

use crate::cause::{ErrorLevel, VehicleError};
use crate::identity::{Topic, Vehicle, Version};
use crate::order_id::OrderId;
use crate::outgoing::INSTANT_ACTIONS_2_0;
use crate::schema::{Violation, check, schema};
use serde_json::Value;

/// A message of a vehicle was refused. Nothing of it counts.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Malformed {
    /// The message is no JSON.
    #[error("no JSON: {0}")]
    Json(String),
    /// The message does not fit the schema.
    #[error(transparent)]
    Schema(#[from] Violation),
    /// The message names another vehicle than its topic.
    #[error("/{0}: the message names another vehicle than its topic")]
    Foreign(&'static str),
}

/// Pose of a vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct Position {
    /// East of the map's origin, in metres.
    pub x_m: f64,
    /// North of the map's origin, in metres.
    pub y_m: f64,
    /// Heading in radians.
    pub yaw_rad: f64,
    /// The map.
    pub map: String,
}

/// A node of an order that the vehicle has not reached.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RemainingNode {
    /// Id.
    pub id: String,
    /// Number in the order.
    pub sequence: u64,
    /// True for the base, false for the horizon.
    pub released: bool,
}

/// Status of an action of a vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ActionStatus {
    /// The action waits for its node or for other actions.
    Waiting,
    /// The action has begun.
    Running,
    /// The action is done.
    Finished,
    /// The action failed, and waits for a decision to repeat it or to give it up; since version 3.0.
    Retriable,
    /// The action failed.
    Failed,
}

impl ActionStatus {
    /// Checks whether the action has ended.
    pub fn is_final(self) -> bool {
        matches!(self, ActionStatus::Finished | ActionStatus::Failed)
    }
}

/// Report about an action.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ActionReport {
    /// Id of the action.
    pub id: String,
    /// Status.
    pub status: ActionStatus,
    /// Result, or the description of the failure.
    pub result: String,
}

/// State of a vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct VehicleState {
    /// Number of the message. A vehicle that restarts begins again.
    pub header_id: u64,
    /// Time of the message as written by the vehicle.
    pub timestamp: String,
    /// Id of the latest order, or an empty text.
    pub order: String,
    /// Latest accepted update of the order.
    pub update: u64,
    /// Id of the last node that the vehicle reached, or an empty text.
    pub last_node: String,
    /// Number of this node in the order.
    pub last_sequence: u64,
    /// Nodes to drive to.
    pub nodes: Vec<RemainingNode>,
    /// Number of edges to drive.
    pub edges_left: usize,
    /// True while the vehicle drives or turns.
    pub is_driving: bool,
    /// Position, if the vehicle knows it.
    pub position: Option<Position>,
    /// Charge as a share of a full battery.
    pub charge: f64,
    /// Actions of the order; before version 3.0 also the instant actions.
    pub actions: Vec<ActionReport>,
    /// Instant actions, which stay in the state until the vehicle is asked to remove them; none before
    /// version 3.0.
    pub instant_actions: Vec<ActionReport>,
    /// Errors.
    pub errors: Vec<VehicleError>,
    /// Operating mode, for example `AUTOMATIC`.
    pub mode: String,
    /// True if an emergency stop is active.
    pub is_stopped: bool,
}

impl VehicleState {
    /// Returns the report about an action.
    pub fn action(&self, id: &str) -> Option<&ActionReport> {
        self.actions.iter().chain(&self.instant_actions).find(|action| action.id == id)
    }

    /// Returns the ids of the reported actions.
    pub(crate) fn action_ids(&self) -> impl Iterator<Item = &str> {
        self.actions.iter().chain(&self.instant_actions).map(|action| action.id.as_str())
    }

    /// Checks whether the vehicle cancels or has cancelled an order, for this or an earlier process.
    pub(crate) fn has_cancelled(&self, order: OrderId) -> bool {
        let mut reports = self.actions.iter().chain(&self.instant_actions);
        reports.any(|action| action.status != ActionStatus::Failed && order.is_cancel(&action.id))
    }

    /// Checks whether the action of an order has failed because the order was cancelled.
    pub(crate) fn has_cancelled_action(&self, order: OrderId) -> bool {
        let has_failed = |report: &ActionReport| report.status == ActionStatus::Failed;
        self.action(&order.action(0)).is_some_and(has_failed) && self.has_cancelled(order)
    }

    /// Checks whether the latest order has ended: nothing is left to drive, and all its actions have ended.
    /// An instant action of version 3.0 may go on.
    pub fn is_idle(&self) -> bool {
        self.nodes.is_empty() && self.edges_left == 0 && self.actions.iter().all(|action| action.status.is_final())
    }

    /// Returns the number of the last node of the order that the vehicle has passed; `None` before its first
    /// node. A vehicle that has not reached the first node may still report the last node of the order
    /// before.
    pub fn reached(&self) -> Option<u64> {
        // Some vehicles keep the node where they are among the nodes to drive to.
        let is_ahead = |node: &&RemainingNode| node.sequence != self.last_sequence || node.id != self.last_node;
        match self.nodes.iter().filter(is_ahead).map(|node| node.sequence).min() {
            Some(next) if next <= self.last_sequence => next.checked_sub(1),
            _ => Some(self.last_sequence),
        }
    }

    /// Checks whether the operating mode lets the vehicle execute orders.
    pub fn takes_orders(&self) -> bool {
        ["AUTOMATIC", "SEMIAUTOMATIC"].contains(&self.mode.as_str())
    }
}

/// Connection of a vehicle to the broker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ConnectionState {
    /// Connected.
    Online,
    /// Disconnected on purpose.
    Offline,
    /// Asleep; since version 3.0.
    Hibernating,
    /// The broker lost the connection.
    Broken,
}

/// Position of a vehicle between two states.
#[derive(Debug, Clone, PartialEq)]
pub struct Visualization {
    /// Position, if the vehicle knows it.
    pub position: Option<Position>,
}

/// Properties of a vehicle.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Factsheet {
    /// Name of the series.
    pub series: Option<String>,
    /// Highest speed in metres per second.
    pub speed_max_mps: Option<f64>,
    /// Length and width in metres.
    pub size_m: Option<(f64, f64)>,
    /// Types of actions that the vehicle offers.
    pub actions: Vec<String>,
}

pub(crate) fn read(vehicle: &Vehicle, topic: Topic, bytes: &[u8]) -> Result<Value, Malformed> {
    let mut message: Value = serde_json::from_slice(bytes).map_err(|problem| Malformed::Json(problem.to_string()))?;
    if topic == Topic::InstantActions
        && vehicle.version() == Version::V2_0
        && let Some(actions) = message.as_object_mut().and_then(|message| message.remove(INSTANT_ACTIONS_2_0))
        && message["actions"].is_null()
    {
        message["actions"] = actions;
    }
    check(&schema(topic, vehicle.version()), &message)?;
    vehicle.foreign_field(&message).map_or(Ok(message), |field| Err(Malformed::Foreign(field)))
}

pub(crate) fn text(value: &Value) -> String {
    value.as_str().unwrap_or_default().to_owned()
}

pub(crate) fn list(value: &Value) -> impl Iterator<Item = &Value> {
    value.as_array().into_iter().flatten()
}

/// Returns a whole number, also if it is written as 1.0.
pub(crate) fn whole(value: &Value) -> u64 {
    value.as_u64().or_else(|| value.as_f64().map(|number| number as u64)).unwrap_or_default()
}

fn position(version: Version, message: &Value) -> Option<Position> {
    let (name, flag) = match version {
        Version::V3_0 => ("mobileRobotPosition", "localized"),
        _ => ("agvPosition", "positionInitialized"),
    };
    let position = message.get(name)?;
    let is_known = position[flag] == true;
    let number = |key: &str| position[key].as_f64();
    let (x_m, y_m, yaw_rad) = (number("x")?, number("y")?, number("theta")?);
    is_known.then(|| Position { x_m, y_m, yaw_rad, map: text(&position["mapId"]) })
}

/// Reads a state.
///
/// # Errors
/// The message is refused.
pub fn read_state(vehicle: &Vehicle, bytes: &[u8]) -> Result<VehicleState, Malformed> {
    let message = read(vehicle, Topic::State, bytes)?;
    let (power, charge, stop) = match vehicle.version() {
        Version::V3_0 => ("powerSupply", "stateOfCharge", "activeEmergencyStop"),
        _ => ("batteryState", "batteryCharge", "eStop"),
    };
    let node = |node: &Value| RemainingNode {
        id: text(&node["nodeId"]),
        sequence: whole(&node["sequenceId"]),
        released: node["released"] == true,
    };
    Ok(VehicleState {
        header_id: whole(&message["headerId"]),
        timestamp: text(&message["timestamp"]),
        order: text(&message["orderId"]),
        update: whole(&message["orderUpdateId"]),
        last_node: text(&message["lastNodeId"]),
        last_sequence: whole(&message["lastNodeSequenceId"]),
        nodes: list(&message["nodeStates"]).map(node).collect(),
        edges_left: list(&message["edgeStates"]).count(),
        is_driving: message["driving"] == true,
        position: position(vehicle.version(), &message),
        charge: (message[power][charge].as_f64().unwrap_or_default() / 100.0).clamp(0.0, 1.0),
        actions: list(&message["actionStates"]).map(action_report).collect(),
        instant_actions: list(&message["instantActionStates"]).map(action_report).collect(),
        errors: list(&message["errors"]).map(error).collect(),
        mode: text(&message["operatingMode"]),
        is_stopped: message["safetyState"][stop].as_str().is_some_and(|stop| stop != "NONE"),
    })
}

fn action_report(action: &Value) -> ActionReport {
    let status = match action["actionStatus"].as_str() {
        Some("WAITING") => ActionStatus::Waiting,
        Some("FINISHED") => ActionStatus::Finished,
        Some("RETRIABLE") => ActionStatus::Retriable,
        Some("FAILED") => ActionStatus::Failed,
        _ => ActionStatus::Running,
    };
    let result = ["resultDescription", "actionResult"].into_iter().find_map(|key| action[key].as_str());
    ActionReport { id: text(&action["actionId"]), status, result: result.unwrap_or_default().to_owned() }
}

fn error(error: &Value) -> VehicleError {
    let level = match error["errorLevel"].as_str() {
        Some("FATAL") => ErrorLevel::Fatal,
        Some("CRITICAL") => ErrorLevel::Critical,
        Some("URGENT") => ErrorLevel::Urgent,
        _ => ErrorLevel::Warning,
    };
    let reference = |reference: &Value| (text(&reference["referenceKey"]), text(&reference["referenceValue"]));
    VehicleError {
        kind: text(&error["errorType"]),
        level,
        description: text(&error["errorDescription"]),
        references: list(&error["errorReferences"]).map(reference).collect(),
    }
}

/// Reads a connection message.
///
/// # Errors
/// The message is refused.
pub fn read_connection(vehicle: &Vehicle, bytes: &[u8]) -> Result<ConnectionState, Malformed> {
    let message = read(vehicle, Topic::Connection, bytes)?;
    Ok(match message["connectionState"].as_str() {
        Some("ONLINE") => ConnectionState::Online,
        Some("OFFLINE") => ConnectionState::Offline,
        Some("HIBERNATING") => ConnectionState::Hibernating,
        _ => ConnectionState::Broken,
    })
}

/// Reads a visualization.
///
/// # Errors
/// The message is refused.
pub fn read_visualization(vehicle: &Vehicle, bytes: &[u8]) -> Result<Visualization, Malformed> {
    let message = read(vehicle, Topic::Visualization, bytes)?;
    Ok(Visualization { position: position(vehicle.version(), &message) })
}

/// Reads a factsheet.
///
/// # Errors
/// The message is refused.
pub fn read_factsheet(vehicle: &Vehicle, bytes: &[u8]) -> Result<Factsheet, Malformed> {
    let message = read(vehicle, Topic::Factsheet, bytes)?;
    let physical = &message["physicalParameters"];
    let features = &message["protocolFeatures"];
    let actions = list(&features["agvActions"]).chain(list(&features["mobileRobotActions"]));
    Ok(Factsheet {
        series: message["typeSpecification"]["seriesName"].as_str().map(str::to_owned),
        speed_max_mps: ["speedMax", "maximumSpeed"].into_iter().find_map(|key| physical[key].as_f64()),
        size_m: physical["length"].as_f64().zip(physical["width"].as_f64()),
        actions: actions.map(|action| text(&action["actionType"])).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn vehicle(version: Version) -> Vehicle {
        Vehicle::new("uagv", version, "ACME", "7").unwrap()
    }

    #[test]
    fn states_of_2_1_and_3_0_are_read_alike() {
        let common = json!({
            "headerId": 4, "timestamp": "2026-01-01T00:00:00.000Z", "manufacturer": "ACME", "serialNumber": "7",
            "orderId": "o", "orderUpdateId": 1, "lastNodeId": "a", "lastNodeSequenceId": 2,
            "nodeStates": [{ "nodeId": "b", "sequenceId": 4, "released": true }],
            "edgeStates": [{ "edgeId": "a_b", "sequenceId": 3, "released": true }],
            "driving": true, "operatingMode": "AUTOMATIC", "actionStates": [],
            "errors": [{ "errorType": "x", "errorLevel": "FATAL" }],
        });
        let with = |extra: Value| {
            let mut message = common.clone();
            message.as_object_mut().unwrap().extend(extra.as_object().unwrap().clone());
            message.to_string()
        };
        let old = with(json!({
            "version": "2.1.0", "batteryState": { "batteryCharge": 80.0, "charging": false },
            "safetyState": { "eStop": "NONE", "fieldViolation": false },
            "agvPosition": { "x": 1.0, "y": 2.0, "theta": 0.5, "mapId": "m", "positionInitialized": true },
        }));
        let new = with(json!({
            "version": "3.0.0", "powerSupply": { "stateOfCharge": 80.0, "charging": false }, "instantActionStates": [],
            "safetyState": { "activeEmergencyStop": "NONE", "fieldViolation": false },
            "mobileRobotPosition": { "x": 1.0, "y": 2.0, "theta": 0.5, "mapId": "m", "localized": true },
        }));
        let read_old = read_state(&vehicle(Version::V2_1), old.as_bytes()).unwrap();
        assert_eq!(read_old, read_state(&vehicle(Version::V3_0), new.as_bytes()).unwrap());
        assert_eq!((read_old.charge, read_old.nodes.len(), read_old.is_stopped), (0.8, 1, false));
        assert_eq!(read_old.errors[0].level, ErrorLevel::Fatal);
        // A message of another version is refused with the place.
        let error = read_state(&vehicle(Version::V3_0), old.as_bytes()).unwrap_err();
        assert_eq!(error.to_string(), "/: `powerSupply` is missing (schema: /required)");
    }

    #[test]
    fn an_instant_action_of_3_0_does_not_keep_the_order_busy() {
        let message = json!({
            "headerId": 4, "timestamp": "t", "version": "3.0.0", "manufacturer": "ACME", "serialNumber": "7",
            "orderId": "", "orderUpdateId": 0, "lastNodeId": "a", "lastNodeSequenceId": 0, "nodeStates": [],
            "edgeStates": [], "driving": false, "operatingMode": "AUTOMATIC", "actionStates": [], "errors": [],
            "instantActionStates": [{ "actionId": "i", "actionStatus": "RUNNING" }],
            "powerSupply": { "stateOfCharge": 80.0, "charging": false },
            "safetyState": { "activeEmergencyStop": "NONE", "fieldViolation": false },
        });
        let state = read_state(&vehicle(Version::V3_0), message.to_string().as_bytes()).unwrap();
        assert!(state.is_idle() && state.action("i").is_some());
    }

    #[test]
    fn a_message_of_another_vehicle_is_refused() {
        let message = json!({
            "headerId": 4, "timestamp": "t", "version": "2.0.0", "manufacturer": "ACME", "serialNumber": "8",
            "connectionState": "ONLINE",
        });
        let read = |bytes: &[u8]| read_connection(&vehicle(Version::V2_0), bytes);
        assert_eq!(read(message.to_string().as_bytes()), Err(Malformed::Foreign("serialNumber")));
        assert!(matches!(read(b"{"), Err(Malformed::Json(_))));
    }
}
