//! JSON Schemas of the messages, as far as fleet control reads and writes them, and their check.
//!
//! The schemas allow further fields, as VDA 5050 does, and accept what the official schemas accept, except for negative
//! numbers of messages, updates, nodes and edges: the standard describes them as `uint32`. A mode that the standard
//! does not name is accepted and allows no orders, and an emergency stop that it does not name counts as one.

use crate::identity::{Topic, Version};
use serde_json::{Value, json};
use std::cmp::Ordering;

/// A message does not fit its schema.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{path}: {problem} (schema: {rule})")]
pub struct Violation {
    /// Place in the message, as a JSON pointer: `/errors/0/errorLevel`.
    pub path: String,
    /// Place of the rule in the schema, as a JSON pointer.
    pub rule: String,
    /// The problem, and what is allowed.
    pub problem: String,
}

fn text() -> Value {
    json!({ "type": "string" })
}

fn number() -> Value {
    json!({ "type": "number" })
}

fn flag() -> Value {
    json!({ "type": "boolean" })
}

fn count() -> Value {
    json!({ "type": "integer", "minimum": 0 })
}

fn one_of(words: &[&str]) -> Value {
    json!({ "type": "string", "enum": words })
}

fn list(items: Value) -> Value {
    json!({ "type": "array", "items": items })
}

fn object(required: &[&str], properties: Value) -> Value {
    json!({ "type": "object", "required": required, "properties": properties })
}

/// Returns the schema of a topic.
pub fn schema(topic: Topic, version: Version) -> Value {
    let mut schema = match topic {
        Topic::Order => order(version),
        Topic::InstantActions => object(&["actions"], json!({ "actions": list(action(version, true)) })),
        Topic::State => state(version),
        Topic::Visualization => visualization(version),
        Topic::Connection => connection(version),
        Topic::Factsheet => factsheet(version),
    };
    let header = [
        ("headerId", count()),
        ("timestamp", text()),
        ("version", text()),
        ("manufacturer", text()),
        ("serialNumber", text()),
    ];
    // Before version 3.0 the official schemas require no header of a visualization, and no `headerId` of a factsheet.
    let required: &[&str] = match topic {
        Topic::Visualization if version < Version::V3_0 => &[],
        Topic::Factsheet if version < Version::V3_0 => &["version", "manufacturer", "serialNumber"],
        _ => &["headerId", "timestamp", "version", "manufacturer", "serialNumber"],
    };
    for (name, form) in header {
        schema["properties"][name] = form;
    }
    if let Some(names) = schema["required"].as_array_mut() {
        *names = required.iter().map(|name| json!(name)).chain(names.drain(..)).collect();
    }
    schema["$schema"] = json!("https://json-schema.org/draft/2020-12/schema");
    schema["title"] = json!(format!("{} {version}", topic.level()));
    schema
}

fn action(version: Version, is_instant: bool) -> Value {
    let blocking = match (version, is_instant) {
        (Version::V3_0, true) => one_of(&["NONE"]),
        (Version::V3_0, false) => one_of(&["NONE", "SOFT", "SINGLE", "HARD"]),
        _ => one_of(&["NONE", "SOFT", "HARD"]),
    };
    let value = json!({ "type": ["array", "boolean", "number", "string", "object"] });
    let parameter = object(&["key", "value"], json!({ "key": text(), "value": value }));
    object(
        &["actionId", "actionType", "blockingType"],
        json!({
            "actionId": text(), "actionType": text(), "blockingType": blocking, "actionParameters": list(parameter),
        }),
    )
}

