//! `consort-lab bench scale`: measures fleets by size.

use super::scale_plot::draw;
use crate::command::workload_flags::DomainFlags;
use clap::Args as ClapArgs;
use consort_nodes::exit::Failure;
use consort_nodes::output::{self, Progress};
use consort_skills::extensions::Extensions;
use consort_tests::percentiles::Percentiles;
use consort_tests::scale::{ScaleFigures, ScaleSetup, measure};
use std::path::PathBuf;
use std::time::Instant;

/// Measures traffic, computing time and latencies of fleets by size, on the virtual bus.
///
/// The fleet is a hospital with three stations, the robots, and the host of the simulated world. All nodes start at once.
/// Traffic and computing time are measured for 30 s when all nodes know each other. Then missions for one robot are
/// requested in sequence, and each is canceled when it has been awarded; a robot starts with an empty disk; a
/// tenth of the robots is killed at once; and the coordinator is killed ten times.
///
/// Traffic counts keys, payloads and 18 bytes for each message as Zenoh frames it, once for each receiver. Computing time
/// is that of the node itself, without the network. Links have a latency of 0.2 to 3 ms. With `--domain` all robots have
/// the readings of the domain.
///
/// With `--backlog` other missions wait meanwhile for a robot that is not in the fleet. All robots with wheels have the skill for
/// them, so the coordinator auctions some of them again when a robot becomes free or could be awarded, and each of them every 5 s.
/// They are canceled before the robot starts with an empty disk. Compare with a run without a backlog, of the same size and seed.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  consort-lab bench scale                                     # 50, 100 and 200 robots that stand still
  consort-lab bench scale --robots 500 --moving --json | jq .robot_received_bytes_per_s
  consort-lab bench scale --robots 200 --backlog 500          # what 500 missions that wait cost the coordinator
  consort-lab bench scale --robots 7,25,50,100,200,500,1000 --plot scale.svg

With --json: an object for each size. Rates are per second of virtual time; percentages are of a core. auction_ms is the
time from the commit of a request to the commit of the award, commit_ms from a client's request to the acknowledgement;
both include the coordinator's computing time. With a backlog messages_per_auction includes the calls and bids for missions that
wait, as coordinator_cpu_percent includes their auctions. view_ms is the computing time of the coordinator for view/fleet, with its
other work meanwhile. takeover_ms is the time from the kill of the coordinator to the election of the next. wall_s and
virtual_s are of the whole measurement; a ratio of 1 is real time.

The same sizes and seed give the same messages on any machine. Computing times, wall_s, virtual_s and memory_mb depend on the
machine.")]
pub(super) struct Args {
    /// Number of robots: a fleet for each number, from 2 to 2000
    #[arg(long, value_name = "N,…", value_delimiter = ',', default_values_t = [50, 100, 200],
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(2..=2000))]
    robots: Vec<usize>,
    /// Robots drive between neighbouring places
    #[arg(long)]
    moving: bool,
    /// Number of missions, in sequence
    #[arg(long, value_name = "M", default_value_t = 20,
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(0..=10_000))]
    missions: usize,
    /// Number of other missions that wait meanwhile, up to 1000
    #[arg(long, value_name = "N", default_value_t = 0,
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(0..=1000))]
    backlog: usize,
    /// Seed of the random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    domains: DomainFlags,
    /// Draw traffic, computing time and latencies by size into an SVG file
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// Print a JSON object for each size
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for wrong domains; [`Failure::Unsuccessful`] if the plot cannot be written.
pub(super) fn run(args: Args, extensions: Extensions) -> Result<(), Failure> {
    let Args { robots, moving, missions, backlog, seed, domains, plot, json } = args;
    let extensions = domains.extend(extensions)?;
    if !json {
        output::line(HEADER)?;
    }
    let mut all = vec![];
    for robots in robots {
        let (began, progress) = (Instant::now(), std::cell::RefCell::new(Progress::on_terminal()));
        let figures = measure(ScaleSetup { robots, moving, missions, backlog, seed, extensions }, |step| {
            let elapsed = began.elapsed().as_secs();
            progress.borrow_mut().show(format_args!("{robots} robots, after {elapsed} s: {step}"));
        });
        drop(progress);
        if json {
            output::json(&figures)?;
        } else {
            output::line(row(&figures))?;
        }
        all.push(figures);
    }
    if let Some(file) = plot {
        draw(&all, &file).map_err(|problem| Failure::Unsuccessful(format!("{}: {problem}", file.display())))?;
    }
    Ok(())
}

const HEADER: &str = "\
robots  moving  backlog  robot receives        coordinator receives  CPU of coordinator  messages/  auction ms  commit ms   takeover ms  join    wall/
                         kB/s    messages/s    kB/s    messages/s    % of a core         auction    p50    p95  p50    p95  p50    p95   kB      virtual";

fn row(figures: &ScaleFigures) -> String {
    let pair = |percentiles: Option<Percentiles>, digits: usize| match percentiles {
        Some(Percentiles { p50, p95, .. }) => format!("{p50:<6.digits$} {p95:<5.digits$}"),
        None => format!("{:<6} {:<5}", "-", "-"),
    };
    format!(
        "{:<7} {:<7} {:<8} {:<7.1} {:<13.0} {:<7.1} {:<13.0} {:<19.1} {:<10.0} {} {} {} {:<7.0} {:.2}",
        figures.robots,
        if figures.moving { "yes" } else { "no" },
        figures.backlog,
        figures.robot_received_bytes_per_s / 1000.0,
        figures.robot_received_messages_per_s,
        figures.coordinator_received_bytes_per_s / 1000.0,
        figures.coordinator_received_messages_per_s,
        figures.coordinator_cpu_percent,
        figures.messages_per_auction,
        pair(figures.auction_ms, 1),
        pair(figures.commit_ms, 1),
        pair(figures.takeover_ms, 0),
        figures.join_bytes as f64 / 1000.0,
        figures.wall_s / figures.virtual_s,
    )
}
