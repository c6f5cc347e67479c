//! `consort-lab schema`: prints the JSON Schema of the design of an evaluation.

use consort_evaluation::design::Design;
use consort_nodes::exit::Failure;
use consort_nodes::output;
use schemars::{Schema, schema_for};

/// Print the JSON Schema of the design of an evaluation
///
/// For editors, which then complete keys and mark mistakes. `consort schema design` calls this
/// command.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort-lab schema > design.json

An editor finds it in the first line of a design:
  #:schema design.json")]
pub struct Args {}

/// Returns the schema of a design.
pub fn design_schema() -> Schema {
    schema_for!(Design)
}

/// Runs the command.
///
/// # Errors
/// [`Failure::OutputClosed`].
pub fn run(_: &Args) -> Result<(), Failure> {
    output::line(serde_json::to_string_pretty(&design_schema()).expect("a schema is JSON"))
}
