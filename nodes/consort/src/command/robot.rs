//! `consort robot`: runs the node of a robot.

use super::flag_values::{InvalidValue, quantity, share};
use super::flags::{NodeFlags, VoterFlags, set};
use crate::config::{RobotConfig, load_unchecked};
use crate::exit::Failure;
use crate::wiring::robot_node;
use consort_protocol::ids::{PlaceId, RobotId, TaskType};
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond};
use consort_skills::extensions::Extensions;
use std::path::PathBuf;

/// Run the node of a robot
///
/// The node gossips with the fleet, bids on work, and carries out its awards through its robot
/// driver (of a `consort world`, or of a real robot's adapter on the bus). It may keep the ledger
/// and coordinate. It runs until Ctrl-C or SIGTERM.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort robot --config examples/robot.toml
  consort robot --config robot.toml --connect tcp/192.0.2.7:7447 --listen tcp/0.0.0.0:7447
  consort robot --name ada --place Dock --skills navigation,operate_drawer --speed-mps 0.4 --print-config

The keys of the file are those of examples/robot.toml, each explained there.")]
pub struct Args {
    /// The robot file. Without it, name, place and skills are given as flags
    #[arg(long, env = "CONSORT_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
    #[command(flatten)]
    robot: RobotFlags,
    #[command(flatten)]
    node: NodeFlags,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Robot")]
struct RobotFlags {
    /// Its name, unique in the fleet
    #[arg(long, env = "CONSORT_NAME")]
    name: Option<RobotId>,
    /// Its place until the driver has reported
    #[arg(long, env = "CONSORT_PLACE")]
    place: Option<PlaceId>,
    /// The task types of its skills, separated by commas
    #[arg(long, env = "CONSORT_SKILLS", value_delimiter = ',')]
    skills: Vec<TaskType>,
    /// Its average speed
    #[arg(long, env = "CONSORT_SPEED_MPS", value_name = "MPS", value_parser = speed)]
    speed_mps: Option<MetresPerSecond>,
    /// Charge until the driver has reported, as a share
    #[arg(long, env = "CONSORT_BATTERY", value_name = "SHARE", value_parser = share)]
    battery: Option<BatteryShare>,
    /// Charge used per second of work, as a share
    #[arg(long, env = "CONSORT_DISCHARGE_SHARE_PER_S", value_name = "SHARE", value_parser = rate)]
    discharge_share_per_s: Option<SharePerSecond>,
    /// Charge below which it takes no work, as a share
    #[arg(long, env = "CONSORT_USEFUL_CHARGE", value_name = "SHARE", value_parser = share)]
    useful_charge: Option<BatteryShare>,
    #[command(flatten)]
    keeper: VoterFlags,
}

fn speed(text: &str) -> Result<MetresPerSecond, InvalidValue> {
    quantity(text, MetresPerSecond::new)
}

fn rate(text: &str) -> Result<SharePerSecond, InvalidValue> {
    quantity(text, SharePerSecond::new)
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for wrong configuration; [`Failure::Unsuccessful`] if the node fails.
pub fn run(args: Args, extensions: Extensions) -> Result<(), Failure> {
    let mut robot: RobotConfig = match (&args.config, &args.robot.name, &args.robot.place) {
        (Some(path), _, _) => load_unchecked(path)?,
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
    set(&mut robot.stationary, given.keeper.stationary);
    set(&mut robot.mains_powered, given.keeper.mains_powered);
    set(&mut robot.may_vote, given.keeper.vote.may_vote);
    args.node.run(args.config.as_deref(), robot, extensions, |robot, fleet, extensions, incarnation| {
        robot_node(robot, fleet, incarnation, extensions)
    })
}
