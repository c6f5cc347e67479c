//! `consort doctor`: what keeps a node, or a client, from its fleet.

use crate::client::ClientFlags;
use crate::doctor::{DiagnosisTarget, Severity, run_checks};
use crate::exit::Failure;
use crate::output;
use consort_protocol::count::count;
use serde_json::json;
use std::path::PathBuf;

/// Find what keeps a node from its fleet, and say what to do about it
///
/// Looks at clock, disk, ports and certificates, tries every neighbour (Zenoh itself says nothing of links that do not come
/// about), and asks the fleet and each of its nodes. With `--config` it looks at a node, by the file that it is started with;
/// without, at a client, by the flags that it would be given.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort doctor --config nodes/examples/robot.toml
  consort doctor --certs certs/kim --connect tls/192.0.2.7:7447
  consort doctor --json | jq '.[] | select(.state != \"ok\")'")]
pub struct Args {
    /// The node's file: a robot's, a station's or a world's
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Print JSON: a list with `state` (ok, warning, error), `about`, `says` and `advice`
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    client: ClientFlags,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Unsuccessful`] if there is any error; [`Failure::Usage`] of files and flags.
pub fn run(args: Args) -> Result<(), Failure> {
    let patient = match &args.config {
        Some(file) => DiagnosisTarget::node(file, &args.client)?,
        None => DiagnosisTarget::client(args.client)?,
    };
    let mut told = Ok(());
    let findings = run_checks(&patient, |finding| {
        if !args.json && told.is_ok() {
            told = output::line(finding);
        }
    });
    told?;
    if args.json {
        output::line(json!(findings))?;
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
