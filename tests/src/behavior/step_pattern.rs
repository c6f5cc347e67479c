//! Step patterns: a pattern with an example and a function.

use super::fixture::Fixture;
use super::scenario_setup::ScenarioSetup;
use super::step_arguments::StepArguments;
use cucumber_expressions::Expression;
use futures::FutureExt;
use futures::future::LocalBoxFuture;
use regex::Regex;
use std::collections::HashMap;
use std::fmt;

/// Regular expressions of the parameters, by name.
const PARAMETERS: [(&str, &str); 10] = [
    ("name", r"[A-Za-z0-9_.-]+"),
    ("names", r"[A-Za-z0-9_.-]+(?:(?:, | and )[A-Za-z0-9_.-]+)*"),
    ("text", r#""[^"]*""#),
    ("number", r"-?\d+(?:\.\d+)?"),
    ("time", r"\d+(?:\.\d+)? (?:ms|s|min|h|seconds?|minutes?|hours?)"),
    ("percent", r"\d+(?:\.\d+)? ?%"),
    ("mission", r"the mission|mission [A-Za-z0-9_.-]+"),
    ("state", r"pending|running|completed|failed|canceled|in need of intervention"),
    ("person_action", r"cancels|declines|walks away"),
    ("moment", r"waiting|approached|authenticated|handing over|handed over"),
];

/// Reason why a step fails.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum StepFailure {
    /// The fact does not hold. Contains the actual state.
    NotMet(String),
    /// The step is invalid here, whatever happens.
    Invalid(String),
}

impl StepFailure {
    /// Creates an error for an invalid step.
    pub(super) fn invalid(text: impl fmt::Display) -> StepFailure {
        StepFailure::Invalid(text.to_string())
    }
}

/// Result of a step.
pub(super) type StepResult = Result<(), StepFailure>;

/// Returns `Ok` if the fact holds, otherwise the actual state.
pub(super) fn expect_that(is: bool, instead: impl FnOnce() -> String) -> StepResult {
    if is { Ok(()) } else { Err(StepFailure::NotMet(instead())) }
}

/// Future of an action.
pub(super) type ActionFuture<'a> = LocalBoxFuture<'a, Result<(), StepFailure>>;

/// Wraps the result of an immediate action.
pub(super) fn ready<'a>(done: Result<(), StepFailure>) -> ActionFuture<'a> {
    std::future::ready(done).boxed_local()
}

/// Function of a setting.
pub(super) type SettingFn = fn(&mut ScenarioSetup, &StepArguments) -> Result<(), StepFailure>;
/// Function of an action.
pub(super) type ActionFn = for<'a> fn(&'a mut Fixture, &'a StepArguments) -> ActionFuture<'a>;
/// Function of a fact.
pub(super) type FactFn = fn(&Fixture, &StepArguments) -> StepResult;

/// A step pattern.
#[derive(Debug)]
pub(super) struct StepPattern<T> {
    /// Pattern as a cucumber expression.
    pub(super) pattern: &'static str,
    /// Example with its parameters filled in.
    pub(super) example: &'static str,
    /// Function of the step.
    pub(super) function: T,
    regex: Regex,
}

impl<T: Copy> StepPattern<T> {
    /// Compiles a pattern.
    ///
    /// # Panics
    /// If the pattern is invalid, or if its example does not match. Both are constants of this
    /// program.
    pub(super) fn new(pattern: &'static str, example: &'static str, does: T) -> StepPattern<T> {
        let parameters: HashMap<&str, &str> = PARAMETERS.into();
        let regex = Expression::regex_with_parameters(pattern, &parameters)
            .unwrap_or_else(|problem| panic!("{pattern:?} is no cucumber expression: {problem}"));
        let phrase = StepPattern { pattern, example, function: does, regex };
        assert!(phrase.parse(example).is_some(), "{example:?} is no example of {pattern:?}: {}", phrase.regex);
        phrase
    }

    /// Returns the values of the parameters if the text matches.
    pub(super) fn parse(&self, text: &str) -> Option<Vec<String>> {
        let found = self.regex.captures(text)?;
        Some(found.iter().skip(1).map(|word| word.map_or(String::new(), |word| word.as_str().to_owned())).collect())
    }
}
