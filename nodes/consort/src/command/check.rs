//! `consort check`: checks files.

use super::flags::PeopleFlags;
use crate::check::{FileKind, check_file, detect_kind};
use crate::diagnostic::Diagnostics;
use crate::exit::Failure;
use crate::{lab_program, output};
use consort_skills::extensions::Extensions;
use consort_text::count;
use std::path::{Path, PathBuf};

/// Check mission, domain, tree, map, fleet, robot, station, world and workers files
///
/// Detects the kind of each file by its content, and prints `ok` or every problem with file and
/// position. Referenced files are read too: a robot's place must be on its fleet's map.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort check examples/*.toml
  consort check my-mission.yaml my-map.yaml
  consort check my-domain.yaml my-tree.xml
  consort check my-mission.yaml --domain my-domain.yaml
  consort check my-ihtn.json --domain my-domain.yaml --person nurse
  consort check --kind station node.toml")]
pub struct Args {
    /// The files
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// The kind of the files, instead of detecting it
    #[arg(long, value_enum)]
    kind: Option<FileKind>,
    #[command(flatten)]
    people: PeopleFlags,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Unsuccessful`] if any file has a problem.
pub fn run(args: Args, extensions: Extensions) -> Result<(), Failure> {
    let is_design = |path: &PathBuf| args.kind.or_else(|| detect_kind(path).ok()) == Some(FileKind::Design);
    let (designs, others): (Vec<PathBuf>, Vec<PathBuf>) = args.files.iter().cloned().partition(is_design);
    let checked = check_each(&others, |path| check_file(path, args.kind, &args.people.people, extensions));
    if designs.is_empty() {
        return checked;
    }
    let domains = extensions.domains.iter().flat_map(|loaded| [Path::new("--domain"), loaded.path.as_path()]);
    let files = designs.iter().map(PathBuf::as_path);
    let mut lab = lab_program::command([Path::new("check")].into_iter().chain(domains).chain(files));
    let status = lab.status().map_err(|problem| lab_program::not_started(&problem))?;
    checked?;
    if status.success() { Ok(()) } else { Err(Failure::Unsuccessful("problems in a design".to_owned())) }
}

/// Checks files and prints a line for each, or its problems.
///
/// # Errors
/// [`Failure::Unsuccessful`] if any file has a problem.
pub fn check_each(files: &[PathBuf], check: impl Fn(&Path) -> Result<String, Diagnostics>) -> Result<(), Failure> {
    let mut wrong = 0;
    for path in files {
        match check(path) {
            Ok(what) => output::line(format_args!("{}: ok, {what}", path.display()))?,
            Err(problems) => {
                wrong += 1;
                output::line(problems)?;
            }
        }
    }
    match wrong {
        0 => Ok(()),
        _ => Err(Failure::Unsuccessful(format!("problems in {wrong} of {}", count(files.len(), "file", "files")))),
    }
}