fn order(version: Version) -> Value {
    // The published schemas round the number to 11 digits.
    let half_turn = (std::f64::consts::PI * 1e11).round() / 1e11;
    let angle = json!({ "type": "number", "minimum": -half_turn, "maximum": half_turn });
    let length = json!({ "type": "number", "minimum": 0 });
    // A radius before version 3.0, and then an ellipse.
    let deviation = match version {
        Version::V3_0 => object(&["a", "b", "theta"], json!({ "a": length.clone(), "b": length, "theta": number() })),
        _ => length,
    };
    let position = object(
        &["x", "y", "mapId"],
        json!({
            "x": number(), "y": number(), "theta": angle, "allowedDeviationXY": deviation, "mapId": text(),
        }),
    );
    let node = object(
        &["nodeId", "sequenceId", "released", "actions"],
        json!({
            "nodeId": text(), "sequenceId": count(), "released": flag(), "nodePosition": position,
            "actions": list(action(version, false)),
        }),
    );
    let speed = if version == Version::V3_0 { "maximumSpeed" } else { "maxSpeed" };
    // Version 3.0 has no nodes of an edge: they are those before and after it.
    let required: &[&str] = match version {
        Version::V3_0 => &["edgeId", "sequenceId", "released", "actions"],
        _ => &["edgeId", "sequenceId", "released", "startNodeId", "endNodeId", "actions"],
    };
    let edge = object(
        required,
        json!({
            "edgeId": text(), "sequenceId": count(), "released": flag(), "startNodeId": text(), "endNodeId": text(),
            speed: number(), "actions": list(action(version, false)),
        }),
    );
    object(
        &["orderId", "orderUpdateId", "nodes", "edges"],
        json!({ "orderId": text(), "orderUpdateId": count(), "nodes": list(node), "edges": list(edge) }),
    )
}

/// Returns the name and the form of the position in a state.
fn position(version: Version) -> (&'static str, Value) {
    let (name, flagged) = match version {
        Version::V3_0 => ("mobileRobotPosition", "localized"),
        _ => ("agvPosition", "positionInitialized"),
    };
    let fields = json!({ "x": number(), "y": number(), "theta": number(), "mapId": text(), flagged: flag() });
    (name, object(&["x", "y", "theta", "mapId", flagged], fields))
}

fn state(version: Version) -> Value {
    let is_3 = version == Version::V3_0;
    let step = |id: &str| {
        object(&[id, "sequenceId", "released"], json!({ id: text(), "sequenceId": count(), "released": flag() }))
    };
    let statuses: &[&str] = if is_3 {
        &["WAITING", "INITIALIZING", "RUNNING", "PAUSED", "RETRIABLE", "FINISHED", "FAILED"]
    } else {
        &["WAITING", "INITIALIZING", "RUNNING", "PAUSED", "FINISHED", "FAILED"]
    };
    let result = if is_3 { "actionResult" } else { "resultDescription" };
    let action = object(
        &["actionId", "actionStatus"],
        json!({ "actionId": text(), "actionStatus": one_of(statuses), result: text() }),
    );
    let levels: &[&str] = if is_3 { &["WARNING", "URGENT", "CRITICAL", "FATAL"] } else { &["WARNING", "FATAL"] };
    let reference =
        object(&["referenceKey", "referenceValue"], json!({ "referenceKey": text(), "referenceValue": text() }));
    let error = object(
        &["errorType", "errorLevel"],
        json!({
            "errorType": text(), "errorLevel": one_of(levels), "errorDescription": text(),
            "errorReferences": list(reference),
        }),
    );
    let (position_name, position) = position(version);
    let (power, power_form) = if is_3 {
        (
            "powerSupply",
            object(&["stateOfCharge", "charging"], json!({ "stateOfCharge": number(), "charging": flag() })),
        )
    } else {
        (
            "batteryState",
            object(&["batteryCharge", "charging"], json!({ "batteryCharge": number(), "charging": flag() })),
        )
    };
    let stop = if is_3 { "activeEmergencyStop" } else { "eStop" };
    let mut state = object(
        &[
            "orderId",
            "orderUpdateId",
            "lastNodeId",
            "lastNodeSequenceId",
            "nodeStates",
            "edgeStates",
            "driving",
            "actionStates",
            "operatingMode",
            "errors",
            "safetyState",
            power,
        ],
        json!({
            "orderId": text(), "orderUpdateId": count(), "lastNodeId": text(), "lastNodeSequenceId": count(),
            "nodeStates": list(step("nodeId")), "edgeStates": list(step("edgeId")), "driving": flag(), "paused": flag(),
            position_name: position, "actionStates": list(action.clone()), power: power_form, "operatingMode": text(),
            "errors": list(error),
            "safetyState": object(&[stop, "fieldViolation"], json!({ stop: text(), "fieldViolation": flag() })),
        }),
    );
    if is_3 {
        state["properties"]["instantActionStates"] = list(action);
        if let Some(required) = state["required"].as_array_mut() {
            required.push(json!("instantActionStates"));
        }
    }
    state
}

