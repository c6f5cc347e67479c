//! Conditions on a value: the ports `equals`, `minimum` and `maximum`, and the port `value` to which the
//! value is written.

use crate::bt::{Cause, LeafContext, Value};

pub(crate) const MINIMUM: &str = "minimum";
pub(crate) const MAXIMUM: &str = "maximum";
pub(crate) const EQUALS: &str = "equals";
pub(crate) const VALUE: &str = "value";

/// Writes a value to the port `value`, and checks it against the other ports. A boolean without `equals`
/// must be true. Only numbers have limits. `found` begins the cause, as `the reading is 3,`.
pub(crate) fn value_holds(found: &str, value: &Value, leaf: &mut LeafContext<'_, '_>) -> Result<bool, Cause> {
    leaf.write(VALUE, value.clone())?;
    let is_true = matches!(value, Value::Bool(_)).then_some(Value::Bool(true));
    let expected = read(leaf, EQUALS, value)?.or(is_true);
    if let Some(expected) = expected.filter(|expected| expected != value) {
        return Err(Cause::new(format!("{found} not {expected}")));
    }
    let Some(number) = number(value) else { return Ok(true) };
    let limit = |port: &str| Ok::<_, Cause>(read(leaf, port, value)?.as_ref().and_then(self::number));
    match (limit(MINIMUM)?, limit(MAXIMUM)?) {
        (Some(minimum), _) if number < minimum => Err(Cause::new(format!("{found} below the minimum {minimum}"))),
        (_, Some(maximum)) if number > maximum => Err(Cause::new(format!("{found} above the maximum {maximum}"))),
        _ => Ok(true),
    }
}

/// Reads a port in the type of the value.
fn read(leaf: &LeafContext<'_, '_>, port: &str, value: &Value) -> Result<Option<Value>, Cause> {
    let found = leaf.read_optional::<Value>(port)?.map(|found| found.convert(value.port_type())).transpose();
    found.map_err(|error| Cause::new(format!("port `{port}`: {error}")))
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
