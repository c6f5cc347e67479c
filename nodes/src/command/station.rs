//! `consort station`: a node without a robot.

use super::flags::{BusFlags, FleetFlags, RunFlags, StoreFlags, print_config, set, settled};
use crate::config::{FleetRef, StationConfig, load};
use crate::exit::Failure;
use crate::running;
use crate::wiring::{Life, station_node};
use consort_protocol::ids::NodeId;
use std::path::PathBuf;

/// Run a node without a robot, which keeps the ledger and may coordinate
///
/// Stationary nodes on mains power are preferred as keepers of the ledger: three of them carry a fleet of any size. It
/// runs until Ctrl-C or SIGTERM.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort station --config nodes/examples/station.toml
  consort station --name ward-1 --data-dir /var/lib/consort --listen tcp/0.0.0.0:7447 --bootstrap-expect 3
  consort station --name ward-2 --connect tcp/192.0.2.7:7447 --bootstrap-expect 3

The keys of the file are those of nodes/examples/station.toml, each explained there.")]
pub struct Args {
    /// The station file. Without one, the name is given as a flag
    #[arg(long, env = "CONSORT_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
    #[command(flatten)]
    station: StationFlags,
    #[command(flatten)]
    store: StoreFlags,
    #[command(flatten)]
    bus: BusFlags,
    #[command(flatten)]
    fleet: FleetFlags,
    #[command(flatten)]
    run: RunFlags,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Station")]
struct StationFlags {
    /// Its name, unique in the fleet
    #[arg(long, env = "CONSORT_NAME")]
    name: Option<NodeId>,
    /// Whether it stays where it is
    #[arg(long, env = "CONSORT_STATIONARY", value_name = "BOOL", num_args = 0..=1, default_missing_value = "true")]
    stationary: Option<bool>,
    /// Whether it lives on mains power
    #[arg(long, env = "CONSORT_MAINS_POWERED", value_name = "BOOL", num_args = 0..=1, default_missing_value = "true")]
    mains_powered: Option<bool>,
    /// Whether it may keep a copy of the ledger, and coordinate
    #[arg(long, env = "CONSORT_MAY_VOTE", value_name = "BOOL", num_args = 0..=1, default_missing_value = "true")]
    may_vote: Option<bool>,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for wrong configuration; [`Failure::Unsuccessful`] if the node fails.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut station: StationConfig = match (&args.config, &args.station.name) {
        (Some(path), _) => load(path)?,
        (None, Some(name)) => StationConfig::new(name.clone()),
        (None, None) => return Err(Failure::Usage("--name NAME or --config FILE is needed".to_owned())),
    };
    let given = args.station;
    set(&mut station.name, given.name);
    set(&mut station.stationary, given.stationary);
    set(&mut station.mains_powered, given.mains_powered);
    set(&mut station.may_vote, given.may_vote);
    args.store.apply(&mut station.data_dir);
    args.bus.apply(&mut station.bus);
    let fleet = args.fleet.resolve(&station.fleet)?;
    station.fleet = FleetRef::Table(Box::new(fleet.clone()));
    settled(&mut station)?;
    if args.run.print_config {
        return print_config(&station);
    }
    running::node(args.run, &station.bus, &fleet, || {
        station_node(&station, &fleet, Life::real(&station.name, &fleet, station.data_dir.as_deref())?)
    })
}
