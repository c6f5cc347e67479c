//! `consort keys`: lists every key that a fleet uses.

use crate::config::DEFAULT_FLEET;
use crate::exit::Failure;
use crate::output;
use consort_protocol::keys::{KeyInfo, KeyUsage, TABLE};
use serde::Serialize;

/// List every key that a fleet uses on Zenoh
///
/// Each row has the owner, the usage, the encoding and a description. Keys for people come first
/// (view, seen, api, events, alive), then keys between nodes (wire). The table comes from the
/// module that writes and parses the keys.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort keys
  consort keys --fleet ward --json")]
pub struct Args {
    /// The name of the fleet
    #[arg(long, value_name = "NAME", default_value = DEFAULT_FLEET)]
    fleet: consort_protocol::ids::FleetId,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// The table of keys, as `--json` prints it.
#[derive(Serialize)]
struct KeyTable {
    keys: Vec<KeyLine>,
}

#[derive(Serialize)]
struct KeyLine {
    key: String,
    owner: &'static str,
    usage: KeyUsage,
    /// `null` if the key has no content.
    encoding: Option<&'static str>,
    what: &'static str,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::OutputClosed`].
pub fn run(args: Args) -> Result<(), Failure> {
    let key = |about: &KeyInfo| format!("consort/{}/{}", args.fleet, about.pattern);
    if args.json {
        let keys = TABLE.iter().map(|about| KeyLine {
            key: key(about),
            owner: about.owner,
            usage: about.usage,
            encoding: Some(about.encoding).filter(|encoding| !encoding.is_empty()),
            what: about.what,
        });
        return output::json(&KeyTable { keys: keys.collect() });
    }
    let heads = ["KEY", "OWNER", "", "ENCODING", "DESCRIPTION"].map(str::to_owned).to_vec();
    let rows = TABLE.iter().map(|about| {
        let encoding = if about.encoding.is_empty() { "-" } else { about.encoding };
        vec![
            key(about),
            about.owner.to_owned(),
            about.usage.as_str().to_owned(),
            encoding.to_owned(),
            about.what.to_owned(),
        ]
    });
    output::line(output::table(&std::iter::once(heads).chain(rows).collect::<Vec<_>>()))
}
