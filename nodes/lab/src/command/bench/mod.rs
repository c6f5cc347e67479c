//! `consort-lab bench`: measures the simulator and fleets on this machine.

mod commit;
mod regions;
mod relays;
mod scale;
mod scale_plot;
mod swarm;
mod takeover;

use clap::{Args as ClapArgs, Subcommand};
use consort_nodes::exit::Failure;
use consort_skills::extensions::Extensions;
use consort_tests::host_network::run_inside;

/// Measures the simulator and fleets on this machine.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  consort-lab bench swarm --drones 80,200
  consort-lab bench scale --robots 50,200 --json
  consort-lab bench commit --missions 100,1000
  consort-lab bench relays --robots 100
  consort-lab bench regions --sites 4
  consort-lab bench takeover --kills 100")]
pub(crate) struct Args {
    /// The benchmark
    #[command(subcommand)]
    what: Benchmark,
}

#[derive(Debug, Subcommand)]
enum Benchmark {
    Swarm(swarm::Args),
    Scale(scale::Args),
    Commit(commit::Args),
    Relays(relays::Args),
    Regions(regions::Args),
    Takeover(takeover::Args),
    #[command(hide = true)]
    RelayHost(relays::HostArgs),
}

/// Runs the command.
///
/// # Errors
/// As those of the benchmark.
pub(crate) fn run(args: Args, extensions: Extensions) -> Result<(), Failure> {
    match args.what {
        Benchmark::Swarm(args) => swarm::run(args),
        Benchmark::Scale(args) => scale::run(args, extensions),
        Benchmark::Commit(args) => commit::run(args),
        Benchmark::Relays(args) => relays::run(&args),
        Benchmark::Regions(args) => regions::run(&args),
        Benchmark::Takeover(args) => takeover::run(&args),
        Benchmark::RelayHost(args) => relays::run_host(args),
    }
}

/// Runs this program again with these arguments, in its own namespaces.
fn run_in_namespaces(arguments: &[&str], tools: &[&str]) -> Result<(), Failure> {
    let status = run_inside(arguments, tools, &std::process::id().to_string())
        .map_err(|reason| Failure::Usage(format!("there can be no namespaces here: {reason}")))?;
    let failed = || Failure::Unsuccessful("a run failed".to_owned());
    status.success().then_some(()).ok_or_else(failed)
}
