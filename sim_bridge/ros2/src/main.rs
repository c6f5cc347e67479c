//! `consort-ros2`: simulated robots for ROS 2, and ROS 2 robots for the fleet.

use clap::{Args, Parser, Subcommand};
use consort_actors::bus::{Bus, SharedBus, ZenohBus, ZenohSettings};
use consort_protocol::ids::{FleetId, PlaceId, RobotId};
use consort_protocol::keys::Keys;
use consort_ros2::drive::{DriveSettings, drive};
use consort_ros2::itinerary::Atlas;
use consort_ros2::ros::{Ros, RosSettings};
use consort_ros2::serve::{ServeSettings, serve};
use consort_sim::map::{self, Map};
use std::error::Error;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, SystemTime};
use tokio::signal::unix::{SignalKind, signal};
use tracing::{error, info, warn};
use tracing_subscriber::EnvFilter;

/// What is logged where nothing else is said: hiroz tells of every query.
const LOG: &str = "info,hiroz=warn,zenoh=error,ractor=warn";

/// How long to wait for a link to the fleet before that is said.
const LINK: Duration = Duration::from_secs(3);

/// Consort and ROS 2, over Zenoh as rmw_zenoh speaks it
#[derive(Debug, Parser)]
#[command(
    version,
    after_long_help = "\
Examples:
  consort-ros2 serve --connect tcp/127.0.0.1:7448 --map hospital
  consort-ros2 drive --connect tcp/127.0.0.1:7448 --map hospital --robot ada --place Dock

ROS 2 needs its router (ros2 run rmw_zenoh_cpp rmw_zenohd), at tcp/localhost:7447 unless told otherwise: let the nodes of
the fleet listen elsewhere on that machine."
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// What to log, as error, warn, info, debug or trace, also by module
    #[arg(long, env = "RUST_LOG", global = true, value_name = "FILTER")]
    log: Option<String>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Offer every body that a world of the fleet hosts as an action server /NAME/navigate_to_pose
    Serve {
        #[command(flatten)]
        ends: Ends,
    },
    /// Let a robot of the fleet act through a NavigateToPose action server, a real Nav2 for instance
    Drive {
        #[command(flatten)]
        ends: Ends,
        /// The robot, by the name of its node in the fleet
        #[arg(long, value_name = "NAME")]
        robot: RobotId,
        /// Where it stands at first
        #[arg(long)]
        place: PlaceId,
        /// The action's name
        #[arg(long, default_value = "/navigate_to_pose", value_name = "NAME")]
        action: String,
    },
}

#[derive(Debug, Args)]
struct Ends {
    /// The fleet's name
    #[arg(long, env = "CONSORT_FLEET", default_value = "ward", value_name = "NAME")]
    fleet: FleetId,
    /// A node of the fleet to connect to, as tcp/192.0.2.7:7448; may be given more than once
    #[arg(long, env = "CONSORT_CONNECT", required = true, value_delimiter = ',', value_name = "ADDRESS")]
    connect: Vec<String>,
    /// The fleet's map: the name of one that is shipped, or the path of a file
    #[arg(long, env = "CONSORT_MAP", default_value = "hospital", value_name = "MAP")]
    map: String,
    /// A router of rmw_zenoh to connect to; may be given more than once
    #[arg(long, default_value = "tcp/localhost:7447", value_delimiter = ',', value_name = "ADDRESS")]
    router: Vec<String>,
    /// The domain of the ROS 2 graph
    #[arg(long, env = "ROS_DOMAIN_ID", default_value_t = 0, value_name = "NUMBER")]
    domain: usize,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let filter = EnvFilter::try_new(cli.log.as_deref().unwrap_or(LOG)).unwrap_or_else(|_| EnvFilter::new(LOG));
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).init();
    let ran = tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(Box::from).and_then(|runtime| {
        let ran = runtime.block_on(run(cli.command));
        // Whatever still runs ends with the process.
        runtime.shutdown_background();
        ran
    });
    match ran {
        Ok(()) => ExitCode::SUCCESS,
        Err(problem) => {
            error!("{problem}");
            ExitCode::FAILURE
        }
    }
}

async fn run(command: Command) -> Result<(), Box<dyn Error>> {
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let told = async {
        tokio::select! {
            _ = terminate.recv() => {}
            _ = interrupt.recv() => {}
        }
    };
    tokio::select! {
        ran = work(command) => ran,
        () = told => {
            info!("stops");
            Ok(())
        }
    }
}

async fn work(command: Command) -> Result<(), Box<dyn Error>> {
    match command {
        Command::Serve { ends } => {
            let (map, bus, keys, ros) = ends.open("consort_bridge").await?;
            let since_1970 = SystemTime::UNIX_EPOCH.elapsed()?;
            let first_goal = u64::try_from(since_1970.as_millis())?.saturating_mul(1_000_000);
            let atlas = Arc::new(Atlas::new(map)?);
            Ok(serve(&ros, ServeSettings { bus, keys, atlas, first_goal }).await?)
        }
        Command::Drive { ends, robot, place, action } => {
            let (map, bus, keys, ros) = ends.open("consort_driver").await?;
            let places = map.topology().places;
            Ok(drive(&ros, DriveSettings { bus, keys, robot, place, places, action }).await?)
        }
    }
}

impl Ends {
    /// The map, the fleet's bus and the ROS 2 graph.
    async fn open(self, node: &str) -> Result<(Map, SharedBus, Keys, Ros), Box<dyn Error>> {
        let map = if map::SHIPPED.contains(&self.map.as_str()) {
            map::shipped(&self.map)?
        } else {
            map::load(Path::new(&self.map))?
        };
        let bus = ZenohBus::open(ZenohSettings { connect: self.connect.clone(), ..ZenohSettings::default() }).await?;
        if bus.wait_connected(LINK).await.is_empty() {
            warn!(trying = self.connect.join(", "), "linked to no node of the fleet yet; keeps trying");
        }
        let ros = Ros::join(&RosSettings { routers: self.router, domain: self.domain, node: node.to_owned() })?;
        info!(fleet = %self.fleet, map = map.name(), links = bus.links().await.len(), "open");
        Ok((map, Arc::new(bus), Keys::new(&self.fleet), ros))
    }
}
