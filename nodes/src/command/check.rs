//! `consort check`: checks files.

use crate::check::{FileKind, check_file};
use crate::exit::Failure;
use crate::output;
use consort_protocol::count::count;
use std::path::PathBuf;

/// Check mission, map, fleet, robot, station, world and workers files
///
/// Detects the kind of each file by its content, and prints `ok` or every problem with file and
/// position. Referenced files are read too: a robot's place must be on its fleet's map.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort check examples/*.toml
  consort check my-mission.yaml my-map.yaml
  consort check --kind station node.toml")]
pub struct Args {
    /// The files
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// The kind of the files, instead of detecting it
    #[arg(long, value_enum)]
    kind: Option<FileKind>,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Unsuccessful`] if any file has a problem.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut wrong = 0;
    for path in &args.files {
        match check_file(path, args.kind) {
            Ok(what) => output::line(format_args!("{}: ok, {what}", path.display()))?,
            Err(problems) => {
                wrong += 1;
                output::line(problems)?;
            }
        }
    }
    match wrong {
        0 => Ok(()),
        _ => Err(Failure::Unsuccessful(format!("problems in {wrong} of {}", count(args.files.len(), "file", "files")))),
    }
}