fn visualization(version: Version) -> Value {
    let (name, form) = position(version);
    match version {
        Version::V3_0 => object(&["referenceStateHeaderId"], json!({ "referenceStateHeaderId": count(), name: form })),
        _ => object(&[], json!({ name: form })),
    }
}

fn connection(version: Version) -> Value {
    let states: &[&str] = match version {
        Version::V3_0 => &["ONLINE", "OFFLINE", "HIBERNATING", "CONNECTION_BROKEN"],
        _ => &["ONLINE", "OFFLINE", "CONNECTIONBROKEN"],
    };
    object(&["connectionState"], json!({ "connectionState": one_of(states) }))
}

fn factsheet(version: Version) -> Value {
    let action = object(&["actionType"], json!({ "actionType": text() }));
    let (speed, actions) = match version {
        Version::V3_0 => ("maximumSpeed", "mobileRobotActions"),
        _ => ("speedMax", "agvActions"),
    };
    // Version 3.0 requires all parts; fleet control reads these.
    let required: &[&str] = match version {
        Version::V3_0 => &["typeSpecification", "physicalParameters", "protocolFeatures"],
        _ => &[],
    };
    object(
        required,
        json!({
            "typeSpecification": object(&[], json!({ "seriesName": text() })),
            "physicalParameters": object(&[], json!({ speed: number(), "width": number(), "length": number() })),
            "protocolFeatures": object(&[], json!({ actions: list(action) })),
        }),
    )
}

/// Checks a message. The first violation in the order of the schema counts.
///
/// # Errors
/// [`Violation`]
pub fn check(schema: &Value, message: &Value) -> Result<(), Violation> {
    check_at(schema, message, "", "")
}

fn check_at(schema: &Value, value: &Value, path: &str, rule: &str) -> Result<(), Violation> {
    let violation = |keyword: &str, problem: String| Violation {
        path: if path.is_empty() { "/".to_owned() } else { path.to_owned() },
        rule: format!("{rule}/{keyword}"),
        problem,
    };
    let kinds: Vec<&str> = match &schema["type"] {
        Value::String(kind) => vec![kind],
        Value::Array(kinds) => kinds.iter().filter_map(Value::as_str).collect(),
        _ => vec![],
    };
    if !kinds.is_empty() && !kinds.iter().any(|kind| is_of_type(value, kind)) {
        return Err(violation(
            "type",
            format!("{} is {}; allowed: {}", shown(value), kind_of(value), kinds.join(", ")),
        ));
    }
    if let Some(allowed) = schema["enum"].as_array().filter(|allowed| !allowed.contains(value)) {
        let allowed: Vec<&str> = allowed.iter().filter_map(Value::as_str).collect();
        return Err(violation("enum", format!("{} is not allowed; allowed: {}", shown(value), allowed.join(", "))));
    }
    for (keyword, beyond) in [("minimum", Ordering::Less), ("maximum", Ordering::Greater)] {
        if let (Some(limit), Some(number)) = (schema[keyword].as_f64(), value.as_f64())
            && number.partial_cmp(&limit) == Some(beyond)
        {
            return Err(violation(keyword, format!("{number} is beyond the {keyword} {limit}")));
        }
    }
    if let Some(object) = value.as_object() {
        let required = schema["required"].as_array().into_iter().flatten().filter_map(Value::as_str);
        for name in required {
            if !object.contains_key(name) {
                return Err(violation("required", format!("`{name}` is missing")));
            }
        }
        for (name, form) in schema["properties"].as_object().into_iter().flatten() {
            if let Some(value) = object.get(name) {
                check_at(form, value, &format!("{path}/{name}"), &format!("{rule}/properties/{name}"))?;
            }
        }
    }
    if let (Some(items), Some(form)) = (value.as_array(), schema.get("items")) {
        for (index, item) in items.iter().enumerate() {
            check_at(form, item, &format!("{path}/{index}"), &format!("{rule}/items"))?;
        }
    }
    Ok(())
}

