//! Plays features with cucumber: each scenario on a thread of its own, so that it has a runtime and its time for itself.

use super::features::Features;
use super::fixture::Fixture;
use super::report::{FeatureOutcome, Report};
use super::step_pattern::StepFailure;
use super::step_registry::StepRegistry;
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

/// How many lines of the story a failure tells.
const STORY: usize = 40;

/// How features are to be played.
pub struct RunOptions {
    /// Where the chance of scenarios comes from that name no seed of their own.
    pub seed: u64,
    /// How many scenarios are played at once.
    pub jobs: usize,
    /// Whether every step is told, or scenarios alone.
    pub steps: bool,
    /// Whether there are colours.
    pub colours: bool,
}

/// Plays features and tells of them as they are played.
pub fn run(features: Features, order: &RunOptions, out: impl Write) -> FeatureOutcome {
    let steps = Collection::new();
    let any = || Regex::new(".*").expect("a sound pattern");
    let steps = steps.given(None, any(), perform).when(None, any(), perform).then(None, any(), perform);
    let seed = order.seed;
    let runner = runner::Basic::<Theatre>::default()
        .max_concurrent_scenarios(Some(order.jobs.max(1)))
        .steps(steps)
        .before(move |feature, _, _, theatre: &mut Theatre| {
            theatre.open(feature, seed);
            futures::future::ready(()).boxed_local()
        })
        .after(|_, _, _, finished, theatre| {
            async move {
                if let (ScenarioFinished::StepPassed, Some(theatre)) = (finished, theatre) {
                    theatre.does(None).await;
                }
            }
            .boxed_local()
        });
    let report = Report::new(out, order.steps, order.colours);
    let cucumber: Cucumber<Theatre, Read, Features, _, _> = Cucumber::custom(Read, runner, Normalize::new(report));
    let cucumber = cucumber.with_default_cli();
    futures::executor::block_on(cucumber.run(features)).inner_writer().outcome()
}

/// Hands over what was read and checked before.
struct Read;

impl parser::Parser<Features> for Read {
    type Cli = cli::Empty;
    type Output = stream::Iter<std::vec::IntoIter<parser::Result<Feature>>>;

    fn parse(self, features: Features, _: cli::Empty) -> Self::Output {
        stream::iter(features.0.into_iter().map(Ok).collect::<Vec<_>>())
    }
}

/// One scenario's thread.
#[derive(Debug, Default)]
struct Theatre(Option<mpsc::Sender<Job>>);

/// A step to be done, or none once all are; and whom to tell how it went.
struct Job(Option<Step>, oneshot::Sender<Result<(), String>>);

impl World for Theatre {
    type Error = std::convert::Infallible;

    async fn new() -> Result<Theatre, Self::Error> {
        Ok(Theatre(None))
    }
}

impl Theatre {
    fn open(&mut self, feature: &Feature, seed: u64) {
        let folder = feature.path.as_ref().and_then(|path| path.parent()).map_or(PathBuf::new(), PathBuf::from);
        let (tell, jobs) = mpsc::channel();
        let thread = thread::Builder::new().name("scenario".to_owned());
        thread.spawn(move || play(folder, seed, &jobs)).expect("the system has a thread left");
        self.0 = Some(tell);
    }
}

/// A scenario, from its first step to its last. Between two steps no time passes.
fn play(folder: PathBuf, seed: u64, jobs: &mpsc::Receiver<Job>) {
    let mut builder = tokio::runtime::Builder::new_current_thread();
    let runtime = builder.enable_time().start_paused(true).build().expect("a runtime without I/O");
    // Its clock is read between steps, too.
    let _entered = runtime.enter();
    let mut stage = Fixture::new(folder, seed);
    for Job(step, answer) in jobs {
        let Some(step) = step else {
            // Whoever is told that nothing came of it has nothing to say about that.
            let _ = answer.send(stage.unfinished().map_or(Ok(()), Err));
            return;
        };
        let meaning = StepRegistry::get().read(&step);
        let played = meaning.map(|meaning| {
            catch_unwind(AssertUnwindSafe(|| runtime.block_on(stage.perform(meaning)))).unwrap_or_else(|panic| {
                Err(StepFailure::Invalid(format!("the program itself failed: {}", in_words(&*panic))))
            })
        });
        let went = match played {
            Err(problem) => Err(problem),
            Ok(Ok(())) => Ok(()),
            Ok(Err(wrong)) => Err(explain(&step, &wrong, &stage)),
        };
        if answer.send(went).is_err() {
            return;
        }
    }
}

fn explain(step: &Step, wrong: &StepFailure, stage: &Fixture) -> String {
    let (head, what) = match wrong {
        StepFailure::NotMet(found) => ("found", found),
        StepFailure::Invalid(why) => ("but", why),
    };
    let mut lines = vec![format!("expected: {}", step.value), format!("{head:>8}: {what}")];
    let story = stage.event_text();
    if !story.is_empty() {
        lines.push(format!("what had happened by {:.1} s (seed {}):", stage.now_s(), stage.setup.seed));
        if story.len() > STORY {
            lines.push(format!("  … {} lines before", story.len() - STORY));
        }
        lines.extend(story.iter().skip(story.len().saturating_sub(STORY)).map(|line| format!("  {line}")));
    }
    lines.join("\n")
}

fn in_words(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    text.unwrap_or("a panic without words").to_owned()
}

impl Theatre {
    /// Has a step done, or the scenario ended. Cucumber takes a panic for a failure; this one is not printed by anybody else.
    async fn does(&mut self, step: Option<Step>) {
        let (answer, heard) = oneshot::channel();
        let jobs = self.0.as_ref().expect("it was opened before the first step");
        let sent = jobs.send(Job(step, answer)).is_ok();
        let went = if sent { heard.await.ok() } else { None };
        match went {
            Some(Ok(())) => {}
            Some(Err(why)) => resume_unwind(Box::new(why)),
            None => resume_unwind(Box::new("the scenario's thread has ended".to_owned())),
        }
    }
}

/// What cucumber calls for each step.
fn perform(theatre: &mut Theatre, context: Context) -> LocalBoxFuture<'_, ()> {
    theatre.does(Some(context.step)).boxed_local()
}
