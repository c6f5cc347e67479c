//! Templates of messages: values in which `${…}` stands for a parameter of the goal.
//!
//! An expression that is the whole text keeps the type of its value, and converts to the type of the
//! field: a pose of the fleet to `Pose`, `PoseStamped` or `Point`, seconds to `Duration`, an angle to
//! `Quaternion`, waypoints to a list of poses. A field whose parameter the goal lacks has its default.

use super::description::Tables;
use crate::dynamic::types::{Base, Field, Shape, TypeRegistry};
use serde_json::{Map, Value, json};

/// The surroundings of a template.
#[derive(Debug, Clone)]
pub struct Scope<'a> {
    /// Parameters of the goal.
    pub parameters: &'a Map<String, Value>,
    /// Tables of the description.
    pub tables: &'a Tables,
    /// The robot.
    pub robot: &'a str,
    /// Frame of poses.
    pub frame: &'a str,
    /// The time as seconds and nanoseconds.
    pub now: (i64, u32),
}

/// A template does not fit its message.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{path}: {problem}")]
pub struct TemplateError {
    /// Path in the template.
    pub path: String,
    /// The problem.
    pub problem: String,
}

/// Returns the message of a template.
///
/// # Errors
/// [`TemplateError`] if an expression is invalid.
pub fn fill(types: &TypeRegistry, message: &str, template: &Value, scope: &Scope<'_>) -> Result<Value, TemplateError> {
    let filled = value(template, scope)?.unwrap_or(Value::Null);
    Ok(convert_message(types, message, filled, scope))
}

/// Returns the value of a template that is no message; `None` if the goal lacks its parameter.
///
/// # Errors
/// [`TemplateError`] if an expression is invalid.
pub fn value(template: &Value, scope: &Scope<'_>) -> Result<Option<Value>, TemplateError> {
    substitute(template, scope, "send")
}

/// Checks the expressions of a template, and that the message has its fields.
///
/// # Errors
/// [`TemplateError`] with the place.
pub fn check(
    types: &TypeRegistry,
    tables: &Tables,
    message: &str,
    template: &Value,
    path: &str,
) -> Result<(), TemplateError> {
    match template {
        Value::Object(entries) => {
            let fields = types.fields(message).ok();
            for (name, value) in entries {
                let path = format!("{path}.{name}");
                let Some(fields) = fields else {
                    check(types, tables, "", value, &path)?;
                    continue;
                };
                let Some(field) = fields.iter().find(|field| field.name == *name) else {
                    let allowed = fields.iter().map(|field| field.name.as_str()).collect::<Vec<_>>().join(", ");
                    return Err(TemplateError {
                        path,
                        problem: format!("{message} has no such field; allowed: {allowed}"),
                    });
                };
                let inner = match &field.base {
                    Base::Message(inner) => inner.as_str(),
                    Base::Primitive(..) => "",
                };
                check(types, tables, inner, value, &path)?;
            }
            Ok(())
        }
        Value::Array(items) => items.iter().try_for_each(|item| check(types, tables, message, item, path)),
        Value::String(text) => pieces(text, path)?.into_iter().try_for_each(|piece| match piece {
            Piece::Text(_) => Ok(()),
            Piece::Expression(expression) => check_table(&Expression::parse(expression, path)?, tables, path),
        }),
        _ => Ok(()),
    }
}

fn check_table(expression: &Expression<'_>, tables: &Tables, path: &str) -> Result<(), TemplateError> {
    match expression.table {
        Some(table) if !tables.contains_key(table) => {
            let names: Vec<&str> = tables.keys().map(String::as_str).collect();
            let problem = format!("there is no table {table:?}; the description has: {}", names.join(", "));
            Err(TemplateError { path: path.to_owned(), problem })
        }
        _ => Ok(()),
    }
}

