//! State, factsheet and connection of a vehicle, as messages of each version.

use super::{Activity, ExecutedAction, OrderExecutor};
use crate::cause::{ErrorLevel, VehicleError};
use crate::identity::Version;
use crate::incoming::{ActionStatus, ConnectionState};
use serde_json::{Map, Value, json};
use std::f64::consts::PI;

/// Returns the body of a connection message.
pub fn connection(state: ConnectionState, version: Version) -> Map<String, Value> {
    let text = match state {
        ConnectionState::Online => "ONLINE",
        ConnectionState::Offline => "OFFLINE",
        ConnectionState::Hibernating => "HIBERNATING",
        ConnectionState::Broken if version == Version::V3_0 => "CONNECTION_BROKEN",
        ConnectionState::Broken => "CONNECTIONBROKEN",
    };
    Map::from_iter([("connectionState".to_owned(), json!(text))])
}

impl OrderExecutor {
    fn is_3(&self) -> bool {
        self.settings.version == Version::V3_0
    }

    /// Returns the body of the state.
    pub fn state(&self) -> Map<String, Value> {
        let is_3 = self.is_3();
        let progress = &self.progress;
        let nodes = progress
            .nodes
            .iter()
            .map(|node| json!({ "nodeId": node.id, "sequenceId": node.sequence, "released": node.released }));
        let edges = progress
            .edges
            .iter()
            .map(|edge| json!({ "edgeId": edge.id, "sequenceId": edge.sequence, "released": edge.released }));
        let of_order = progress.actions.iter().map(|action| self.action(action));
        let instants = self.instants.iter().map(|action| self.action(action));
        let (of_order, instants): (Vec<Value>, Vec<Value>) = match is_3 {
            true => (of_order.collect(), instants.collect()),
            false => (of_order.chain(instants).collect(), vec![]),
        };
        let charge_percent = self.condition.charge * 100.0;
        let is_charging = self.condition.is_charging;
        let mut state = json!({
            "orderId": progress.id, "orderUpdateId": progress.update, "lastNodeId": progress.last_node,
            "lastNodeSequenceId": progress.last_sequence, "nodeStates": Vec::from_iter(nodes),
            "edgeStates": Vec::from_iter(edges), "driving": matches!(self.activity, Some(Activity::Drive)),
            "paused": self.is_paused, "operatingMode": "AUTOMATIC", "actionStates": of_order,
            "errors": Vec::from_iter(self.errors.iter().map(|error| self.error(error))),
        });
        if is_3 {
            state["instantActionStates"] = json!(instants);
            state["powerSupply"] = json!({ "stateOfCharge": charge_percent, "charging": is_charging });
            state["safetyState"] = json!({ "activeEmergencyStop": "NONE", "fieldViolation": false });
        } else {
            state["batteryState"] = json!({ "batteryCharge": charge_percent, "charging": is_charging });
            state["safetyState"] = json!({ "eStop": "NONE", "fieldViolation": false });
        }
        let (name, position) = self.position();
        state[name] = position;
        object(state)
    }

    /// Returns the body of a visualization, which is sent between two states.
    pub fn visualization(&self, state_header_id: u32) -> Map<String, Value> {
        let (name, position) = self.position();
        let mut body = Map::from_iter([(name.to_owned(), position)]);
        if self.is_3() {
            body.insert("referenceStateHeaderId".to_owned(), json!(state_header_id));
        }
        body
    }

    fn position(&self) -> (&'static str, Value) {
        let position = &self.condition.position;
        let (name, flag) =
            if self.is_3() { ("mobileRobotPosition", "localized") } else { ("agvPosition", "positionInitialized") };
        let json = json!({
            "x": position.x_m, "y": position.y_m, "theta": within_half_turn(position.yaw_rad),
            "mapId": position.map, flag: true,
        });
        (name, json)
    }

