//! `consort robot`: the node of a robot.

use super::flags::{BusFlags, FleetFlags, RunFlags, StoreFlags, print_config, quantity, set, settled, share};
use crate::config::{FleetRef, RobotConfig, load};
use crate::exit::Failure;
use crate::running;
use crate::wiring::{Life, robot_node};
use consort_protocol::ids::{NodeId, PlaceId, RobotId, TaskType};
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond};
use std::path::PathBuf;

/// Run the node of a robot
///
/// It gossips with the fleet, bids on work, carries out what it is awarded through its body (of a `consort world`, or of a
/// real robot's adapter on the bus), and may keep the ledger and coordinate. It runs until Ctrl-C or SIGTERM.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort robot --config nodes/examples/robot.toml
  consort robot --config robot.toml --connect tcp/192.0.2.7:7447 --listen tcp/0.0.0.0:7447
  consort robot --name ada --place Dock --skills navigation,operate_drawer --speed-mps 0.4 --print-config

The keys of the file are those of nodes/examples/robot.toml, each explained there.")]
pub struct Args {
    /// The robot file. Without one, name, place and skills are given as flags
    #[arg(long, env = "CONSORT_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
    #[command(flatten)]
    robot: RobotFlags,
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
#[command(next_help_heading = "Robot")]
struct RobotFlags {
    /// Its name, unique in the fleet
    #[arg(long, env = "CONSORT_NAME")]
    name: Option<RobotId>,
    /// Where it is until its body has reported
    #[arg(long, env = "CONSORT_PLACE")]
    place: Option<PlaceId>,
    /// The task types it has skills for, with commas between
    #[arg(long, env = "CONSORT_SKILLS", value_delimiter = ',')]
    skills: Vec<TaskType>,
    /// Its average speed
    #[arg(long, env = "CONSORT_SPEED_MPS", value_name = "MPS", value_parser = speed)]
    speed_mps: Option<MetresPerSecond>,
    /// Charge until its body has reported, as a share
    #[arg(long, env = "CONSORT_BATTERY", value_name = "SHARE", value_parser = share)]
    battery: Option<BatteryShare>,
    /// Charge that it loses in a second of work, as a share
    #[arg(long, env = "CONSORT_DISCHARGE_SHARE_PER_S", value_name = "SHARE", value_parser = rate)]
    discharge_share_per_s: Option<SharePerSecond>,
    /// Below this charge it takes no work, as a share
    #[arg(long, env = "CONSORT_USEFUL_CHARGE", value_name = "SHARE", value_parser = share)]
    useful_charge: Option<BatteryShare>,
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

fn speed(text: &str) -> Result<MetresPerSecond, String> {
    quantity(text, MetresPerSecond::new)
}

fn rate(text: &str) -> Result<SharePerSecond, String> {
    quantity(text, SharePerSecond::new)
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for wrong configuration; [`Failure::Unsuccessful`] if the node fails.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut robot: RobotConfig = match (&args.config, &args.robot.name, &args.robot.place) {
        (Some(path), _, _) => load(path)?,
        (None, Some(name), Some(place)) => {
            RobotConfig::new(name.clone(), place.clone(), args.robot.skills.iter().cloned().collect())
        }
        _ => return Err(Failure::Usage("--config FILE is needed, or --name, --place and --skills".to_owned())),
    };
    let given = args.robot;
    set(&mut robot.name, given.name);
    set(&mut robot.place, given.place);
    if !given.skills.is_empty() {
        robot.skills = given.skills.into_iter().collect();
    }
    robot.speed_mps = given.speed_mps.or(robot.speed_mps);
    set(&mut robot.battery, given.battery);
    set(&mut robot.discharge_share_per_s, given.discharge_share_per_s);
    set(&mut robot.useful_charge, given.useful_charge);
    set(&mut robot.stationary, given.stationary);
    set(&mut robot.mains_powered, given.mains_powered);
    set(&mut robot.may_vote, given.may_vote);
    args.store.apply(&mut robot.data_dir);
    args.bus.apply(&mut robot.bus);
    let fleet = args.fleet.resolve(&robot.fleet)?;
    robot.fleet = FleetRef::Table(Box::new(fleet.clone()));
    settled(&mut robot)?;
    if args.run.print_config {
        return print_config(&robot);
    }
    let node = NodeId::from(robot.name.clone());
    running::node(args.run, &robot.bus, &fleet, || {
        robot_node(&robot, &fleet, Life::real(&node, &fleet, robot.data_dir.as_deref())?)
    })
}
