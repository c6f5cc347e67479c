//! `consort bench`: how quick the simulator is on this machine.

use crate::exit::Failure;
use crate::output::{self, Progress};
use clap::{Args as ClapArgs, Subcommand};
use consort_sim::swarm::{Swarm, TABLE_HEADER, run_swarm};
use std::time::{Duration, Instant};

/// Measures how quick the simulator is on this machine.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  consort bench swarm --drones 80,200")]
pub struct Args {
    /// What to measure
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Swarm(SwarmArgs),
}

/// Flies a swarm of drones: how long it takes to compute one second of simulation.
///
/// Drones take off from a field, and a controller sends each to a place of its own on circles. They make way for one
/// another; who has arrived hovers, pushed by gusts. It ends when all have arrived or crashed, or when for 15 simulated
/// seconds none has.
///
/// Each line is a swarm: how long it took in the simulation; the least, the most and the mean of the time that one
/// simulated second took on this machine, on one core; and how many drones arrived and crashed.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  consort bench swarm
  consort bench swarm --drones 1000,10000 --seed 7
  consort bench swarm --json | jq .average_s

The same seed and number of drones give the same flight; the times are those of the machine.")]
struct SwarmArgs {
    /// How many drones: a swarm for each number, from 1 to 10000
    #[arg(long, value_name = "N,…", value_delimiter = ',', default_values_t = [20, 40, 60, 80, 100, 150, 200],
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=10_000))]
    drones: Vec<usize>,
    /// What chance comes from
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print a JSON object for each swarm
    #[arg(long)]
    json: bool,
}

/// How often it is said how far a flight is.
const SAY: Duration = Duration::from_millis(500);

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for a swarm that cannot be.
pub fn run(args: Args) -> Result<(), Failure> {
    let What::Swarm(SwarmArgs { drones, seed, json }) = args.what;
    if !json {
        output::line(TABLE_HEADER)?;
    }
    for drones in drones {
        let (began, mut asked, mut said) = (Instant::now(), 0_u32, Duration::ZERO);
        let mut progress = Progress::on_terminal();
        // It asks for the time at the beginning and after each simulated second. To say so now and then costs next to nothing.
        let clock = || {
            let now = began.elapsed();
            if now > said + SAY {
                progress.show(format_args!("{drones} drones: {asked} s flown"));
                said = now;
            }
            asked += 1;
            now
        };
        let row = run_swarm(Swarm { drones, seed }, clock).map_err(|why| Failure::Usage(why.to_string()))?;
        drop(progress);
        if json {
            output::line(serde_json::to_string(&row).expect("numbers are JSON"))?;
        } else {
            output::line(row)?;
        }
    }
    Ok(())
}
