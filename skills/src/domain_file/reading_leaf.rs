//! The leaf of a reading: a condition on the latest value that the driver has published.

use super::action_leaf::{port, port_type};
use super::form::{ParameterForm, ParameterKind};
use crate::bt::{Cause, LeafContext, PortSpec, Registry, RegistryError, Value};
use crate::skill::{EQUALS, MAXIMUM, MINIMUM, TaskContext, VALUE, value_holds};

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

fn holds(name: &str, kind: ParameterKind, leaf: &mut LeafContext<'_, '_>) -> Result<bool, Cause> {
    let reading = leaf.actions().telemetry().and_then(|telemetry| telemetry.readings.get(name)).cloned();
    let reading = reading.ok_or_else(|| Cause::new("the reading is unknown: the driver has not published it"))?;
    let value = Value::from(reading).convert(port_type(kind));
    let value = value.map_err(|error| Cause::new(format!("the reading is wrong: {error}")))?;
    value_holds(&format!("the reading is {value},"), &value, leaf)
}
