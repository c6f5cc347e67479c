//! `consort backup`: a copy of the ledger of a fleet that works.

use crate::client::ClientFlags;
use crate::exit::Failure;
use crate::file::{already_exists, write_atomically};
use crate::output;
use consort_actors::store::Backup;
use consort_protocol::count::count;
use consort_protocol::keys::ApiCall;
use serde_json::{Value, json};
use std::path::PathBuf;

/// Copy the ledger of a running fleet to a file
///
/// The coordinator gives the copy, once a majority of the voters has said that it still is one: every mission that was acknowledged
/// before is in it. The fleet works on meanwhile. `consort restore` founds a fleet on it, when all data directories are lost; as long
/// as one of a voter is left, `consort recover` loses less.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort backup --out ward.json
  consort backup --out ward-$(date +%F).json --certs certs/kim --connect tls/192.0.2.1:7447

  # the same with any Zenoh client, or curl and a router with the REST plug-in
  curl -s http://127.0.0.1:8000/consort/ward/api/backup

What is in it can be read: fleet, when, by whom, how many missions; the ledger itself is packed by gzip and written in base64.")]
pub struct Args {
    /// The file; one that is there already is not replaced without --force
    #[arg(long, env = "CONSORT_OUT", value_name = "FILE.json")]
    out: PathBuf,
    /// Replace the file if there is one
    #[arg(long)]
    force: bool,
    /// Print what was copied as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    client: ClientFlags,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] if the file is there already or cannot be written; [`Failure::Unreached`] if nobody coordinates;
/// [`Failure::Unsuccessful`] if what was given is not whole.
pub fn run(args: Args) -> Result<(), Failure> {
    let Args { out, force, json, client } = args;
    if !force && out.exists() {
        return Err(already_exists(&out));
    }
    let given = client.with_client(async |client| client.api(ApiCall::Backup, &json!({})).await)?;
    let unsound = |problem: String| Failure::Unsuccessful(format!("what was given is not whole: {problem}"));
    let backup: Backup = serde_json::from_value(given.clone()).map_err(|problem| unsound(problem.to_string()))?;
    // Nobody wants to learn of it when the copy is needed.
    backup.decode().map_err(unsound)?;
    write_atomically(&out, &format!("{given}\n"), 0o600)?;
    let Backup { fleet, by, term, index, missions, under_way, .. } = &backup;
    if json {
        let mut said = given;
        said["ledger"] = Value::Null;
        return output::line(said);
    }
    output::line(format_args!(
        "{}: the ledger of {fleet} up to entry {term}.{index}, given by {by}: {}, of which {}",
        out.display(),
        count(*missions, "mission", "missions"),
        count(*under_way, "has not ended", "have not ended")
    ))
}
