//! Comparison of two values, with the conversions of BehaviorTree.CPP.

use crate::bt::value::PortType;
use cel::{ExecutionError, Value};
use std::cmp::Ordering;

/// Name of the comparison in the interpreter.
pub(super) const COMPARE: &str = "compare";

/// Compares two values: -1 for less, 0 for equal, 1 for greater. A text beside a number or a
/// boolean is parsed as such. A boolean beside a number is 1 or 0.
///
/// # Errors
/// [`ExecutionError::FunctionError`] if the text does not parse, or a number is not a number (NaN).
pub(super) fn compare(left: Value, right: Value) -> Result<Value, ExecutionError> {
    let ordering = match (&left, &right) {
        (Value::Float(left), Value::Float(right)) => left.partial_cmp(right),
        (Value::Bool(left), Value::Bool(right)) => Some(left.cmp(right)),
        (Value::String(left), Value::String(right)) => Some(left.cmp(right)),
        _ => number(&left, &right)?.partial_cmp(&number(&right, &left)?),
    };
    let reject = || ExecutionError::function_error(COMPARE, format!("{left:?} and {right:?} cannot be compared"));
    Ok(Value::Float(match ordering.ok_or_else(reject)? {
        Ordering::Less => -1.0,
        Ordering::Equal => 0.0,
        Ordering::Greater => 1.0,
    }))
}

/// Returns a value as a number, for the comparison with a value of another type.
fn number(value: &Value, other: &Value) -> Result<f64, ExecutionError> {
    let parse = |text: &str, port_type: PortType| {
        port_type.parse(text).map_err(|error| ExecutionError::function_error(COMPARE, error))
    };
    let converted = match (value, other) {
        (Value::Float(number), _) => return Ok(*number),
        (Value::Bool(yes), _) => return Ok(f64::from(u8::from(*yes))),
        (Value::String(text), Value::Bool(_)) => parse(text, PortType::Bool)?,
        (Value::String(text), _) => parse(text, PortType::Number)?,
        _ => return Err(ExecutionError::function_error(COMPARE, format!("{value:?} cannot be compared"))),
    };
    Ok(match converted {
        crate::bt::value::Value::Bool(yes) => f64::from(u8::from(yes)),
        crate::bt::value::Value::Number(number) => number,
        _ => f64::NAN,
    })
}
