//! `consort-lab experiment shift`: many missions at a time.

use clap::Args as ClapArgs;
use consort_nodes::exit::Failure;
use consort_nodes::output::{self, Progress};
use consort_tests::percentiles::Percentiles;
use consort_tests::shift::{ShiftFigures, ShiftSetup, run as run_shift};
use std::cell::RefCell;

/// Measures the throughput of a fleet: many missions at a time, on virtual time
///
/// Robots carry lab samples from nurses in random rooms of the hospital to the arms in the laboratory, with world time
/// as fast as node time. Without promises (0), a mission starts when all its robots are free. With promises it
/// starts with a free carrier; the arm is promised to it, and gets the role when the sample has arrived.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  consort-lab experiment shift                                # 12 robots, one arm, 48 missions, without and with promises
  consort-lab experiment shift --missions 100 --per-hour 60 --json
  consort-lab experiment shift --robots 20 --arms 2 --promises 0,1,4,16

With --json: an object for each number of promises. Times are in seconds of world time; wall_s is the duration of the run.
The same seed gives the same figures on any machine, except wall_s.")]
pub(super) struct Args {
    /// Number of robots that carry samples
    #[arg(long, value_name = "N", default_value_t = 12,
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=200))]
    robots: usize,
    /// Number of arms in the laboratory
    #[arg(long, value_name = "N", default_value_t = 1,
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=20))]
    arms: usize,
    /// Number of missions
    #[arg(long, value_name = "N", default_value_t = 48,
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=10_000))]
    missions: usize,
    /// Mean number of requests per hour, as a Poisson process [default: all requests at once]
    #[arg(long, value_name = "N", value_parser = rate)]
    per_hour: Option<f64>,
    /// Maximum number of roles that are promised to a robot: a run for each number
    #[arg(long, value_name = "N,…", value_delimiter = ',', default_values_t = [0, 16])]
    promises: Vec<u32>,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print a JSON object for each run
    #[arg(long)]
    json: bool,
}

fn rate(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number: &f64| (0.1..=100_000.0).contains(number));
    number.ok_or_else(|| format!("{text:?}, allowed is a number from 0.1 to 100000"))
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] if the output cannot be written.
pub(super) fn run(args: &Args) -> Result<(), Failure> {
    let &Args { robots, arms, missions, per_hour, ref promises, seed, json } = args;
    if !json {
        output::line(HEADER)?;
    }
    for &promises in promises {
        let progress = RefCell::new(Progress::on_terminal());
        let figures = run_shift(ShiftSetup { robots, arms, missions, per_hour, promises, seed }, |ended| {
            progress.borrow_mut().show(format_args!("{promises} promises: {ended} of {missions} missions have ended"));
        });
        drop(progress);
        if json {
            output::json(&figures)?;
        } else {
            output::line(row(&figures))?;
        }
    }
    Ok(())
}

const HEADER: &str = "\
promises  missions   all     missions  start s          completed after s  messages  wall
          completed  s       per hour  p50     p95      p50     p95                  s";

fn row(figures: &ShiftFigures) -> String {
    let pair = |percentiles: Option<Percentiles>| match percentiles {
        Some(Percentiles { p50, p95, .. }) => format!("{p50:<7.0} {p95:<8.0}"),
        None => format!("{:<7} {:<8}", "-", "-"),
    };
    format!(
        "{:<9} {:<10} {:<7.0} {:<9.1} {} {}   {:<9} {:.0}",
        figures.promises,
        format!("{} of {}", figures.completed, figures.missions),
        figures.all_s,
        figures.per_hour,
        pair(figures.start_s),
        pair(figures.mission_s),
        figures.messages,
        figures.wall_s,
    )
}
