//! Steps that a program adds.

use super::fixture::Fixture;
use super::step_arguments::StepArguments;
use super::step_pattern::{ActionStep, FactFn, FactStep, action, fact};
use super::step_result::StepResult;
use std::sync::OnceLock;

/// Steps of a program, in addition to the shipped ones. A pattern is a [cucumber
/// expression](https://github.com/cucumber/cucumber-expressions) with the parameters of the shipped steps:
/// `{name}`, `{text}` in quotes, `{number}`, `{time}`, `{percent}`.
///
/// ```
/// use consort_skills::actions::RobotBackend as _;
/// use consort_tests::behavior::{OwnSteps, expect_that};
///
/// let steps = OwnSteps::default().fact("{name} is tired", "amber is tired", |scenario, arguments| {
///     let robot = scenario.robot(arguments.value(0))?;
///     let share = scenario.with_world(|world| world.telemetry(&robot)).map_or(0.0, |robot| robot.battery.get());
///     expect_that(share < 0.2, || format!("its charge is {:.0} %", share * 100.0))
/// });
/// # drop(steps);
/// ```
#[derive(Debug, Default)]
pub struct OwnSteps {
    pub(super) actions: Vec<ActionStep>,
    pub(super) facts: Vec<FactStep>,
}

impl OwnSteps {
    /// Adds a fact: it follows `Then`, `Then within {time}`, `When the fleet runs until` and so on.
    ///
    /// # Panics
    /// If the pattern is invalid, or the example does not match it.
    #[must_use]
    pub fn fact(mut self, pattern: &'static str, example: &'static str, holds: FactFn) -> OwnSteps {
        self.facts.push(fact(pattern, example, holds));
        self
    }

    /// Adds an action: it follows `When`, or is planned by `Given {action} when {fact}`.
    ///
    /// # Panics
    /// If the pattern is invalid, or the example does not match it.
    #[must_use]
    pub fn action<F>(mut self, pattern: &'static str, example: &'static str, perform: F) -> OwnSteps
    where
        F: AsyncFn(&mut Fixture, &StepArguments) -> StepResult + Copy + Send + Sync + 'static,
    {
        self.actions.push(action(pattern, example, perform));
        self
    }
}

static OWN: OnceLock<OwnSteps> = OnceLock::new();

/// Adds the steps of a program for as long as it runs. Only the first call, before any feature is read, has
/// an effect.
pub fn add_steps(steps: OwnSteps) {
    OWN.get_or_init(|| steps);
}

/// Returns the added steps.
pub(super) fn added() -> &'static OwnSteps {
    OWN.get_or_init(OwnSteps::default)
}
