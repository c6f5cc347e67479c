//! Result of a step.

use std::fmt;

/// Reason why a step fails.
#[derive(Debug, Clone, PartialEq)]
pub enum StepFailure {
    /// The fact does not hold. Contains the actual state.
    NotMet(String),
    /// The step is invalid here, whatever happens.
    Invalid(String),
}

impl StepFailure {
    /// Creates an error for an invalid step.
    pub fn invalid(text: impl fmt::Display) -> StepFailure {
        StepFailure::Invalid(text.to_string())
    }
}

/// Result of a step.
pub type StepResult = Result<(), StepFailure>;

/// Returns `Ok` if the fact holds, otherwise the actual state.
pub fn expect_that(is: bool, instead: impl FnOnce() -> String) -> StepResult {
    if is { Ok(()) } else { Err(StepFailure::NotMet(instead())) }
}
