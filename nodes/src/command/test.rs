//! `consort test`: features in Gherkin, played by whole fleets on virtual time.

use crate::exit::Failure;
use crate::output;
use clap::Args as ClapArgs;
use consort_protocol::count::count;
use consort_tests::behavior::{self, Features, RunOptions, ScenarioFilter, step_docs};
use std::io::{IsTerminal, stdout};
use std::path::PathBuf;

/// Plays features: says in plain words what a fleet must do, and shows whether it does.
///
/// A feature file (Gherkin) tells of scenarios: robots, nurses, stations and a map; a mission that is asked for; what goes
/// wrong, and when; and what must come of it. Each scenario is a whole fleet in this process, on virtual time: nodes that
/// elect a coordinator, bid, and carry the mission out in a simulated world. The same seed gives the same run.
///
/// Every step is looked up before anything is played. One that nobody knows is told with its file and line, and with the
/// steps that are most like it. A step that does not hold is told with what was found instead, and what had happened.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  consort test --steps                            # all that may be said, with an example of each
  consort test tests/features                     # all features of a folder
  consort test my.feature --verbose               # one file, with every step
  consort test tests/features --tags '@nurse and not @slow'
  consort test tests/features --name 'battery' --seed 7

A feature:
  Feature: Lab samples
    Scenario: A sample is brought to the laboratory
      Given a robot amber at \"Dock\"
      And an arm lab-arm at \"Laboratory\"
      And a station post
      And a nurse in \"IC Room 6\"
      When a sample is requested from \"IC Room 6\"
      Then within 10 minutes the mission is completed
      And the sample of \"IC Room 6\" was delivered to lab-arm

Exit codes: 0 all scenarios passed; 1 some did not; 2 the flags or the features are wrong.")]
pub struct Args {
    /// Feature files, or folders with files that end with .feature
    #[arg(value_name = "FEATURES", required_unless_present = "steps")]
    features: Vec<PathBuf>,
    /// Play scenarios alone whose tags fit, as in '@nurse and not @slow'
    #[arg(long, value_name = "EXPRESSION")]
    tags: Option<String>,
    /// Play scenarios alone whose names have this in them
    #[arg(long, value_name = "TEXT")]
    name: Option<String>,
    /// Where the chance of scenarios comes from that do not name a seed
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Scenarios played at the same time [default: one on each core]
    #[arg(long)]
    jobs: Option<usize>,
    /// Print every step
    #[arg(long, short)]
    verbose: bool,
    /// Print all that may be said, with an example of each, and play nothing
    #[arg(long, conflicts_with_all = ["features", "tags", "name", "jobs", "verbose"])]
    steps: bool,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for files that are no features and steps that nobody knows; [`Failure::Unsuccessful`] if a scenario does
/// not pass.
pub fn run(args: Args) -> Result<(), Failure> {
    if args.steps {
        return steps();
    }
    let tags = args.tags.as_deref().map(ScenarioFilter::tags).transpose().map_err(Failure::Usage)?;
    let filter = ScenarioFilter { tags, name: args.name };
    let features = Features::read(&args.features, &filter).map_err(|bad| Failure::Usage(bad.to_string()))?;
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let order = RunOptions {
        seed: args.seed,
        jobs: args.jobs.unwrap_or(cores),
        steps: args.verbose,
        colours: stdout().is_terminal() && std::env::var_os("NO_COLOR").is_none(),
    };
    let outcome = behavior::run(features, &order, stdout());
    match outcome.failed.len() {
        _ if outcome.write_failed => Err(Failure::OutputClosed),
        0 => Ok(()),
        failed => Err(Failure::Unsuccessful(format!(
            "{failed} of {} failed",
            count(failed + outcome.passed, "scenario", "scenarios")
        ))),
    }
}

fn steps() -> Result<(), Failure> {
    let mut kind = "";
    for step in step_docs() {
        if step.kind != kind {
            output::line(format_args!("{}{}:", if kind.is_empty() { "" } else { "\n" }, step.kind))?;
            kind = step.kind;
        }
        output::line(format_args!("  {}", step.pattern))?;
        if step.example != step.pattern {
            output::line(format_args!("      {}", step.example))?;
        }
    }
    Ok(())
}
