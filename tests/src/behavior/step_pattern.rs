//! Step patterns: the phrase of a step as a cucumber expression, an example, and the function of
//! the step.
//!
//! Each step is a Rust function that returns its pattern, so that phrase and code stand together:
//!
//! ```text
//! fn is_docked() -> FactStep {
//!     fact("{name} is docked", "amber is docked", |fixture, arguments| …)
//! }
//! ```

use super::fixture::Fixture;
use super::scenario_setup::ScenarioSetup;
use super::step_arguments::StepArguments;
use super::step_result::StepResult;
use cucumber_expressions::Expression;
use futures::FutureExt;
use futures::future::LocalBoxFuture;
use regex::Regex;
use std::collections::HashMap;
use std::fmt;

/// Regular expressions of the parameters, by name.
const PARAMETERS: [(&str, &str); 11] = [
    ("name", r"[A-Za-z0-9_.-]+"),
    ("names", r"[A-Za-z0-9_.-]+(?:(?:, | and )[A-Za-z0-9_.-]+)*"),
    ("text", r#""[^"]*""#),
    ("number", r"-?\d+(?:\.\d+)?"),
    ("value", r#""[^"]*"|true|false|-?\d+(?:\.\d+)?"#),
    ("time", r"\d+(?:\.\d+)? (?:ms|s|min|h|seconds?|minutes?|hours?)"),
    ("percent", r"\d+(?:\.\d+)? ?%"),
    ("mission", r"the mission|mission [A-Za-z0-9_.-]+"),
    ("state", r"pending|running|completed|failed|canceled|in need of intervention"),
    ("person_action", r"cancels|declines|walks away"),
    ("moment", r"waiting|approached|authenticated|handing over|handed over"),
];

/// Future of an action.
pub(super) type ActionFuture<'a> = LocalBoxFuture<'a, StepResult>;

/// Function of a setting.
pub(super) type SettingFn = fn(&mut ScenarioSetup, &StepArguments) -> StepResult;
/// Function of an action.
pub(super) type ActionFn = Box<dyn for<'a> Fn(&'a mut Fixture, &'a StepArguments) -> ActionFuture<'a> + Send + Sync>;
/// Function of a fact.
pub type FactFn = fn(&Fixture, &StepArguments) -> StepResult;

/// A setting with its phrase.
pub(super) type SettingStep = StepPattern<SettingFn>;
/// An action with its phrase.
pub(super) type ActionStep = StepPattern<ActionFn>;
/// A fact with its phrase.
pub(super) type FactStep = StepPattern<FactFn>;

/// Defines a setting.
pub(super) fn setting(pattern: &'static str, example: &'static str, function: SettingFn) -> SettingStep {
    StepPattern::new(pattern, example, function)
}

/// Defines an action.
pub(super) fn action<F>(pattern: &'static str, example: &'static str, function: F) -> ActionStep
where
    F: AsyncFn(&mut Fixture, &StepArguments) -> StepResult + Copy + Send + Sync + 'static,
{
    let boxed: ActionFn =
        Box::new(move |fixture, arguments| async move { function(fixture, arguments).await }.boxed_local());
    StepPattern::new(pattern, example, boxed)
}

/// Defines a fact.
pub(super) fn fact(pattern: &'static str, example: &'static str, function: FactFn) -> FactStep {
    StepPattern::new(pattern, example, function)
}

/// A step pattern.
pub(super) struct StepPattern<T> {
    /// Pattern as a cucumber expression.
    pub(super) pattern: &'static str,
    /// Example with its parameters filled in.
    pub(super) example: &'static str,
    /// Function of the step.
    pub(super) function: T,
    regex: Regex,
}

impl<T> fmt::Debug for StepPattern<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.pattern)
    }
}

impl<T> StepPattern<T> {
    /// Compiles a pattern.
    ///
    /// # Panics
    /// If the pattern is invalid, or if its example does not match. Both are constants of this
    /// program.
    pub(super) fn new(pattern: &'static str, example: &'static str, function: T) -> StepPattern<T> {
        let parameters: HashMap<&str, &str> = PARAMETERS.into();
        let regex = Expression::regex_with_parameters(pattern, &parameters)
            .unwrap_or_else(|problem| panic!("{pattern:?} is no cucumber expression: {problem}"));
        let step = StepPattern { pattern, example, function, regex };
        assert!(step.parse(example).is_some(), "{example:?} is no example of {pattern:?}: {}", step.regex);
        step
    }

    /// Returns the values of the parameters if the text matches.
    pub(super) fn parse(&self, text: &str) -> Option<Vec<String>> {
        let found = self.regex.captures(text)?;
        Some(found.iter().skip(1).map(|word| word.map_or(String::new(), |word| word.as_str().to_owned())).collect())
    }
}
