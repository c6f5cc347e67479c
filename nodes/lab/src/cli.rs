//! The command line.

use crate::command::{allocate, bench, chaos, check, experiment, png, schema, soak, test};
use clap::{Parser, Subcommand};
use consort_nodes::output::exit_code;
use consort_skills::extensions::Extensions;
use consort_tests::behavior::{OwnSteps, add_steps};
use std::ffi::OsString;
use std::process::ExitCode;

/// The laboratory of Consort: fault injection, behavior tests, evaluations and benchmarks.
///
/// Most commands run whole fleets, or the simulator, in this process. Only `soak` starts processes and
/// sends messages, in network namespaces of its own. `consort lab ARGUMENTS` starts this program.
#[derive(Debug, Parser)]
#[command(name = "consort-lab", version, max_term_width = 100, after_long_help = AFTER_HELP)]
pub struct Cli {
    /// The command.
    #[command(subcommand)]
    command: Command,
}

const AFTER_HELP: &str = "\
Examples:
  # whole fleets under generated faults; a violation is printed with the command that repeats it
  consort-lab chaos --seeds 1..1000

  # real processes under random faults
  consort-lab soak --minutes 30

  # required behavior, in plain text
  consort-lab test tests/features

  # a mission and a domain of your own under faults
  consort-lab chaos --domain examples/plants/domain.yaml --mission examples/plants/rounds.yaml --seeds 1..20

  # the published evaluation: 1296 trials
  consort-lab experiment run published --out results

Exit codes: 0 success; 1 the operation failed (an invariant is violated, a scenario failed); 2 the flags or files are
wrong.";

// Each command is described at its flags.
#[derive(Debug, Subcommand)]
enum Command {
    Chaos(chaos::Args),
    Soak(soak::Args),
    Test(test::Args),
    Experiment(experiment::Args),
    Allocate(allocate::Args),
    Bench(bench::Args),
    Check(check::Args),
    Schema(schema::Args),
    Png(png::Args),
}

/// Runs the program.
pub fn run() -> ExitCode {
    run_with(Extensions::default(), std::env::args_os())
}

/// Runs a program with additional skills, parts of the simulator and steps of features. The first of `args` is the
/// program's name.
pub fn run_with_steps(extensions: Extensions, steps: OwnSteps, args: impl IntoIterator<Item = OsString>) -> ExitCode {
    add_steps(steps);
    run_with(extensions, args)
}

/// Runs a program with additional skills and parts of the simulator. The first of `args` is the program's name.
pub fn run_with(extensions: Extensions, args: impl IntoIterator<Item = OsString>) -> ExitCode {
    exit_code(
        "consort-lab",
        match Cli::parse_from(args).command {
            Command::Chaos(args) => chaos::run(args, extensions),
            Command::Soak(args) => soak::run(&args),
            Command::Test(args) => test::run(args, extensions),
            Command::Experiment(args) => experiment::run(&args, extensions),
            Command::Allocate(args) => allocate::run(&args),
            Command::Bench(args) => bench::run(args, extensions),
            Command::Check(args) => check::run(&args, extensions),
            Command::Schema(args) => schema::run(&args),
            Command::Png(args) => png::run(&args),
        },
    )
}
