//! `consort station`: runs a node without a robot.

use super::flags::{NodeFlags, VoterFlags, set};
use crate::config::{StationConfig, load_unchecked};
use crate::exit::Failure;
use crate::wiring::station_node;
use consort_protocol::ids::NodeId;
use consort_skills::extensions::Extensions;
use std::path::PathBuf;

/// Run a node without a robot, which keeps the ledger and may coordinate
///
/// Stationary nodes on mains power are preferred as voters: three of them carry a fleet of any
/// size. It runs until Ctrl-C or SIGTERM.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort station --config examples/station.toml
  consort station --name ward-1 --data-dir /var/lib/consort --listen tcp/0.0.0.0:7447 --bootstrap-expect 3
  consort station --name ward-2 --connect tcp/192.0.2.7:7447 --bootstrap-expect 3

The keys of the file are those of examples/station.toml, each explained there.")]
pub(crate) struct Args {
    /// The station file. Without it, the name is given as a flag
    #[arg(long, env = "CONSORT_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
    #[command(flatten)]
    station: StationFlags,
    #[command(flatten)]
    node: NodeFlags,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Station")]
struct StationFlags {
    /// Its name, unique in the fleet
    #[arg(long, env = "CONSORT_NAME")]
    name: Option<NodeId>,
    #[command(flatten)]
    keeper: VoterFlags,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for wrong configuration; [`Failure::Unsuccessful`] if the node fails.
pub(crate) fn run(args: Args, extensions: Extensions) -> Result<(), Failure> {
    let mut station: StationConfig = match (&args.config, &args.station.name) {
        (Some(path), _) => load_unchecked(path)?,
        (None, Some(name)) => StationConfig::new(name.clone()),
        (None, None) => return Err(Failure::Usage("--name NAME or --config FILE is needed".to_owned())),
    };
    let given = args.station;
    set(&mut station.name, given.name);
    set(&mut station.stationary, given.keeper.stationary);
    set(&mut station.mains_powered, given.keeper.mains_powered);
    set(&mut station.may_vote, given.keeper.vote.may_vote);
    args.node.run(args.config.as_deref(), station, extensions, |station, fleet, extensions, incarnation| {
        station_node(station, fleet, incarnation, extensions)
    })
}
