//! Expressions over the results of earlier tasks: conditions of tasks, and results of missions.
//!
//! An expression is in CEL. Each task whose results it uses is a variable: `inspect.dust_g > 5.0`. The
//! results of a task are unknown while it has no outcome, and if it was skipped. An expression has a value
//! all the same if the operators `&&`, `||` or `?:` do not need them: `false && mop.passes > 1` is false.

use super::outcome::{TaskOutcome, TaskOutcomes};
use crate::expression::{self, cel_value, compile, fields_used};
use crate::ids::TaskId;
use crate::scalar::Scalar;
use cel::objects::{Key, Map};
use cel::{ExecutionError, Value};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

/// Returns the tasks whose results an expression uses.
///
/// # Errors
/// Description of the problem: the text is not an expression, or it is too long or too complex.
pub(crate) fn tasks_used(text: &str) -> Result<BTreeSet<TaskId>, String> {
    let program = compile(text)?;
    let references = program.references();
    let names = references.variables();
    let task = |name: &&str| TaskId::new(*name).map_err(|problem| format!("`{name}`: {problem}"));
    names.iter().map(task).collect()
}

/// Returns the results that an expression uses, each with its task. The result is `None` where a task is
/// used as a whole.
///
/// # Errors
/// As [`tasks_used`].
pub(crate) fn results_used(text: &str) -> Result<BTreeSet<(TaskId, Option<String>)>, String> {
    let tasks = tasks_used(text)?;
    let fields = fields_used(compile(text)?.expression());
    let of_task = |task: TaskId| {
        let of_it = fields.iter().filter(|(name, _)| name == task.as_str());
        let mut used: Vec<_> = of_it.map(|(_, field)| (task.clone(), Some(field.clone()))).collect();
        if used.is_empty() {
            used.push((task, None));
        }
        used
    };
    Ok(tasks.into_iter().flat_map(of_task).collect())
}

/// Evaluates a condition to true or false.
///
/// # Errors
/// Description of the problem, with the condition: an unknown result decides, or the value is neither true
/// nor false.
pub(crate) fn holds(text: &str, outcomes: &TaskOutcomes) -> Result<bool, String> {
    match execute(text, outcomes).map_err(|problem| format!("`{text}`: {problem}"))? {
        Value::Bool(holds) => Ok(holds),
        other => Err(format!("`{text}` is {other:?}; allowed is true or false")),
    }
}

/// Evaluates an expression to a value.
///
/// # Errors
/// Description of the problem: an unknown result decides, or the value is a list or a map.
pub(crate) fn value(text: &str, outcomes: &TaskOutcomes) -> Result<Scalar, String> {
    match execute(text, outcomes)? {
        Value::Bool(value) => Ok(Scalar::Bool(value)),
        Value::Int(number) => Ok(Scalar::Integer(number)),
        Value::UInt(number) => Ok(i64::try_from(number).map_or(Scalar::Number(number as f64), Scalar::Integer)),
        Value::Float(number) if number.is_finite() => Ok(Scalar::Number(number)),
        Value::String(text) => Ok(Scalar::Text(text.to_string())),
        other => Err(format!("the value is {other:?}; allowed is a boolean, a finite number or a text")),
    }
}

