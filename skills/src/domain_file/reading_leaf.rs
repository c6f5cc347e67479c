//! The leaf of a reading: a condition on the latest value that the driver has published.

use super::action_leaf::{port, port_type};
use super::form::{ParameterForm, ParameterKind};
use crate::bt::{Cause, LeafContext, PortSpec, Registry, RegistryError, Value};
use crate::skill::TaskContext;

const MINIMUM: &str = "minimum";
const MAXIMUM: &str = "maximum";
const EQUALS: &str = "equals";
const VALUE: &str = "value";

/// Registers the condition of a reading, whose id is the name of the reading. The condition fails while
/// the reading is unknown. A boolean without `equals` must be true.
pub(super) fn register(
    registry: &mut Registry<TaskContext>,
    name: &str,
    form: &ParameterForm,
) -> Result<(), RegistryError> {
    let kind = port_type(form.kind);
    let limits = has_limits(form.kind).then(|| [MINIMUM, MAXIMUM].map(|limit| PortSpec::input(limit, kind).optional()));
    let ports =
        limits.into_iter().flatten().chain([port(EQUALS, form).optional(), PortSpec::output(VALUE, kind).optional()]);
    let (id, kind) = (name.to_owned(), form.kind);
    registry.register_condition(name, ports.collect::<Vec<_>>(), move |leaf| holds(&id, kind, leaf))
}

fn has_limits(kind: ParameterKind) -> bool {
    matches!(kind, ParameterKind::Seconds | ParameterKind::Number | ParameterKind::Integer)
}

/// Writes the reading to the port `value`, and checks it.
fn holds(name: &str, kind: ParameterKind, leaf: &mut LeafContext<'_, '_>) -> Result<bool, Cause> {
    let reading = leaf.actions().telemetry().and_then(|telemetry| telemetry.readings.get(name)).cloned();
    let reading = reading.ok_or_else(|| Cause::new("the reading is unknown: the driver has not published it"))?;
    let value = Value::from(reading).convert(port_type(kind));
    let value = value.map_err(|error| Cause::new(format!("the reading is wrong: {error}")))?;
    leaf.write(VALUE, value.clone())?;
    let is_true = (kind == ParameterKind::Bool).then_some(Value::Bool(true));
    let expected = read(leaf, EQUALS, kind)?.or(is_true);
    if let Some(expected) = expected.filter(|expected| *expected != value) {
        return Err(Cause::new(format!("the reading is {value}, not {expected}")));
    }
    let Some(number) = number(&value) else { return Ok(true) };
    let limit = |port: &str| Ok::<_, Cause>(read(leaf, port, kind)?.as_ref().and_then(self::number));
    match (limit(MINIMUM)?, limit(MAXIMUM)?) {
        (Some(minimum), _) if number < minimum => {
            Err(Cause::new(format!("the reading is {value}, below the minimum {minimum}")))
        }
        (_, Some(maximum)) if number > maximum => {
            Err(Cause::new(format!("the reading is {value}, above the maximum {maximum}")))
        }
        _ => Ok(true),
    }
}

/// Reads a port in the type of the reading.
fn read(leaf: &LeafContext<'_, '_>, port: &str, kind: ParameterKind) -> Result<Option<Value>, Cause> {
    let value = leaf.read_optional::<Value>(port)?.map(|value| value.convert(port_type(kind))).transpose();
    value.map_err(|error| Cause::new(format!("port `{port}`: {error}")))
}

/// Returns the number of a value with limits.
fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Number(number) => Some(*number),
        Value::Integer(number) => Some(*number as f64),
        Value::Seconds(time) => Some(time.get()),
        _ => None,
    }
}
