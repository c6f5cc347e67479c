//! `consort-lab bench swarm`: measures the speed of the simulator.

use clap::Args as ClapArgs;
use consort_nodes::exit::Failure;
use consort_nodes::output::{self, Progress};
use consort_world::swarm::{Swarm, TABLE_HEADER, run_swarm};
use std::num::NonZeroUsize;
use std::time::{Duration, Instant};

/// Flies a swarm of drones and measures the computing time of a simulated second.
///
/// Drones take off from a field, and a controller sends each to its own place on circles. They
/// avoid each other. A drone that has arrived hovers, pushed by wind gusts. The run ends when all
/// have arrived or crashed, or when no drone has arrived for 15 simulated seconds.
///
/// Each line is a swarm: its duration in the simulation; the minimum, maximum and mean computing
/// time of a simulated second on this machine; and the numbers of drones that arrived and crashed.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  consort-lab bench swarm
  consort-lab bench swarm --drones 1000,10000 --seed 7
  consort-lab bench swarm --drones 10000 --threads 1
  consort-lab bench swarm --json | jq .average_s

The same seed and number of drones give the same flight, with any number of threads; the times depend
on the machine.")]
pub(super) struct Args {
    /// Number of drones: a swarm for each number, from 1 to 10000
    #[arg(long, value_name = "N,…", value_delimiter = ',', default_values_t = [20, 40, 60, 80, 100, 150, 200],
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=10_000))]
    drones: Vec<usize>,
    /// Seed of the random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Greatest number of threads: a further one is started only while more than a thousand drones move
    #[arg(long, default_value = "2")]
    threads: NonZeroUsize,
    /// Print a JSON object for each swarm
    #[arg(long)]
    json: bool,
}

/// Interval between progress updates.
const UPDATE_EVERY: Duration = Duration::from_millis(500);

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for an invalid swarm.
pub(super) fn run(args: Args) -> Result<(), Failure> {
    let Args { drones, seed, threads, json } = args;
    if !json {
        output::line(TABLE_HEADER)?;
    }
    for drones in drones {
        let (began, mut asked, mut said) = (Instant::now(), 0_u32, Duration::ZERO);
        let mut progress = Progress::on_terminal();
        // The simulator reads the clock at the beginning and after each simulated second.
        // Occasional output costs next to nothing.
        let clock = || {
            let now = began.elapsed();
            if now > said + UPDATE_EVERY {
                progress.show(format_args!("{drones} drones: {asked} s flown"));
                said = now;
            }
            asked += 1;
            now
        };
        let row = run_swarm(Swarm { drones, seed, threads }, clock).map_err(|why| Failure::Usage(why.to_string()))?;
        drop(progress);
        if json {
            output::json(&row)?;
        } else {
            output::line(row)?;
        }
    }
    Ok(())
}
