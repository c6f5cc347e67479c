//! `consort-lab check`: checks the designs of evaluations.

use super::workload_flags::WorkloadFlags;
use crate::design_file::DesignFile;
use crate::evaluation::{Evaluation, InputOverrides};
use consort_nodes::command::check::check_each;
use consort_nodes::config;
use consort_nodes::diagnostic::Diagnostics;
use consort_nodes::exit::Failure;
use consort_skills::extensions::Extensions;
use consort_skills::workload::Workload;
use consort_text::count;
use std::path::{Path, PathBuf};

/// Check the designs of evaluations
///
/// Prints `ok` or every problem with file and position. Files that a design names are read too.
/// `consort check` calls this command for designs.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort-lab check my-design.toml")]
pub(crate) struct Args {
    /// The files
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    #[command(flatten)]
    workload: WorkloadFlags,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Unsuccessful`] if any file has a problem.
pub(crate) fn run(args: &Args, extensions: Extensions) -> Result<(), Failure> {
    let workload = args.workload.workload(extensions)?;
    check_each(&args.files, |path| {
        let what = check_design(path, &workload).map_err(|problems| problems.with_file(path.display()))?;
        Ok(format!("a design: {what}"))
    })
}

/// Checks a design with the files that it names, and returns a short description of its content.
fn check_design(path: &Path, workload: &Workload) -> Result<String, Diagnostics> {
    let DesignFile(design) = config::load(path, &workload.extensions.domain())?;
    let evaluation = Evaluation::load(design, &InputOverrides::default(), workload.clone())?;
    let design = &evaluation.design;
    evaluation.trial_fixture(design.clone(), None)?;
    let trials = evaluation.scenarios.len() * design.policies.len() * design.treatments.len();
    Ok(format!("{}, {}", design.name, count(trials * design.repetitions as usize, "trial", "trials")))
}
