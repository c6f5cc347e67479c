//! The leaf of a declared action.

use super::form::{ActionForm, ParameterForm, ParameterKind};
use crate::actions::{DeclaredGoal, Goal, JsonObject};
use crate::bt::{Cause, LeafContext, PortSpec, PortType, Registry, RegistryError, Value};
use crate::skill::{GoalLeaf, TaskContext};
use consort_protocol::ids::ActionName;

/// Registers the leaf of an action: its id is the name of the action, its ports are the parameters.
pub(super) fn register(
    registry: &mut Registry<TaskContext>,
    action: &ActionName,
    form: &ActionForm,
) -> Result<(), RegistryError> {
    let ports = form.parameters.iter().map(|(name, parameter)| port(name, parameter));
    let (action, form) = (action.clone(), form.clone());
    let id = action.to_string();
    let results = form.results.iter().map(|(name, result)| (name.clone(), port_type(result.kind))).collect::<Vec<_>>();
    GoalLeaf::register_with_results(registry, &id, ports.collect::<Vec<_>>(), results, move |_: &TaskContext, leaf| {
        let parameters = parameters(&form, leaf)?;
        Ok(Goal::Declared(DeclaredGoal { action: action.clone(), parameters, repeatable: form.repeatable }))
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
        };
        if let Some(value) = value {
            parameters.insert(name.clone(), value.to_json());
        }
    }
    Ok(parameters)
}
