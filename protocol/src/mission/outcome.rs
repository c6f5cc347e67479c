//! Outcomes of tasks: their results, or that they were skipped.

use crate::bounds::limit_text;
use crate::ids::TaskId;
use crate::scalar::{SCALAR_BYTES_MAX, Scalar};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Maximum number of results of a task.
pub const RESULTS_MAX: usize = 16;

/// Maximum size of the outcomes of a mission in bytes: a report contains those of a role, and its reply
/// those that a role uses. The recovery branch has as many again.
pub(crate) const OUTCOMES_BYTES_MAX: usize = 8 * 1024;

/// Outcome of an elementary task that has ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TaskOutcome {
    /// Its condition did not hold.
    Skipped,
    /// Executed, with its results by name.
    Done(BTreeMap<String, Scalar>),
}

/// Outcomes of the tasks of a mission. A task without results has an outcome only if it was skipped,
/// or if another task refers to it.
pub type TaskOutcomes = BTreeMap<TaskId, TaskOutcome>;

impl TaskOutcome {
    /// Returns the outcome with its results reduced to [`RESULTS_MAX`] and its texts to
    /// [`SCALAR_BYTES_MAX`].
    #[must_use]
    pub fn limited(self) -> TaskOutcome {
        let TaskOutcome::Done(results) = self else { return self };
        let mut results: BTreeMap<_, _> = results.into_iter().take(RESULTS_MAX).collect();
        for value in results.values_mut() {
            if let Scalar::Text(text) = value {
                limit_text(text, SCALAR_BYTES_MAX);
            }
        }
        TaskOutcome::Done(results)
    }

    /// Returns the results; `None` for a skipped task.
    pub fn results(&self) -> Option<&BTreeMap<String, Scalar>> {
        match self {
            TaskOutcome::Skipped => None,
            TaskOutcome::Done(results) => Some(results),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_outcome_has_a_bounded_size() {
        let long = Scalar::Text("x".repeat(10 * SCALAR_BYTES_MAX));
        let results = (0..100).map(|number| (format!("r{number}"), long.clone())).collect();
        let TaskOutcome::Done(results) = TaskOutcome::Done(results).limited() else { panic!("the task was executed") };
        assert_eq!(results.len(), RESULTS_MAX);
        assert!(results.values().all(|value| value.to_string().len() <= SCALAR_BYTES_MAX));
    }
}