    fn action(&self, action: &ExecutedAction) -> Value {
        let status = match action.status {
            ActionStatus::Waiting => "WAITING",
            ActionStatus::Running => "RUNNING",
            ActionStatus::Finished => "FINISHED",
            ActionStatus::Retriable => "RETRIABLE",
            ActionStatus::Failed => "FAILED",
        };
        let mut json = json!({ "actionId": action.id, "actionType": action.kind, "actionStatus": status });
        if !action.result.is_empty() {
            let key = if self.is_3() { "actionResult" } else { "resultDescription" };
            json[key] = json!(action.result);
        }
        json
    }

    fn error(&self, error: &VehicleError) -> Value {
        let level = match (error.level, self.is_3()) {
            (ErrorLevel::Warning, _) | (ErrorLevel::Urgent, false) => "WARNING",
            (ErrorLevel::Urgent, true) => "URGENT",
            (ErrorLevel::Critical, true) => "CRITICAL",
            (ErrorLevel::Critical, false) | (ErrorLevel::Fatal, _) => "FATAL",
        };
        let reference = |(key, value): &(String, String)| json!({ "referenceKey": key, "referenceValue": value });
        json!({
            "errorType": error.kind, "errorLevel": level, "errorDescription": error.description,
            "errorReferences": Vec::from_iter(error.references.iter().map(reference)),
        })
    }

    /// Returns the body of the factsheet. Properties that a simulated robot does not have are 0 or empty.
    pub fn factsheet(&self) -> Map<String, Value> {
        let settings = &self.settings;
        let (speed_mps, size_m) = (settings.speed_max_mps, 2.0 * settings.radius_m);
        let action = |kind: &String| {
            let mut action = json!({ "actionType": kind, "actionScopes": ["INSTANT", "NODE"] });
            if self.is_3() {
                // The published schema demands texts here.
                (action["pauseAllowed"], action["cancelAllowed"]) = (json!("false"), json!("true"));
            }
            action
        };
        let actions = Vec::from_iter(settings.actions.iter().map(action));
        object(if self.is_3() {
            json!({
                "typeSpecification": {
                    "seriesName": settings.series, "mobileRobotKinematic": "DIFFERENTIAL",
                    "mobileRobotKinematics": "DIFFERENTIAL", "mobileRobotClass": "CARRIER", "maximumLoadMass": 0,
                    "localizationTypes": ["NATURAL"], "navigationTypes": ["VIRTUAL_LINE_GUIDED"],
                },
                "physicalParameters": {
                    "minimumSpeed": 0, "maximumSpeed": speed_mps, "maximumAcceleration": 0, "maximumDeceleration": 0,
                    "minimumHeight": 0, "maximumHeight": 0, "width": size_m, "length": size_m,
                },
                "protocolLimits": {
                    "maximumStringLengths": {}, "maximumArrayLengths": {},
                    "timing": { "minimumOrderInterval": 0, "minimumStateInterval": 0 },
                },
                "protocolFeatures": { "optionalParameters": [], "mobileRobotActions": actions },
                "mobileRobotGeometry": {}, "loadSpecification": {},
            })
        } else {
            json!({
                "typeSpecification": {
                    "seriesName": settings.series, "agvKinematic": "DIFF", "agvClass": "CARRIER", "maxLoadMass": 0,
                    "localizationTypes": ["NATURAL"], "navigationTypes": ["VIRTUAL_LINE_GUIDED"],
                },
                "physicalParameters": {
                    "speedMin": 0, "speedMax": speed_mps, "accelerationMax": 0, "decelerationMax": 0, "heightMin": 0,
                    "heightMax": 0, "width": size_m, "length": size_m,
                },
                "protocolLimits": {
                    "maxStringLens": {}, "maxArrayLens": {}, "timing": { "minOrderInterval": 0, "minStateInterval": 0 },
                },
                "protocolFeatures": { "optionalParameters": [], "agvActions": actions },
                "agvGeometry": {}, "loadSpecification": {},
            })
        })
    }
}

/// Returns the same heading between -π and π, as version 3.0 demands.
fn within_half_turn(yaw_rad: f64) -> f64 {
    if yaw_rad.abs() <= PI { yaw_rad } else { yaw_rad.sin().atan2(yaw_rad.cos()) }
}

fn object(value: Value) -> Map<String, Value> {
    match value {
        Value::Object(object) => object,
        _ => Map::new(),
    }
}