enum Piece<'a> {
    Text(&'a str),
    Expression(&'a str),
}

fn pieces<'a>(text: &'a str, path: &str) -> Result<Vec<Piece<'a>>, TemplateError> {
    let (mut pieces, mut rest) = (vec![], text);
    while let Some((before, after)) = rest.split_once("${") {
        let (inside, after) = after.split_once('}').ok_or_else(|| TemplateError {
            path: path.to_owned(),
            problem: format!("{text:?} lacks the end of an expression; allowed is ${{parameter}}"),
        })?;
        if !before.is_empty() {
            pieces.push(Piece::Text(before));
        }
        pieces.push(Piece::Expression(inside.trim()));
        rest = after;
    }
    if !rest.is_empty() {
        pieces.push(Piece::Text(rest));
    }
    Ok(pieces)
}

/// `a.b`, `table[a.b]`, `a == text` or `a * number`.
struct Expression<'a> {
    table: Option<&'a str>,
    name: Vec<&'a str>,
    operation: Operation<'a>,
}

enum Operation<'a> {
    None,
    Equals(&'a str),
    Times(f64),
}

impl Expression<'_> {
    fn parse<'a>(text: &'a str, path: &str) -> Result<Expression<'a>, TemplateError> {
        let wrong = || TemplateError {
            path: path.to_owned(),
            problem: format!(
                "${{{text}}} is no expression; allowed is a parameter, as ${{pose}}, ${{action == open}}, \
                 ${{distance_m * -1}} or ${{table[place]}}, and ${{now}} and ${{robot}}"
            ),
        };
        let (name, operation) = if let Some((name, text)) = text.split_once("==") {
            (name.trim(), Operation::Equals(text.trim()))
        } else if let Some((name, factor)) = text.split_once('*') {
            (name.trim(), Operation::Times(factor.trim().parse().map_err(|_| wrong())?))
        } else {
            (text.trim(), Operation::None)
        };
        let (table, name) = match name.strip_suffix(']').map(|name| name.split_once('[').ok_or_else(wrong)) {
            Some(parts) => {
                let (table, name) = parts?;
                (Some(table), name)
            }
            None => (None, name),
        };
        let name: Vec<&str> = name.split('.').collect();
        let is_name = |part: &&str| {
            !part.is_empty() && part.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_')
        };
        match name.iter().chain(&table).all(is_name) {
            true => Ok(Expression { table, name, operation }),
            false => Err(wrong()),
        }
    }

    fn value(&self, scope: &Scope<'_>) -> Option<Value> {
        let value = match self.name[..] {
            ["now"] => json!({"sec": scope.now.0, "nanosec": scope.now.1}),
            ["robot"] => Value::from(scope.robot),
            _ => {
                let first = scope.parameters.get(self.name[0])?;
                let value = self.name[1..].iter().try_fold(first, |value, part| value.get(part))?;
                value.clone()
            }
        };
        let value = match self.table {
            Some(table) => scope.tables.get(table)?.get(&plain(&value))?.clone(),
            None => value,
        };
        match self.operation {
            Operation::None => Some(value).filter(|value| !value.is_null()),
            Operation::Equals(text) => Some(Value::Bool(plain(&value) == text)),
            Operation::Times(factor) => Some(Value::from(value.as_f64()? * factor)),
        }
    }
}

fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// Replaces the expressions; `None` for a missing parameter.
fn substitute(template: &Value, scope: &Scope<'_>, path: &str) -> Result<Option<Value>, TemplateError> {
    Ok(Some(match template {
        Value::Object(entries) => {
            let mut filled = Map::new();
            for (name, value) in entries {
                if let Some(value) = substitute(value, scope, &format!("{path}.{name}"))? {
                    filled.insert(name.clone(), value);
                }
            }
            Value::Object(filled)
        }
        Value::Array(items) => {
            let items = items.iter().map(|item| substitute(item, scope, path)).collect::<Result<Vec<_>, _>>()?;
            Value::Array(items.into_iter().flatten().collect())
        }
        Value::String(text) => match &pieces(text, path)?[..] {
            [Piece::Expression(expression)] => return Ok(Expression::parse(expression, path)?.value(scope)),
            pieces => {
                let mut filled = String::new();
                for piece in pieces {
                    match piece {
                        Piece::Text(text) => filled.push_str(text),
                        Piece::Expression(expression) => match Expression::parse(expression, path)?.value(scope) {
                            Some(value) => filled.push_str(&plain(&value)),
                            None => return Ok(None),
                        },
                    }
                }
                Value::String(filled)
            }
        },
        other => other.clone(),
    }))
}

