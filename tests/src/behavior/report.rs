//! Report of a run: a line per scenario, and all steps of a failed scenario.

use super::features::step_text;
use cucumber::event::{Cucumber, Event, Feature, Hook, RetryableScenario, Rule, Scenario, Source, Step, StepError};
use cucumber::gherkin;
use cucumber::{Writer, cli, parser};
use std::io::Write;
use std::time::{Duration, Instant};

/// Outcome of all features.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct FeatureOutcome {
    /// Number of features.
    pub features: usize,
    /// Number of passed scenarios.
    pub passed: usize,
    /// Failed scenarios as `file:line: name`.
    pub failed: Vec<String>,
    /// The report could not be written.
    pub write_failed: bool,
}

/// Writer for the events of cucumber.
pub(super) struct Report<W> {
    out: W,
    steps: bool,
    colours: bool,
    began: Instant,
    outcome: FeatureOutcome,
    /// Lines of the current scenario, and its failure.
    lines: Vec<String>,
    failure: Option<String>,
}

impl<W: Write> Report<W> {
    pub(super) fn new(out: W, steps: bool, colours: bool) -> Report<W> {
        let (lines, failure, outcome) = (vec![], None, FeatureOutcome::default());
        Report { out, steps, colours, began: Instant::now(), outcome, lines, failure }
    }

    pub(super) fn outcome(&self) -> FeatureOutcome {
        self.outcome.clone()
    }

    fn line(&mut self, text: &str) {
        let written = writeln!(self.out, "{text}").and_then(|()| self.out.flush());
        self.outcome.write_failed |= written.is_err();
    }

    fn painted(&self, colour: u8, text: &str) -> String {
        if self.colours { format!("\u{1b}[{colour}m{text}\u{1b}[0m") } else { text.to_owned() }
    }

    fn scenario<T>(&mut self, feature: &gherkin::Feature, scenario: &gherkin::Scenario, event: Scenario<T>) {
        match event {
            Scenario::Started => {
                self.lines.clear();
                self.failure = None;
            }
            Scenario::Background(step, event) | Scenario::Step(step, event) => self.step(&step, event),
            Scenario::Hook(_, Hook::Failed(_, why)) => {
                self.failure = Some(in_words(&*why));
            }
            Scenario::Hook(..) | Scenario::Log(_) => {}
            Scenario::Finished => self.ended(feature, scenario),
        }
    }

    fn step<T>(&mut self, step: &gherkin::Step, event: Step<T>) {
        let line = |mark: String| format!("    {mark} {}", step_text(step));
        match event {
            Step::Started => {}
            Step::Passed(..) => {
                let line = line(self.painted(GREEN, "✓"));
                self.lines.push(line);
            }
            Step::Skipped => self.failure = Some("unknown step".to_owned()),
            Step::Failed(_, _, _, why) => {
                let line = format!("{} (line {})", line(self.painted(RED, "✗")), step.position.line);
                self.lines.push(line);
                self.failure = Some(match why {
                    StepError::Panic(why) => in_words(&*why),
                    other => other.to_string(),
                });
            }
        }
    }

    fn ended(&mut self, feature: &gherkin::Feature, scenario: &gherkin::Scenario) {
        let lines = std::mem::take(&mut self.lines);
        let name = &scenario.name;
        let Some(failure) = self.failure.take() else {
            self.outcome.passed += 1;
            let mark = self.painted(GREEN, "✓");
            self.line(&format!("  {mark} {name}"));
            if self.steps {
                lines.iter().for_each(|line| self.line(line));
            }
            return;
        };
        let file = feature.path.as_ref().map(|path| path.display().to_string()).unwrap_or_default();
        self.outcome.failed.push(format!("{file}:{}: {name}", scenario.position.line));
        let mark = self.painted(RED, "✗");
        self.line(&format!("  {mark} {name}"));
        lines.iter().for_each(|line| self.line(line));
        for line in failure.lines() {
            self.line(&format!("      {line}"));
        }
    }

    fn summary(&mut self) {
        let (passed, failed) = (self.outcome.passed, self.outcome.failed.len());
        let seconds = self.began.elapsed().max(Duration::from_millis(1)).as_secs_f64();
        let counts = format!("{} of {} scenarios passed", passed, passed + failed);
        let counts = self.painted(if failed == 0 { GREEN } else { RED }, &counts);
        self.line(&format!("\n{counts} ({} features, {seconds:.1} s)", self.outcome.features));
        for failed in self.outcome.failed.clone() {
            self.line(&format!("  failed: {failed}"));
        }
    }
}

const RED: u8 = 31;
const GREEN: u8 = 32;

fn in_words(why: &(dyn std::any::Any + Send)) -> String {
    let text = why.downcast_ref::<String>().map(String::as_str).or_else(|| why.downcast_ref::<&str>().copied());
    text.unwrap_or("a panic without a message").to_owned()
}

impl<T, W: Write> Writer<T> for Report<W> {
    type Cli = cli::Empty;

    async fn handle_event(&mut self, event: parser::Result<Event<Cucumber<T>>>, _: &cli::Empty) {
        let scenario = |report: &mut Self,
                        feature: &Source<gherkin::Feature>,
                        scenario: &Source<gherkin::Scenario>,
                        event: RetryableScenario<T>| {
            report.scenario(feature, scenario, event.event);
        };
        match event.map(Event::into_inner) {
            Ok(Cucumber::Feature(feature, Feature::Started)) => {
                self.outcome.features += 1;
                let name =
                    if self.colours { format!("\u{1b}[1m{}\u{1b}[0m", feature.name) } else { feature.name.clone() };
                self.line(&name);
            }
            Ok(Cucumber::Feature(feature, Feature::Scenario(which, event))) => scenario(self, &feature, &which, event),
            Ok(Cucumber::Feature(feature, Feature::Rule(_, Rule::Scenario(which, event)))) => {
                scenario(self, &feature, &which, event);
            }
            Ok(Cucumber::Finished) => self.summary(),
            Ok(Cucumber::Feature(..) | Cucumber::Started | Cucumber::ParsingFinished { .. }) => {}
            Err(problem) => self.outcome.failed.push(problem.to_string()),
        }
    }
}
