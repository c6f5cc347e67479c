//! `consort backup`: copies the ledger of a running fleet.

use crate::client::ClientFlags;
use crate::exit::Failure;
use crate::file::{already_exists, write_atomically};
use crate::output;
use consort_protocol::keys::ApiCall;
use consort_raft::store::Backup;
use consort_text::count;
use serde_json::Value;
use std::path::PathBuf;

/// Copy the ledger of a running fleet to a file
///
/// The coordinator sends the copy after a majority of the voters has confirmed its leadership. The
/// copy contains every mission that was acknowledged before. The fleet keeps working meanwhile.
/// `consort restore` starts a fleet from the copy when all data directories are lost. While the
/// data directory of any voter is left, `consort recover` loses less.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort backup --out ward.json
  consort backup --out ward-$(date +%F).json --certs certs/kim --connect tls/192.0.2.1:7447

  # the same with any Zenoh client, or curl and a router with the REST plug-in
  curl -s http://127.0.0.1:8000/consort/ward/api/backup

The file shows fleet, time, node and number of missions as plain text. The ledger itself is compressed by gzip and encoded in base64.")]
pub(crate) struct Args {
    /// The file; an existing file is not replaced without --force
    #[arg(long, env = "CONSORT_OUT", value_name = "FILE.json")]
    out: PathBuf,
    /// Replace an existing file
    #[arg(long)]
    force: bool,
    /// Print the copy's metadata as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    client: ClientFlags,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] if the file exists or cannot be written; [`Failure::Unreachable`] if there is
/// no coordinator; [`Failure::Unsuccessful`] if the copy is damaged.
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let Args { out, force, json, client } = args;
    if !force && out.exists() {
        return Err(already_exists(&out));
    }
    let given = client.with_client(async |client| client.api(ApiCall::Backup, &()).await)?;
    let damaged = |problem: String| Failure::Unsuccessful(format!("the copy is damaged: {problem}"));
    let backup: Backup = serde_json::from_value(given.clone()).map_err(|problem| damaged(problem.to_string()))?;
    // Damage must be found now and not when the copy is needed.
    backup.decode().map_err(|problem| damaged(problem.to_string()))?;
    write_atomically(&out, &format!("{given}\n"), 0o600)?;
    let Backup { fleet, by, term, index, missions, under_way, .. } = &backup;
    if json {
        let mut metadata = given;
        metadata["ledger"] = Value::Null;
        return output::line(metadata);
    }
    output::line(format_args!(
        "{}: the ledger of {fleet} up to entry {term}.{index}, given by {by}: {}, of which {}",
        out.display(),
        count(*missions, "mission", "missions"),
        count(*under_way, "has not ended", "have not ended")
    ))
}