fn convert_message(types: &TypeRegistry, message: &str, value: Value, scope: &Scope<'_>) -> Value {
    let entries = match as_message(message, value, scope) {
        Value::Object(entries) => entries,
        // Its bytes cannot be written, and the error names the place.
        other => return other,
    };
    let fields = types.fields(message).unwrap_or_default();
    let converted = entries.into_iter().map(|(name, value)| {
        let value = match fields.iter().find(|field| field.name == name) {
            Some(field) => convert_field(types, field, value, scope),
            None => value,
        };
        (name, value)
    });
    Value::Object(converted.collect())
}

fn convert_field(types: &TypeRegistry, field: &Field, value: Value, scope: &Scope<'_>) -> Value {
    let Base::Message(inner) = &field.base else { return value };
    match (field.shape, value) {
        (Shape::Single, value) => convert_message(types, inner, value, scope),
        (_, Value::Array(items)) => items.into_iter().map(|item| convert_message(types, inner, item, scope)).collect(),
        (_, other) => other,
    }
}

/// Converts a value of the fleet to a message.
fn as_message(message: &str, value: Value, scope: &Scope<'_>) -> Value {
    // A waypoint contains its pose.
    let is_pose =
        matches!(message, "geometry_msgs/msg/Point" | "geometry_msgs/msg/Pose" | "geometry_msgs/msg/PoseStamped");
    let value = match value.get("pose") {
        Some(pose) if is_pose && pose.get("x_m").is_some() && value.get("header").is_none() => pose.clone(),
        _ => value,
    };
    let number = value.as_f64();
    let at = |name: &str| value.get(name).and_then(Value::as_f64);
    match (message, at("x_m").zip(at("y_m")), number) {
        ("geometry_msgs/msg/Point", Some((x, y)), _) => json!({"x": x, "y": y}),
        ("geometry_msgs/msg/Pose", Some((x, y)), _) => {
            json!({"position": {"x": x, "y": y}, "orientation": at("yaw_rad").unwrap_or_default()})
        }
        ("geometry_msgs/msg/PoseStamped", Some(_), _) => {
            let stamp = json!({"sec": scope.now.0, "nanosec": scope.now.1});
            json!({"header": {"frame_id": scope.frame, "stamp": stamp}, "pose": value})
        }
        ("geometry_msgs/msg/Quaternion", _, Some(yaw)) => {
            let (z, w) = (yaw / 2.0).sin_cos();
            json!({"x": 0.0, "y": 0.0, "z": z, "w": w})
        }
        ("builtin_interfaces/msg/Duration", _, Some(seconds)) => {
            let duration = crate::mapping::duration(seconds);
            json!({"sec": duration.sec, "nanosec": duration.nanosec})
        }
        _ => value,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamic::cdr;

    fn filled(message: &str, template: Value, parameters: Value) -> Value {
        let types = TypeRegistry::shipped();
        let parameters = parameters.as_object().unwrap();
        let tables = [("floor".to_owned(), [("Hall".to_owned(), json!("L1"))].into())].into();
        let scope = Scope { parameters, tables: &tables, robot: "ada", frame: "map", now: (5, 6) };
        check(&types, &tables, message, &template, "send").unwrap();
        let message_value = fill(&types, message, &template, &scope).unwrap();
        cdr::decode(&types, message, &cdr::encode(&types, message, &message_value).unwrap()).unwrap()
    }

    #[test]
    fn poses_durations_and_lists_convert_to_the_type_of_the_field() {
        let goal = filled(
            "nav2_msgs/action/FollowWaypoints_Goal",
            json!({"poses": "${waypoints}"}),
            json!({"waypoints": [{"pose": {"x_m": 1.0, "y_m": 2.0, "yaw_rad": 0.0}, "place": "Dock"}]}),
        );
        assert_eq!(goal["poses"][0]["pose"]["position"], json!({"x": 1.0, "y": 2.0, "z": 0.0}));
        assert_eq!(goal["poses"][0]["pose"]["orientation"]["w"], 1.0);
        assert_eq!(goal["poses"][0]["header"], json!({"frame_id": "map", "stamp": {"sec": 5, "nanosec": 6}}));
        let pose = json!({"pose": {"x_m": 1.0, "y_m": 2.0, "yaw_rad": 0.0}});
        let goal = filled("nav2_msgs/action/NavigateToPose_Goal", json!({"pose": "${pose}"}), pose.clone());
        assert_eq!(goal["pose"]["pose"]["position"]["y"], 2.0);
        assert_eq!(goal["pose"]["header"]["frame_id"], "map");
        let odom = json!({"header": {"frame_id": "odom"}, "pose": "${pose}"});
        let stamped = filled("geometry_msgs/msg/PoseStamped", odom, pose);
        assert_eq!((&stamped["header"]["frame_id"], &stamped["pose"]["position"]["x"]), (&json!("odom"), &json!(1.0)));
        let goal = filled("nav2_msgs/action/Wait_Goal", json!({"time": "${time}"}), json!({"time": 1.5}));
        assert_eq!(goal["time"], json!({"sec": 1, "nanosec": 500_000_000}));
    }

    #[test]
    fn expressions_compare_multiply_and_interpolate() {
        let on =
            filled("std_srvs/srv/SetBool_Request", json!({"data": "${action == open}"}), json!({"action": "open"}));
        assert_eq!(on["data"], true);
        let text = filled("std_msgs/msg/String", json!({"data": "${robot}: ${dose * 2} ml"}), json!({"dose": 1.5}));
        assert_eq!(text["data"], "ada: 3.0 ml");
        let text = |place: &str| {
            filled("std_msgs/msg/String", json!({"data": "${floor[place]}"}), json!({"place": place}))["data"].clone()
        };
        assert_eq!((text("Hall"), text("Roof")), (json!("L1"), json!("")), "a table");
    }

    #[test]
    fn a_missing_parameter_leaves_the_default() {
        let goal =
            filled("nav2_msgs/action/DockRobot_Goal", json!({"dock_id": "${charger}"}), json!({"charger": null}));
        assert_eq!((&goal["dock_id"], &goal["use_dock_id"]), (&json!(""), &json!(true)));
    }

    #[test]
    fn wrong_templates_are_rejected_with_their_place() {
        let error = |template: Value| {
            let types = TypeRegistry::shipped();
            let (message, path) = ("nav2_msgs/action/DockRobot_Goal", "actions.dock.send");
            check(&types, &Tables::new(), message, &template, path).unwrap_err().to_string()
        };
        assert!(error(json!({"dock": "x"})).starts_with(
            "actions.dock.send.dock: nav2_msgs/action/DockRobot_Goal has no such field; allowed: use_dock_id"
        ));
        assert!(error(json!({"dock_id": "${charger"})).contains("lacks the end of an expression"));
        assert!(error(json!({"dock_pose": {"pose": "${a b}"}})).contains("is no expression"));
        assert!(error(json!({"dock_id": "${a]}"})).contains("is no expression"));
        assert!(error(json!({"dock_id": "${floor[place]}"})).contains("there is no table \"floor\""));
    }
}
