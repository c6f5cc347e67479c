//! `consort demo`: runs the main use case once from beginning to end.
//!
//! ```text
//!  DemoScenario ─▶ DemoFleet (processes over Zenoh, or a single process on virtual time)
//!                    ▲ kill, restart            │ bus
//!                    └──────── DemoRunner ◀─────┘ events, views, requests
//!                                 │
//!                             DemoReporter ─▶ timeline and progress bars, or JSON lines
//! ```
//!
//! The runner and the reporter do not depend on the kind of fleet.

mod events;
mod fleet;
#[cfg(test)]
mod mission_mix;
mod process_fleet;
mod reporter;
mod runner;
mod scenario;
mod virtual_fleet;

pub use fleet::DemoFleet;
pub use process_fleet::ProcessFleet;
pub use scenario::{DemoScenario, MissionRequest};

use crate::command::flag_values::InvalidValue;
use crate::command::flags::PeopleFlags;
use crate::exit::Failure;
use crate::rendering::{self, RenderFlags};
use crate::{map_loader, output};
use consort_dashboard::address::BoundAddress;
use consort_dashboard::admission::Admission;
use consort_dashboard::fleet_model::FloorPlan;
use consort_dashboard::server::{Dashboard, FleetContents};
use consort_driver::{DriverEndpoint, DriverSetting};
use consort_skills::extensions::Extensions;
use reporter::DemoReporter;
use runner::{DemoOptions, DemoRunner, RequestedMission};
use std::net::SocketAddr;
use std::sync::Arc;
use virtual_fleet::VirtualFleet;

/// Run the main use case: a fleet delivers lab samples and survives the failure of its coordinator
///
/// Starts a hospital, robots and an arm as processes that communicate over Zenoh on loopback,
/// submits lab samples, kills the coordinator's process while the mission runs, and ends with the
/// sample in the laboratory.
#[derive(Debug, Clone, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort demo                          the main use case: a fleet of processes, its coordinator is killed
  consort demo --missions 3 --robots 8  more missions and robots
  consort demo --virtual --seed 7       the same fleet on virtual time: the same seed gives the same run
  consort demo --virtual --record run.mcap --svg paths.svg    record it for Foxglove and as an image
  consort demo --json | jq .event       every event as a line of JSON
  consort demo --domain examples/plants/domain.yaml --mission examples/plants/rounds.yaml    another domain
  consort demo --domain domain.yaml --mission mission.yaml --driver 'python3 driver.py'    mobile robots with a driver of your own
  consort demo --virtual --domain domain.yaml --mission ihtn.json --person nurse    a mission in the flat iHTN form
  consort demo --keep-running           leave the fleet running afterwards (Ctrl-C ends it)

Exit codes: 0 all missions are completed, and all samples are in the laboratory; 1 they are not; 2 the flags are wrong; 130 interrupted.")]
pub struct Args {
    /// Number of mobile robots
    #[arg(long, default_value_t = 6, value_parser = clap::value_parser!(u16).range(1..=100))]
    robots: u16,
    /// Number of missions, submitted together
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=100))]
    missions: u16,
    /// Do not kill the coordinator
    #[arg(long)]
    no_kill: bool,
    /// World seconds per second [default: such that the demo takes under a minute]
    #[arg(long, value_name = "X", value_parser = speed)]
    speed: Option<f64>,
    /// Seed of the robots' places and the nurses' speed
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print every event as a line of JSON instead of the timeline
    #[arg(long)]
    json: bool,
    /// Leave the fleet running after the summary, until Ctrl-C
    #[arg(long, conflicts_with = "virtual_time")]
    keep_running: bool,
    /// Run the same fleet in this process on virtual time
    #[arg(long = "virtual")]
    virtual_time: bool,
    /// First port of the processes [default: free ports]
    #[arg(long, value_name = "PORT", conflicts_with = "virtual_time")]
    port: Option<u16>,
    /// Address of the dashboard [default: any free port on loopback]
    #[arg(long, value_name = "HOST:PORT", conflicts_with = "virtual_time")]
    dashboard: Option<SocketAddr>,
    /// Mission to submit: the name of a bundled mission, a mission file, or a file in the flat iHTN form
    /// (JSON)
    #[arg(long, default_value = "lab-samples", value_name = "NAME|FILE")]
    mission: String,
    #[command(flatten)]
    people: PeopleFlags,
    /// Command line of a driver for all mobile robots, in place of the simulator. Their nodes start the
    /// program and exchange JSON lines with it; see docs/reference/driver.md
    #[arg(long, value_name = "COMMAND", value_parser = driver, conflicts_with = "virtual_time")]
    driver: Option<DriverSetting>,
    #[command(flatten)]
    render: RenderFlags,
}

