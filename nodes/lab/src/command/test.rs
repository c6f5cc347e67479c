//! `consort-lab test`: runs Gherkin features on whole fleets in virtual time.

use super::workload_flags::DomainFlags;
use clap::Args as ClapArgs;
use consort_nodes::exit::Failure;
use consort_nodes::output;
use consort_skills::extensions::Extensions;
use consort_tests::behavior::{self, Features, RunOptions, ScenarioFilter, step_docs};
use consort_text::count;
use std::io::{IsTerminal, stdout};
use std::path::PathBuf;

/// Runs features: plain-text descriptions of required behavior, checked on a simulated fleet.
///
/// A feature file (Gherkin) contains scenarios: robots, nurses, stations and a map; a requested
/// mission; faults and their times; and the required result. Each scenario is a whole fleet in this
/// process, on virtual time: nodes elect a coordinator, bid, and carry out the mission in a
/// simulated world. The same seed gives the same run.
///
/// Every step is looked up before any scenario runs. An unknown step is reported with its file and
/// line, and with the most similar steps. A failed step is reported with the actual value and the
/// events before it.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  consort-lab test --steps                            # all known steps, with an example of each
  consort-lab test tests/features                     # all features of a folder
  consort-lab test my.feature --verbose               # a single file, with every step
  consort-lab test tests/features --tags '@nurse and not @slow'
  consort-lab test tests/features --name 'battery' --seed 7
  consort-lab test plants.feature --domain plants.yaml  # actions and tasks of your own in all scenarios

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
    /// Feature files, or folders with files that end in .feature
    #[arg(value_name = "FEATURES", required_unless_present = "steps")]
    features: Vec<PathBuf>,
    #[command(flatten)]
    domains: DomainFlags,
    /// Run only scenarios with matching tags, as in '@nurse and not @slow'
    #[arg(long, value_name = "EXPRESSION")]
    tags: Option<String>,
    /// Run only scenarios with this text in their name
    #[arg(long, value_name = "TEXT")]
    name: Option<String>,
    /// Seed for scenarios that do not set a seed
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Parallel scenarios [default: the number of cores]
    #[arg(long)]
    jobs: Option<usize>,
    /// Print every step
    #[arg(long, short)]
    verbose: bool,
    /// Print all known steps, with an example of each, and run nothing
    #[arg(long, conflicts_with_all = ["features", "tags", "name", "jobs", "verbose"])]
    steps: bool,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for invalid feature files, unknown steps and invalid domains; [`Failure::Unsuccessful`] if a
/// scenario does not pass.
pub fn run(args: Args, extensions: Extensions) -> Result<(), Failure> {
    if args.steps {
        return steps();
    }
    let tags = args
        .tags
        .as_deref()
        .map(ScenarioFilter::tags)
        .transpose()
        .map_err(|problem| Failure::Usage(problem.to_string()))?;
    let filter = ScenarioFilter { tags, name: args.name };
    let features = Features::read(&args.features, &filter).map_err(|bad| Failure::Usage(bad.to_string()))?;
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let order = RunOptions {
        extensions: args.domains.extend(extensions)?,
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
