//! `consort schema`: prints the JSON Schema of a kind of file.

use crate::check::FileKind;
use crate::config::{FleetConfig, RobotConfig, StationConfig, WorldConfig};
use crate::exit::Failure;
use crate::{inputs, lab_program, output};
use consort_protocol::mission::MissionTemplate;
use consort_skills::descriptor::Calibration;
use consort_skills::domain_file::DomainForm;
use consort_world::map::MapFile;
use schemars::{Schema, schema_for};

/// Print the JSON Schema of a kind of file
///
/// For editors, which then complete keys and mark mistakes, and for programs that write such files.
/// `consort check` checks what a schema cannot express (for example, that a place is on the map, or
/// that a skill exists). The schemas are also in docs/schemas/.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort schema mission > mission.json
  consort schema robot

An editor finds it in the first line of a file:
  # yaml-language-server: $schema=mission.json
  #:schema robot.json")]
pub struct Args {
    /// The kind of file
    kind: FileKind,
}

/// Returns the schema of a kind of file; `None` for formats that are published elsewhere, and for
/// designs, which `consort-lab` reads.
pub fn schema(kind: FileKind) -> Option<Schema> {
    Some(match kind {
        FileKind::Mission => MissionTemplate::schema(),
        FileKind::Map => schema_for!(MapFile),
        FileKind::Fleet => schema_for!(FleetConfig),
        FileKind::Robot => schema_for!(RobotConfig),
        FileKind::Station => schema_for!(StationConfig),
        FileKind::World => schema_for!(WorldConfig),
        FileKind::Workers => inputs::workers_schema(),
        FileKind::Calibration => schema_for!(Calibration),
        FileKind::Domain => schema_for!(DomainForm),
        FileKind::Design | FileKind::Ihtn | FileKind::Scenarios | FileKind::Tree => return None,
    })
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for a format that is published elsewhere; [`Failure::OutputClosed`].
pub fn run(args: &Args) -> Result<(), Failure> {
    if args.kind == FileKind::Design {
        return Err(lab_program::replace_process(["schema"]));
    }
    let Some(schema) = schema(args.kind) else {
        let of = if args.kind == FileKind::Tree { "BehaviorTree.CPP" } else { "the published evaluation" };
        let what = format!("{} has the format of {of}, which has no schema here", args.kind);
        return Err(Failure::Usage(what));
    };
    output::line(serde_json::to_string_pretty(&schema).expect("a schema is JSON"))
}
