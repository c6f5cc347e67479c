//! Runs features with cucumber. Each scenario has its own thread, so that it has its own runtime
//! and clock.

use super::features::Features;
use super::fixture::Fixture;
use super::report::{FeatureOutcome, Report};
use super::step_registry::StepRegistry;
use super::step_result::StepFailure;
use consort_skills::extensions::Extensions;
use cucumber::event::ScenarioFinished;
use cucumber::gherkin::{Feature, Step};
use cucumber::step::{Collection, Context};
use cucumber::writer::Normalize;
use cucumber::{Cucumber, World, cli, parser, runner};
use futures::channel::oneshot;
use futures::future::LocalBoxFuture;
use futures::{FutureExt, stream};
use regex::Regex;
use std::any::Any;
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::PathBuf;
use std::sync::mpsc;
use std::thread;

/// Number of event lines in the report of a failure.
const EVENT_LINES_MAX: usize = 40;

/// Options of a run.
pub struct RunOptions {
    /// Domain files and skills of all scenarios, in addition to the standard domain.
    pub extensions: Extensions,
    /// Seed of scenarios that set none.
    pub seed: u64,
    /// Number of parallel scenarios.
    pub jobs: usize,
    /// Report every step, not only scenarios.
    pub steps: bool,
    /// Use colours.
    pub colours: bool,
}

/// Runs features and reports on each scenario.
pub fn run(features: Features, options: &RunOptions, out: impl Write) -> FeatureOutcome {
    let steps = Collection::new();
    let any = || Regex::new(".*").expect("a sound pattern");
    let steps = steps.given(None, any(), perform).when(None, any(), perform).then(None, any(), perform);
    let (seed, extensions) = (options.seed, options.extensions);
    let runner = runner::Basic::<ScenarioThread>::default()
        .max_concurrent_scenarios(Some(options.jobs.max(1)))
        .steps(steps)
        .before(move |feature, _, _, thread_handle: &mut ScenarioThread| {
            thread_handle.open(feature, seed, extensions);
            futures::future::ready(()).boxed_local()
        })
        .after(|_, _, _, finished, thread_handle| {
            async move {
                if let (ScenarioFinished::StepPassed, Some(thread_handle)) = (finished, thread_handle) {
                    thread_handle.execute(None).await;
                }
            }
            .boxed_local()
        });
    let report = Report::new(out, options.steps, options.colours);
    let cucumber: Cucumber<ScenarioThread, Read, Features, _, _> =
        Cucumber::custom(Read, runner, Normalize::new(report));
    let cucumber = cucumber.with_default_cli();
    futures::executor::block_on(cucumber.run(features)).inner_writer().outcome()
}

/// Parser that returns the features that were read and checked before.
struct Read;

impl parser::Parser<Features> for Read {
    type Cli = cli::Empty;
    type Output = stream::Iter<std::vec::IntoIter<parser::Result<Feature>>>;

    fn parse(self, features: Features, _: cli::Empty) -> Self::Output {
        stream::iter(features.0.into_iter().map(Ok).collect::<Vec<_>>())
    }
}

/// Handle of the thread of a scenario.
#[derive(Debug, Default)]
struct ScenarioThread(Option<mpsc::Sender<Job>>);

/// A step to execute, or `None` after the last step; and the channel for its result.
struct Job(Option<Step>, oneshot::Sender<StepOutcome>);

/// Result of a step, or of the end of a scenario.
enum StepOutcome {
    Passed,
    /// Reason for the failure, as printed in the report.
    Failed(String),
}

impl World for ScenarioThread {
    type Error = std::convert::Infallible;

    async fn new() -> Result<ScenarioThread, Self::Error> {
        Ok(ScenarioThread(None))
    }
}

impl ScenarioThread {
    fn open(&mut self, feature: &Feature, seed: u64, extensions: Extensions) {
        let folder = feature.path.as_ref().and_then(|path| path.parent()).map_or(PathBuf::new(), PathBuf::from);
        let (sender, jobs) = mpsc::channel();
        let thread = thread::Builder::new().name("scenario".to_owned());
        thread.spawn(move || run_scenario(folder, seed, extensions, &jobs)).expect("a thread can be started");
        self.0 = Some(sender);
    }
}

/// Executes the steps of a scenario. No time passes between two steps.
fn run_scenario(folder: PathBuf, seed: u64, extensions: Extensions, jobs: &mpsc::Receiver<Job>) {
    let mut builder = tokio::runtime::Builder::new_current_thread();
    let runtime = builder.enable_time().start_paused(true).build().expect("a runtime without I/O");
    // The clock of the runtime is also read between steps.
    let _entered = runtime.enter();
    let mut fixture = Fixture::new(folder, seed, extensions);
    for Job(step, answer) in jobs {
        let Some(step) = step else {
            // The receiver may be gone; the result is not needed then.
            let _ = answer.send(fixture.unfinished().map_or(StepOutcome::Passed, StepOutcome::Failed));
            return;
        };
        let meaning = StepRegistry::get().read(&step);
        let played = meaning.map(|meaning| {
            catch_unwind(AssertUnwindSafe(|| runtime.block_on(meaning.perform(&mut fixture)))).unwrap_or_else(|panic| {
                Err(StepFailure::Invalid(format!("the program itself failed: {}", panic_text(&*panic))))
            })
        });
        let outcome = match played {
            Err(problem) => StepOutcome::Failed(problem.to_string()),
            Ok(Ok(())) => StepOutcome::Passed,
            Ok(Err(failure)) => StepOutcome::Failed(failure_text(&step, &failure, &fixture)),
        };
        if answer.send(outcome).is_err() {
            return;
        }
    }
}

fn failure_text(step: &Step, failure: &StepFailure, fixture: &Fixture) -> String {
    let (head, what) = match failure {
        StepFailure::NotMet(found) => ("found", found),
        StepFailure::Invalid(why) => ("but", why),
    };
    let mut lines = vec![format!("expected: {}", step.value), format!("{head:>8}: {what}")];
    let events = fixture.event_text();
    if !events.is_empty() {
        lines.push(format!("what had happened by {:.1} s (seed {}):", fixture.now_s(), fixture.setup.seed));
        if events.len() > EVENT_LINES_MAX {
            lines.push(format!("  … {} lines before", events.len() - EVENT_LINES_MAX));
        }
        lines.extend(events.iter().skip(events.len().saturating_sub(EVENT_LINES_MAX)).map(|line| format!("  {line}")));
    }
    lines.join("\n")
}

fn panic_text(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    text.unwrap_or("a panic without a message").to_owned()
}

impl ScenarioThread {
    /// Executes a step, or ends the scenario. Cucumber treats a panic as a failure. The panic hook
    /// does not print this one.
    async fn execute(&mut self, step: Option<Step>) {
        let (answer, result) = oneshot::channel();
        let jobs = self.0.as_ref().expect("it was opened before the first step");
        let sent = jobs.send(Job(step, answer)).is_ok();
        let outcome = if sent { result.await.ok() } else { None };
        match outcome {
            Some(StepOutcome::Passed) => {}
            Some(StepOutcome::Failed(why)) => resume_unwind(Box::new(why)),
            None => resume_unwind(Box::new("the scenario's thread has ended".to_owned())),
        }
    }
}

/// Step function of cucumber.
fn perform(thread_handle: &mut ScenarioThread, context: Context) -> LocalBoxFuture<'_, ()> {
    thread_handle.execute(Some(context.step)).boxed_local()
}