fn execute(text: &str, outcomes: &TaskOutcomes) -> Result<Value, String> {
    let program = compile(text)?;
    let references = program.references();
    let mut context = expression::variables();
    // The variables of these tasks stay undeclared, which is an error only where the value depends on them.
    let mut unknown = BTreeMap::new();
    for name in references.variables() {
        let task = TaskId::new(name).map_err(|problem| problem.to_string())?;
        match outcomes.get(&task) {
            Some(TaskOutcome::Done(results)) => {
                let entries = results.iter().map(|(name, value)| (Key::from(name.as_str()), cel_value(value)));
                let map = Arc::new(entries.collect::<HashMap<Key, Value>>());
                context.add_variable_from_value(name, Value::Map(Map { map }));
            }
            Some(TaskOutcome::Skipped) => drop(unknown.insert(name, "it was skipped")),
            None => drop(unknown.insert(name, "it has not ended")),
        }
    }
    program.execute(&context).map_err(|problem| {
        let task = match &problem {
            ExecutionError::UndeclaredReference(name) => unknown.get_key_value(name.as_str()),
            _ => None,
        };
        task.map_or_else(|| problem.to_string(), |(task, why)| format!("the results of {task} are unknown: {why}"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::expression::EXPRESSION_BYTES_MAX;

    fn outcomes() -> TaskOutcomes {
        let results = serde_json::json!({ "dust_g": 7.5, "count": 3, "clean": false, "colour": "red" });
        let done = TaskOutcome::Done(serde_json::from_value(results).unwrap());
        [("inspect", done), ("mop", TaskOutcome::Skipped)]
            .map(|(task, outcome)| (task.parse().unwrap(), outcome))
            .into()
    }

    #[test]
    fn conditions_use_the_results_of_tasks() {
        for (text, expected) in [
            ("inspect.dust_g > 5.0 && !inspect.clean", true),
            ("inspect.count >= 4 || inspect.colour == 'blue'", false),
            ("true", true),
        ] {
            assert_eq!(holds(text, &outcomes()), Ok(expected), "{text}");
        }
        assert_eq!(value("inspect.dust_g * 2.0", &outcomes()), Ok(Scalar::Number(15.0)));
        assert_eq!(value("inspect.count", &outcomes()), Ok(Scalar::Integer(3)));
        let used = tasks_used("inspect.dust_g > 5.0 && mop.passes < 2").unwrap();
        assert_eq!(used.iter().map(TaskId::as_str).collect::<Vec<_>>(), ["inspect", "mop"]);
    }

    #[test]
    fn an_unknown_result_is_no_error_if_the_value_does_not_depend_on_it() {
        for (text, expected) in [
            ("inspect.clean && mop.passes > 1", false),
            ("mop.passes > 1 && inspect.clean", false),
            ("inspect.count == 3 || dry.time > 1", true),
            ("dry.time > 1 || inspect.count == 3", true),
            ("!(mop.passes > 1 && inspect.clean)", true),
            ("inspect.clean ? mop.passes > 1 : inspect.count == 3", true),
        ] {
            assert_eq!(holds(text, &outcomes()), Ok(expected), "{text}");
        }
        assert_eq!(value("inspect.clean ? mop.passes : inspect.count", &outcomes()), Ok(Scalar::Integer(3)));
    }

    #[test]
    fn an_unknown_result_is_an_error_that_names_it() {
        for (text, part) in [
            ("mop.passes > 1", "`mop.passes > 1`: the results of mop are unknown: it was skipped"),
            ("dry.time > 1", "the results of dry are unknown: it has not ended"),
            ("inspect.count == 3 && mop.passes > 1", "the results of mop are unknown: it was skipped"),
            ("mop.passes > 1 || inspect.clean", "the results of mop are unknown: it was skipped"),
            ("mop.passes > 1 ? true : true", "the results of mop are unknown: it was skipped"),
            ("mop == mop", "the results of mop are unknown: it was skipped"),
            ("has(mop.passes)", "the results of mop are unknown: it was skipped"),
            ("inspect.size > 1", "size"),
            ("inspect.dust_g", "allowed is true or false"),
            ("inspect.dust_g > 'much'", "`inspect.dust_g > 'much'`"),
        ] {
            let problem = holds(text, &outcomes()).unwrap_err();
            assert!(problem.contains(part), "{text}: {problem}");
        }
        assert!(tasks_used("inspect.dust_g >").is_err());
        assert!(tasks_used(&"1 + ".repeat(EXPRESSION_BYTES_MAX)).is_err());
    }
}