fn speed(text: &str) -> Result<f64, InvalidValue> {
    let speed: f64 = text.parse().map_err(|_| InvalidValue::new("not a number"))?;
    if (0.1..=200.0).contains(&speed) { Ok(speed) } else { Err(InvalidValue::new("allowed is 0.1 to 200")) }
}

fn driver(text: &str) -> Result<DriverSetting, InvalidValue> {
    let words = shlex::split(text).ok_or_else(|| InvalidValue::new("a quote is not closed"))?;
    let mut driver = DriverSetting::Command(words);
    let folder =
        std::env::current_dir().map_err(|problem| InvalidValue::new(format_args!("this folder: {problem}")))?;
    driver.resolve(&folder);
    let endpoint = DriverEndpoint::try_from(driver.clone()).map_err(InvalidValue::new)?;
    endpoint.check_exists().map_err(InvalidValue::new)?;
    Ok(driver)
}

impl Args {
    /// The demo takes under a minute: three parallel missions take about 25 s at 8 world seconds
    /// per second. Drivers live in real time.
    fn speed(&self) -> f64 {
        let usual = if self.driver.is_some() { 1.0 } else { 8.0 * f64::from(self.missions.div_ceil(3)).min(5.0) };
        self.speed.unwrap_or(usual)
    }
}

/// Returns the scenario for these flags, and the mission that the demo submits.
///
/// # Errors
/// [`Failure`] if the mission is unknown or invalid.
fn requested_scenario(args: &Args, extensions: Extensions) -> Result<(DemoScenario, RequestedMission), Failure> {
    let scenario = DemoScenario::new(usize::from(args.robots), usize::from(args.missions), args.speed(), args.seed)
        .with_skills(&extensions.declared_task_types());
    let places = map_loader::load(&scenario.fleet.map)?.topology.places;
    let domain = extensions.domain().with_places(places.into_keys());
    let requested = runner::request_mission(&args.mission, &args.people.people, &domain)?;
    let scenario = scenario.with_participants(&requested.mission, &domain);
    let scenario = if args.keep_running { scenario.with_participants_of_all_missions(&domain) } else { scenario };
    Ok((args.driver.iter().fold(scenario, DemoScenario::with_driver), requested))
}

/// Runs the demo.
///
/// # Errors
/// [`Failure`] if it does not end with every mission completed, and every sample in the laboratory.
pub fn run(args: Args, extensions: Extensions) -> Result<(), Failure> {
    if args.render.is_enabled() && !args.virtual_time {
        let what = "--record and --svg go with --virtual; of a fleet of processes, `consort world` records its world";
        return Err(Failure::Usage(what.to_owned()));
    }
    let (scenario, requested) = requested_scenario(&args, extensions)?;
    let reporter = DemoReporter::new(args.json, &scenario);
    let options = DemoOptions { kill: !args.no_kill, keep_running: args.keep_running, requested };
    if args.virtual_time {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build();
        let runtime = runtime.map_err(|problem| Failure::Unsuccessful(format!("no runtime: {problem}")))?;
        runtime.block_on(async {
            let fleet = VirtualFleet::start(&scenario, args.seed, &args.render, extensions).await?;
            let world = fleet.world();
            let played = DemoRunner::new(options, scenario, fleet, reporter, None).run().await;
            played.and(rendering::finish_recording(&world, |file| output::note(format_args!("{file}"))))
        })
    } else {
        let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
        let runtime = runtime.map_err(|problem| Failure::Unsuccessful(format!("no runtime: {problem}")))?;
        runtime.block_on(async {
            let program = std::env::current_exe();
            let program =
                program.map_err(|problem| Failure::Unsuccessful(format!("this program's own file: {problem}")))?;
            let address = args.dashboard.unwrap_or(SocketAddr::from(([127, 0, 0, 1], 0)));
            let address = BoundAddress::bind("--dashboard", address).await?;
            let contents = FleetContents {
                plan: FloorPlan::new(&map_loader::load(&scenario.fleet.map)?),
                dashboards: vec![],
                missions: Arc::default(),
            };
            let fleet = ProcessFleet::start(&scenario, &program, extensions.domains, args.port).await?;
            let dashboard =
                Dashboard::open(address, Admission::open(), fleet.bus(), &scenario.fleet.name, "demo", contents);
            DemoRunner::new(options, scenario, fleet, reporter, Some(dashboard)).run().await
        })
    }
}
