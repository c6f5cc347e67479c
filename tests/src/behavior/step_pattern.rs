//! A phrase: what may be said, as a pattern with an example, and what it does.

use super::fixture::Fixture;
use super::scenario_setup::ScenarioSetup;
use super::step_arguments::StepArguments;
use cucumber_expressions::Expression;
use futures::FutureExt;
use futures::future::LocalBoxFuture;
use regex::Regex;
use std::collections::HashMap;
use std::fmt;

/// What may stand for a parameter, by its name in braces.
const PARAMETERS: [(&str, &str); 10] = [
    ("name", r"[A-Za-z0-9_.-]+"),
    ("names", r"[A-Za-z0-9_.-]+(?:(?:, | and )[A-Za-z0-9_.-]+)*"),
    ("text", r#""[^"]*""#),
    ("number", r"-?\d+(?:\.\d+)?"),
    ("time", r"\d+(?:\.\d+)? (?:ms|s|min|h|seconds?|minutes?|hours?)"),
    ("percent", r"\d+(?:\.\d+)? ?%"),
    ("mission", r"the mission|mission [A-Za-z0-9_.-]+"),
    ("state", r"pending|running|completed|failed|canceled|in need of rescue"),
    ("deed", r"cancels|declines|walks away"),
    ("moment", r"waiting|approached|authenticated|handing over|handed over"),
];

/// Why a step does not pass.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum StepFailure {
    /// It is not so: how it is instead.
    NotMet(String),
    /// It makes no sense here, whatever happens.
    Invalid(String),
}

impl StepFailure {
    /// What is said about it.
    pub(super) fn invalid(text: impl fmt::Display) -> StepFailure {
        StepFailure::Invalid(text.to_string())
    }
}

/// Whether something is so.
pub(super) type StepResult = Result<(), StepFailure>;

/// `Ok` if it is so, else how it is instead.
pub(super) fn expect_that(is: bool, instead: impl FnOnce() -> String) -> StepResult {
    if is { Ok(()) } else { Err(StepFailure::NotMet(instead())) }
}

/// What something that takes time comes to.
pub(super) type ActionFuture<'a> = LocalBoxFuture<'a, Result<(), StepFailure>>;

/// What was done at once.
pub(super) fn ready<'a>(done: Result<(), StepFailure>) -> ActionFuture<'a> {
    std::future::ready(done).boxed_local()
}

/// What is said before anything happens.
pub(super) type SettingFn = fn(&mut ScenarioSetup, &StepArguments) -> Result<(), StepFailure>;
/// What is done.
pub(super) type ActionFn = for<'a> fn(&'a mut Fixture, &'a StepArguments) -> ActionFuture<'a>;
/// What is looked at.
pub(super) type FactFn = fn(&Fixture, &StepArguments) -> StepResult;

/// Something that may be said.
#[derive(Debug)]
pub(super) struct StepPattern<T> {
    /// As a cucumber expression.
    pub(super) pattern: &'static str,
    /// With its parameters filled in.
    pub(super) example: &'static str,
    /// What it does.
    pub(super) function: T,
    regex: Regex,
}

impl<T: Copy> StepPattern<T> {
    /// # Panics
    /// When the pattern is none, or its own example does not fit it: both are our own.
    pub(super) fn new(pattern: &'static str, example: &'static str, does: T) -> StepPattern<T> {
        let parameters: HashMap<&str, &str> = PARAMETERS.into();
        let regex = Expression::regex_with_parameters(pattern, &parameters)
            .unwrap_or_else(|problem| panic!("{pattern:?} is no cucumber expression: {problem}"));
        let phrase = StepPattern { pattern, example, function: does, regex };
        assert!(phrase.parse(example).is_some(), "{example:?} is no example of {pattern:?}: {}", phrase.regex);
        phrase
    }

    /// The values of its parameters in a text, if it fits.
    pub(super) fn parse(&self, text: &str) -> Option<Vec<String>> {
        let found = self.regex.captures(text)?;
        Some(found.iter().skip(1).map(|word| word.map_or(String::new(), |word| word.as_str().to_owned())).collect())
    }
}
