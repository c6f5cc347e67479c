//! Meaning of a step in the text of a scenario, and its execution.

use super::fixture::{Fixture, PlannedAction};
use super::step_arguments::StepArguments;
use super::step_pattern::{ActionStep, FactFn, SettingFn};
use super::step_result::{StepFailure, StepResult};
use futures::FutureExt;

/// Limit of `When the fleet runs until …`, in seconds of world time.
const WAIT_LIMIT_S: f64 = 3600.0;

/// A resolved step.
#[derive(Debug, Clone)]
pub(super) enum StepMeaning {
    /// Sets the initial state.
    Configure(SettingFn, StepArguments),
    /// Plans an action for the moment at which a fact holds.
    DoWhen(&'static ActionStep, StepArguments, Box<FactCheck>),
    /// Executes an action now.
    DoNow(&'static ActionStep, StepArguments),
    /// Lets time pass until a fact holds.
    WaitUntil(FactCheck),
    /// Checks that a fact holds now.
    Holds(FactCheck),
    /// Checks that a fact does not hold now.
    DoesNotHold(FactCheck),
    /// Checks that a fact holds within a time in seconds.
    HoldsWithin(f64, FactCheck),
    /// Checks that a fact holds during a whole time in seconds.
    HoldsFor(f64, FactCheck),
    /// Checks that a fact never holds during a time in seconds.
    NeverHolds(f64, FactCheck),
}

/// Check of a fact.
#[derive(Debug, Clone)]
pub(super) struct FactCheck {
    pub(super) fact: FactFn,
    pub(super) arguments: StepArguments,
    /// Text of the fact.
    pub(super) text: String,
}

impl StepMeaning {
    /// Executes the step.
    pub(super) async fn perform(self, fixture: &mut Fixture) -> StepResult {
        match self {
            StepMeaning::Configure(setting, arguments) => {
                if fixture.has_begun() {
                    return Err(StepFailure::invalid(
                        "the scenario has begun: settings must come before the first When",
                    ));
                }
                setting(&mut fixture.setup, &arguments)
            }
            StepMeaning::DoWhen(action, arguments, check) => {
                fixture.plan(PlannedAction {
                    fact: check.text.clone(),
                    check: Box::new(move |fixture| check.holds(fixture)),
                    execute: Box::new(move |fixture| {
                        async move { (action.function)(fixture, &arguments).await }.boxed_local()
                    }),
                });
                Ok(())
            }
            StepMeaning::DoNow(action, arguments) => {
                fixture.ensure_world()?;
                (action.function)(fixture, &arguments).await
            }
            StepMeaning::WaitUntil(check) => {
                fixture.start_nodes().await?;
                check.holds_within(fixture, WAIT_LIMIT_S).await
            }
            StepMeaning::Holds(check) => {
                fixture.ensure_world()?;
                check.holds(fixture)
            }
            StepMeaning::DoesNotHold(check) => {
                fixture.ensure_world()?;
                check.does_not_hold(fixture)
            }
            StepMeaning::HoldsWithin(seconds, check) => check.holds_within(fixture, seconds).await,
            StepMeaning::HoldsFor(seconds, check) => {
                fixture.advance(seconds, |fixture| check.holds(fixture).map(|()| false)).await.map(drop)?;
                check.holds(fixture)
            }
            StepMeaning::NeverHolds(seconds, check) => {
                fixture.advance(seconds, |fixture| check.does_not_hold(fixture).map(|()| false)).await.map(drop)?;
                check.does_not_hold(fixture)
            }
        }
    }
}

impl FactCheck {
    fn holds(&self, fixture: &Fixture) -> StepResult {
        (self.fact)(fixture, &self.arguments)
    }

    fn does_not_hold(&self, fixture: &Fixture) -> StepResult {
        match self.holds(fixture) {
            Ok(()) => Err(StepFailure::NotMet("it holds".to_owned())),
            Err(StepFailure::NotMet(_)) => Ok(()),
            Err(invalid) => Err(invalid),
        }
    }

    async fn holds_within(&self, fixture: &mut Fixture, seconds: f64) -> StepResult {
        let holds = |fixture: &Fixture| match self.holds(fixture) {
            Ok(()) => Ok(true),
            Err(StepFailure::NotMet(_)) => Ok(false),
            Err(invalid) => Err(invalid),
        };
        if fixture.advance(seconds, holds).await? {
            return Ok(());
        }
        self.holds(fixture)
    }
}
