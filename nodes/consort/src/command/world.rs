//! `consort world`: runs a node with a simulated world.

use super::flags::{MayVoteFlag, NodeFlags, set};
use crate::config::{WorldConfig, load_unchecked};
use crate::exit::Failure;
use crate::rendering::{self, RenderFlags};
use crate::wiring::world_node;
use consort_protocol::ids::NodeId;
use consort_skills::extensions::Extensions;
use std::path::PathBuf;
use tracing::info;

/// Run a node with a simulated world
///
/// The node serves the robot drivers of the simulated robots and acts for people, over the bus, at
/// a multiple of real time. It runs until Ctrl-C or SIGTERM; a fleet of real robots has no world
/// node.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort world --config examples/world.toml
  consort world --config examples/world.toml --speed 20 --seed 7
  consort world --config examples/world.toml --record run.mcap --svg paths.svg

The keys of the file are those of examples/world.toml, each explained there.

Both files are complete once the world has ended by Ctrl-C or SIGTERM. If it is killed, the SVG is empty, and the MCAP file
lacks the last 5 s of world time (or half a second, if that is more of it) and its index: `mcap recover` repairs it.")]
pub struct Args {
    /// The world file
    #[arg(long, env = "CONSORT_CONFIG", value_name = "FILE")]
    config: PathBuf,
    #[command(flatten)]
    world: WorldFlags,
    #[command(flatten)]
    render: RenderFlags,
    #[command(flatten)]
    node: NodeFlags,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "World")]
struct WorldFlags {
    /// The node's name, unique in the fleet
    #[arg(long, env = "CONSORT_NAME")]
    name: Option<NodeId>,
    /// Seed of the world's random numbers
    #[arg(long, env = "CONSORT_SEED", value_parser = clap::value_parser!(u64).range(0..=i64::MAX as u64))]
    seed: Option<u64>,
    /// World seconds per second
    #[arg(long, env = "CONSORT_SPEED", value_name = "FACTOR")]
    speed: Option<f64>,
    #[command(flatten)]
    vote: MayVoteFlag,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for wrong configuration; [`Failure::Unsuccessful`] if the node fails, or if
/// it cannot be recorded.
pub fn run(args: Args, extensions: Extensions) -> Result<(), Failure> {
    let mut world: WorldConfig = load_unchecked(&args.config)?;
    let given = args.world;
    set(&mut world.name, given.name);
    set(&mut world.seed, given.seed);
    set(&mut world.speed, given.speed);
    set(&mut world.may_vote, given.vote.may_vote);
    let render = args.render;
    let mut shown = None;
    let ended = args.node.run(Some(&args.config), world, extensions, |world, fleet, extensions, incarnation| {
        let (settings, shared) = world_node(world, fleet, incarnation, extensions)?;
        render.start_recording(&shared)?;
        shown = Some(shared);
        Ok(settings)
    });
    // The recording is completed in any case. It is most useful after a failure.
    let rendered = shown.map_or(Ok(()), |world| rendering::finish_recording(&world, |file| info!(file, "recorded")));
    ended.and(rendered)
}
