//! `consort check`: is a file right?

use crate::check::{FileKind, check_file};
use crate::exit::Failure;
use crate::output;
use consort_protocol::count::count;
use std::path::PathBuf;

/// Check mission, map, fleet, robot, station, world and workers files
///
/// Tells by its content which kind a file is, and prints `ok` or every problem with file and place. Files that a file
/// names are read too: a robot's place must be on its fleet's map.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort check nodes/examples/*.toml
  consort check my-mission.yaml my-map.yaml
  consort check --kind station node.toml")]
pub struct Args {
    /// The files
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// What they are, instead of telling by their content
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