fn is_of_type(value: &Value, kind: &str) -> bool {
    match kind {
        // A number without a fraction is an integer, also if it is written as 1.0.
        "integer" => value.as_f64().is_some_and(|number| number.fract() == 0.0),
        _ => kind_of(value) == kind,
    }
}

fn kind_of(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "boolean",
        Value::Number(_) => "number",
        Value::String(_) => "string",
        Value::Array(_) => "array",
        Value::Object(_) => "object",
    }
}

/// Returns the beginning of a value, for a message.
fn shown(value: &Value) -> String {
    let text = value.to_string();
    match text.char_indices().nth(40) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_violation_names_the_place_in_message_and_schema() {
        let schema = schema(Topic::Connection, Version::V2_1);
        let header =
            json!({ "headerId": 1, "timestamp": "t", "version": "2.1.0", "manufacturer": "a", "serialNumber": "b" });
        let with = |state: Value| {
            let mut message = header.clone();
            message["connectionState"] = state;
            message
        };
        assert_eq!(check(&schema, &with(json!("ONLINE"))), Ok(()));
        let error = check(&schema, &with(json!("CONNECTION_BROKEN"))).unwrap_err();
        assert_eq!(
            error.to_string(),
            "/connectionState: \"CONNECTION_BROKEN\" is not allowed; allowed: ONLINE, OFFLINE, CONNECTIONBROKEN \
             (schema: /properties/connectionState/enum)"
        );
        let error = check(&schema, &header).unwrap_err();
        assert_eq!((error.path.as_str(), error.rule.as_str()), ("/", "/required"));
        let error = check(&schema, &with(json!(7))).unwrap_err();
        assert_eq!(error.problem, "7 is number; allowed: string");
    }

    #[test]
    fn a_visualization_and_a_factsheet_of_3_0_need_what_their_official_schemas_require() {
        let header =
            json!({ "headerId": 1, "timestamp": "t", "version": "3.0.0", "manufacturer": "a", "serialNumber": "b" });
        let missing = |topic, version, message: &Value| {
            check(&schema(topic, version), message).err().map(|violation| violation.problem)
        };
        let needed = |name: &str| Some(format!("`{name}` is missing"));
        assert_eq!(missing(Topic::Visualization, Version::V2_1, &json!({})), None);
        assert_eq!(missing(Topic::Visualization, Version::V3_0, &json!({})), needed("headerId"));
        assert_eq!(missing(Topic::Visualization, Version::V3_0, &header), needed("referenceStateHeaderId"));
        assert_eq!(missing(Topic::Factsheet, Version::V2_1, &header), None);
        assert_eq!(missing(Topic::Factsheet, Version::V3_0, &header), needed("typeSpecification"));
        let mut sheet = header;
        (sheet["typeSpecification"], sheet["protocolFeatures"]) = (json!({}), json!({}));
        sheet["physicalParameters"] = json!({ "maximumSpeed": "fast" });
        let error = check(&schema(Topic::Factsheet, Version::V3_0), &sheet).unwrap_err();
        assert_eq!(error.path, "/physicalParameters/maximumSpeed");
    }

    #[test]
    fn every_topic_of_every_version_has_a_schema_with_a_header() {
        for (topic, version) in Topic::ALL.into_iter().flat_map(|topic| Version::ALL.map(|version| (topic, version))) {
            let schema = schema(topic, version);
            assert!(schema["properties"]["serialNumber"].is_object(), "{topic:?} {version}");
            assert!(check(&schema, &json!([])).is_err());
        }
    }
}
