//! `consort lab`: starts the program `consort-lab`.

use crate::exit::Failure;
use crate::lab_program;
use std::ffi::OsString;

/// Inject faults, test behavior, run experiments and benchmarks, with the program consort-lab
///
/// The commands of the laboratory are a program of their own, `consort-lab`, so that the program of
/// a robot stays small. `consort lab ARGUMENTS` is the same as `consort-lab ARGUMENTS`; the program
/// is expected beside this one, or in PATH.
#[derive(Debug, clap::Args)]
#[command(
    disable_help_flag = true,
    after_long_help = "\
Examples:
  consort lab --help
  consort lab chaos --seeds 1..20
  consort lab test my.feature
  consort lab experiment run published --out results"
)]
pub struct Args {
    /// The arguments of consort-lab
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    arguments: Vec<OsString>,
}

/// Runs the command.
///
/// # Errors
/// Returns only if the program cannot be started: [`Failure::Usage`].
pub fn run(args: &Args) -> Result<(), Failure> {
    Err(lab_program::replace_process(&args.arguments))
}
