//! `consort doctor`: finds the reason why a node or a client does not reach its fleet.

use crate::client::ClientFlags;
use crate::doctor::{DiagnosisTarget, Severity, run_checks};
use crate::exit::Failure;
use crate::output;
use consort_skills::extensions::Extensions;
use consort_text::count;
use std::path::PathBuf;

/// Find the reason why a node does not reach its fleet, and suggest a remedy
///
/// Checks clock, disk, ports and certificates, tries every neighbour (Zenoh itself reports nothing
/// about failed links), and queries the fleet and each of its nodes. With `--config` it checks a
/// node, by its file; without, a client, by its flags.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort doctor --config examples/robot.toml
  consort doctor --certs certs/kim --connect tls/192.0.2.7:7447
  consort doctor --json | jq '.[] | select(.state != \"ok\")'")]
pub(crate) struct Args {
    /// The node's file: of a robot, a station or a world
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Print JSON: a list with `state` (ok, warning, error), `about`, `text` and `advice`
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    client: ClientFlags,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Unsuccessful`] if there is any error; [`Failure::Usage`] of files and flags.
pub(crate) fn run(args: Args, extensions: Extensions) -> Result<(), Failure> {
    let target = match &args.config {
        Some(file) => DiagnosisTarget::node(file, &args.client, extensions)?,
        None => DiagnosisTarget::client(args.client)?,
    };
    let mut printed = Ok(());
    let findings = run_checks(&target, |finding| {
        if !args.json && printed.is_ok() {
            printed = output::line(finding);
        }
    });
    printed?;
    if args.json {
        output::json(&findings)?;
    }
    let number = |state| findings.iter().filter(|finding| finding.state == state).count();
    match number(Severity::Error) {
        0 => Ok(()),
        errors => {
            let warnings = count(number(Severity::Warning), "warning", "warnings");
            Err(Failure::Unsuccessful(format!("{}, {warnings}", count(errors, "error", "errors"))))
        }
    }
}
