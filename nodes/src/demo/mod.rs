//! `consort demo`: the main job, played once from beginning to end.
//!
//! ```text
//!  Cast ─▶ Stage (processes over Zenoh, or one process on virtual time)
//!             ▲ kill, restart            │ bus
//!             └──────── Director ◀───────┘ events, views, requests
//!                          │
//!                       Narrator ─▶ timeline and progress bars, or JSON lines
//! ```
//!
//! The director and the narrator cannot tell the two stages apart.

mod fleet;
mod process_fleet;
mod reporter;
mod runner;
mod scenario;
mod virtual_fleet;

pub use fleet::DemoFleet;
pub use process_fleet::ProcessFleet;
pub use scenario::{DemoScenario, MissionRequest};

use crate::address::BoundAddress;
use crate::admission::Admission;
use crate::dashboard::Dashboard;
use crate::exit::Failure;
use crate::fleet_model::FloorPlan;
use crate::rendering::{self, RenderFlags};
use crate::{map_loader, output};
use reporter::DemoReporter;
use runner::{DemoOptions, DemoRunner};
use std::net::SocketAddr;
use virtual_fleet::VirtualFleet;

/// Play the main job: a fleet delivers lab samples and survives the death of its coordinator
///
/// Starts a hospital, robots and an arm as processes that talk over Zenoh on loopback, submits lab samples, kills the
/// process that coordinates while the mission runs, and ends with the sample in the laboratory.
#[derive(Debug, Clone, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort demo                          the main job: a fleet of processes, its coordinator killed on the way
  consort demo --missions 3 --robots 8  more of it
  consort demo --virtual --seed 7       the same fleet on virtual time: one seed gives one run
  consort demo --virtual --record run.mcap --svg paths.svg    to look at it afterwards, in Foxglove and as a picture
  consort demo --json | jq .event       every event as a line of JSON
  consort demo --keep-running           leave the fleet up afterwards, to look at it (Ctrl-C ends it)

Exit codes: 0 all samples are in the laboratory; 1 they are not; 2 the flags are wrong; 130 interrupted.")]
pub struct Args {
    /// Mobile robots
    #[arg(long, default_value_t = 6, value_parser = clap::value_parser!(u16).range(1..=100))]
    robots: u16,
    /// Missions, submitted together
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=100))]
    missions: u16,
    /// Leave the coordinator alive
    #[arg(long)]
    no_kill: bool,
    /// World seconds that pass in a second [default: such that the demo takes under a minute]
    #[arg(long, value_name = "X", value_parser = speed)]
    speed: Option<f64>,
    /// What the robots' places and the nurses' pace are drawn from
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
    /// First of the ports on which the processes listen [default: free ones]
    #[arg(long, value_name = "PORT", conflicts_with = "virtual_time")]
    port: Option<u16>,
    /// Where to serve the dashboard [default: any free port on loopback]
    #[arg(long, value_name = "HOST:PORT", conflicts_with = "virtual_time")]
    dashboard: Option<SocketAddr>,
    /// Mission to submit: a shipped one's name, or a file
    #[arg(long, default_value = "lab-samples", value_name = "NAME|FILE")]
    mission: String,
    #[command(flatten)]
    render: RenderFlags,
}

fn speed(text: &str) -> Result<f64, String> {
    let speed: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if (0.1..=200.0).contains(&speed) { Ok(speed) } else { Err("allowed is 0.1 to 200".to_owned()) }
}

impl Args {
    /// Under a minute: three missions run side by side in some 25 s at 8 world seconds a second.
    fn speed(&self) -> f64 {
        self.speed.unwrap_or_else(|| 8.0 * f64::from(self.missions.div_ceil(3)).min(5.0))
    }
}

/// Plays the demo.
///
/// # Errors
/// [`Failure`] when it does not end with every sample in the laboratory.
pub fn run(args: Args) -> Result<(), Failure> {
    let mission = runner::mission_request(&args.mission)?;
    if args.render.is_enabled() && !args.virtual_time {
        let what = "--record and --svg go with --virtual; of a fleet of processes, `consort world` records its world";
        return Err(Failure::Usage(what.to_owned()));
    }
    let cast = DemoScenario::new(usize::from(args.robots), usize::from(args.missions), args.speed(), args.seed);
    let narrator = DemoReporter::new(args.json, &cast);
    let plan = DemoOptions { kill: !args.no_kill, keep_running: args.keep_running, mission };
    if args.virtual_time {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build();
        let runtime = runtime.map_err(|problem| Failure::Unsuccessful(format!("no runtime: {problem}")))?;
        runtime.block_on(async {
            let stage = VirtualFleet::start(&cast, args.seed, &args.render).await?;
            let world = stage.world();
            let played = DemoRunner::new(plan, cast, stage, narrator, None).run().await;
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
            let address = BoundAddress::bind("--dashboard", address).await.map_err(Failure::Usage)?;
            let plan_of_floor = FloorPlan::new(&map_loader::load(&cast.fleet.map)?);
            let stage = ProcessFleet::start(&cast, &program, args.port).await?;
            let dashboard =
                Dashboard::open(address, Admission::open(), stage.bus(), &cast.fleet.name, "demo", plan_of_floor);
            DemoRunner::new(plan, cast, stage, narrator, Some(dashboard)).run().await
        })
    }
}
