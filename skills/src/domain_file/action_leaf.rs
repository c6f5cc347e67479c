//! The leaf of a declared action.

use super::form::{ActionForm, ParameterForm, ParameterKind};
use crate::actions::{Goal, JsonObject};
use crate::bt::{
    Cause, Leaf, LeafContext, NodeKind, NodeManifest, PortSpec, PortType, PortValue, Registry, RegistryError, Value,
};
use crate::skill::{GoalLeaf, RetryLeaf, TaskContext};
use consort_protocol::ids::ActionName;
use consort_protocol::pose::Pose;
use serde_json::json;
use std::sync::Arc;

/// Registers the leaf of an action: its id is the name of the action, its ports are the parameters.
pub(super) fn register(
    registry: &mut Registry<TaskContext>,
    action: &ActionName,
    form: &ActionForm,
) -> Result<(), RegistryError> {
    let results: Arc<[(String, PortType)]> =
        form.results.iter().map(|(name, result)| (name.clone(), port_type(result.kind))).collect();
    let inputs = form.parameters.iter().map(|(name, parameter)| port(name, parameter));
    let outputs = results.iter().map(|(name, port_type)| PortSpec::output(name, *port_type).optional());
    let ports: Vec<PortSpec> = inputs.chain(form.retry.iter().map(|_| RetryLeaf::port())).chain(outputs).collect();
    let (action, form) = (action.clone(), Arc::new(form.clone()));
    registry.register(NodeManifest::new(action.as_str(), NodeKind::Action, ports), move |_: &TaskContext| {
        let (action, own) = (action.clone(), Arc::clone(&form));
        let goal = GoalLeaf::new(move |leaf| {
            let parameters = parameters(&own, leaf)?;
            Ok(Goal {
                action: action.clone(),
                parameters,
                repeatable: own.repeatable,
                hands_over: own.hands_over,
                since: None,
            })
        });
        let goal = goal.with_results(Arc::clone(&results));
        let leaf: Box<dyn Leaf> = match &form.retry {
            Some(retry) => Box::new(RetryLeaf::new(goal, retry.on, retry.timeout_s)),
            None => Box::new(goal),
        };
        leaf
    })
}

/// Returns the input port of a value.
pub(super) fn port(name: &str, parameter: &ParameterForm) -> PortSpec {
    let port = PortSpec::input(name, port_type(parameter.kind));
    let port = if parameter.optional { port.optional() } else { port };
    let texts: Vec<&str> = parameter.one_of.iter().map(String::as_str).collect();
    match (parameter.minimum, parameter.maximum) {
        (None, None) if texts.is_empty() => port,
        (None, None) => port.one_of(&texts),
        (minimum, maximum) => port.in_range(minimum.unwrap_or(f64::MIN), maximum.unwrap_or(f64::MAX)),
    }
}

pub(super) fn port_type(kind: ParameterKind) -> PortType {
    match kind {
        ParameterKind::Place => PortType::Place,
        ParameterKind::Role => PortType::Role,
        ParameterKind::Seconds => PortType::Seconds,
        ParameterKind::Number => PortType::Number,
        ParameterKind::Integer => PortType::Integer,
        ParameterKind::Bool => PortType::Bool,
        ParameterKind::Text => PortType::Text,
        ParameterKind::Robot => PortType::Robot,
        ParameterKind::Pose => PortType::Pose,
        ParameterKind::Waypoints | ParameterKind::Points => PortType::List,
    }
}

/// Returns the parameters of a goal from the ports of its leaf.
fn parameters(form: &ActionForm, leaf: &mut LeafContext<'_, '_>) -> Result<JsonObject, Cause> {
    let mut parameters = JsonObject::new();
    for (name, parameter) in &form.parameters {
        let value = match parameter.kind {
            ParameterKind::Place => leaf.read_optional(name)?.map(Value::Place),
            ParameterKind::Role => leaf.read_optional(name)?.map(Value::Role),
            ParameterKind::Seconds => leaf.read_optional(name)?.map(Value::Seconds),
            ParameterKind::Number => leaf.read_optional(name)?.map(Value::Number),
            ParameterKind::Integer => leaf.read_optional(name)?.map(Value::Integer),
            ParameterKind::Bool => leaf.read_optional(name)?.map(Value::Bool),
            ParameterKind::Text => leaf.read_optional(name)?.map(Value::Text),
            ParameterKind::Robot => leaf.read_optional(name)?.map(Value::Robot),
            ParameterKind::Pose => {
                if let Some(pose) = leaf.read_optional::<Pose>(name)? {
                    parameters.insert(name.clone(), json!(pose));
                }
                None
            }
            ParameterKind::Points => leaf.read_optional(name)?.map(Value::List),
            ParameterKind::Waypoints => {
                if let Some(poses) = leaf.read_optional::<Vec<Value>>(name)? {
                    parameters.insert(name.clone(), waypoints(poses)?);
                }
                None
            }
        };
        if let Some(value) = value {
            parameters.insert(name.clone(), value.to_json());
        }
    }
    Ok(parameters)
}

/// Returns poses as waypoints without places.
fn waypoints(poses: Vec<Value>) -> Result<serde_json::Value, Cause> {
    let waypoint = |value: Value| {
        let pose = value.convert(PortType::Pose).map_err(|error| Cause::new(error.to_string()))?;
        Ok(json!({ "pose": Pose::from_value(pose).expect("converted to a pose") }))
    };
    poses.into_iter().map(waypoint).collect()
}
