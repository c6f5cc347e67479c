//! `consort-ros2`: simulated robots for ROS 2, and ROS 2 robots for the fleet.

use clap::{Args, Parser, Subcommand};
use consort_bus::{Bus, SharedBus, ZenohBus, ZenohSettings};
use consort_protocol::ids::{FleetId, PlaceId, RobotId};
use consort_protocol::keys::Keys;
use consort_ros2::described::check::problems;
use consort_ros2::described::description::{self, RobotDescription};
use consort_ros2::described::run;
use consort_ros2::doctor::{SERVE_NODE, examine, wait_for_needed};
use consort_ros2::drive::{DriveSettings, drive};
use consort_ros2::dynamic::graph::{Graph, GraphSettings};
use consort_ros2::dynamic::types::TypeRegistry;
use consort_ros2::ros::{Ros, RosError, RosSettings};
use consort_ros2::route_planner::RoutePlanner;
use consort_ros2::serve::{ServeSettings, serve};
use consort_world::map::{self, Map};
use std::error::Error;
use std::future::Future;
use std::io::Write as _;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, SystemTime};
use tokio::signal::unix::{SignalKind, signal};
use tracing::{error, info, warn};
use tracing_subscriber::EnvFilter;

/// Default log filter: hiroz logs every query.
const LOG: &str = "info,hiroz=warn,zenoh=error,ractor=warn";

/// Time to wait for another bridge of the same fleet.
const OTHERS_WITHIN: Duration = Duration::from_secs(1);

/// Time to wait for a link to the fleet before a warning.
const LINK_WARNING_AFTER: Duration = Duration::from_secs(3);

/// Consort and ROS 2, over Zenoh in the format of rmw_zenoh
#[derive(Debug, Parser)]
#[command(
    version,
    after_long_help = "\
Examples:
  consort-ros2 serve --connect tcp/127.0.0.1:7448 --map hospital
  consort-ros2 drive --connect tcp/127.0.0.1:7448 --map hospital --robot ada --place Dock
  consort-ros2 check robot.yaml
  consort-ros2 doctor robot.yaml
  consort-ros2 driver robot.yaml          # as `driver` in the robot file of `consort robot`

ROS 2 needs its router (ros2 run rmw_zenoh_cpp rmw_zenohd), by default at tcp/localhost:7447. The nodes of
the fleet must listen at another port on that machine."
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Log filter: error, warn, info, debug or trace, also by module
    #[arg(long, env = "RUST_LOG", global = true, value_name = "FILTER")]
    log: Option<String>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Offer every simulated robot of the fleet's world as an action server /NAME/navigate_to_pose
    Serve {
        #[command(flatten)]
        connection: ConnectionArgs,
    },
    /// Let a robot of the fleet drive through a NavigateToPose action server, for example a real
    /// Nav2
    Drive {
        #[command(flatten)]
        connection: ConnectionArgs,
        /// Robot, by the name of its node in the fleet
        #[arg(long, value_name = "NAME")]
        robot: RobotId,
        /// Place of the robot at the start
        #[arg(long)]
        place: PlaceId,
        /// Name of the action
        #[arg(long, default_value = "/navigate_to_pose", value_name = "NAME")]
        action: String,
    },
    /// Be the driver of a robot or a device that a file describes: JSON lines on the standard streams
    Driver {
        /// Description: a file, or the name of a shipped one (nav2, nav2_moves, turtlebot, rmf_door, rmf_lift)
        file: String,
        #[command(flatten)]
        graph: GraphArgs,
    },
    /// Check the description of a robot or a device without it
    Check {
        /// Description: a file, or the name of a shipped one (nav2, nav2_moves, turtlebot, rmf_door, rmf_lift)
        file: String,
    },
    /// Print the JSON Schema of descriptions
    Schema,
    /// Print the shipped types with their hashes
    Types,
    /// Show the nodes of the graph, the types and hashes, and what does not fit a description
    Doctor {
        /// Description: a file, or the name of a shipped one; without it, everything is listed
        file: Option<String>,
        /// Time to wait for nodes, in seconds; less if the graph has what the description needs
        #[arg(long, default_value_t = 3.0, value_name = "SECONDS")]
        wait: f64,
        #[command(flatten)]
        graph: GraphArgs,
    },
}

#[derive(Debug, Args)]
struct GraphArgs {
    /// Router of rmw_zenoh to connect to; may be given more than once
    #[arg(
        long,
        env = "CONSORT_ROS_ROUTER",
        default_value = "tcp/localhost:7447",
        value_delimiter = ',',
        value_name = "ADDRESS"
    )]
    router: Vec<String>,
    /// Domain of the ROS 2 graph
    #[arg(long, env = "ROS_DOMAIN_ID", default_value_t = 0, value_name = "NUMBER")]
    domain: usize,
}

impl GraphArgs {
    async fn join(self, node: &str, namespace: String, types: TypeRegistry) -> Result<Graph, RosError> {
        let settings = GraphSettings { routers: self.router, domain: self.domain, node: node.to_owned(), namespace };
        Graph::join(settings, types).await
    }
}

#[derive(Debug, Args)]
struct ConnectionArgs {
    /// Name of the fleet
    #[arg(long, env = "CONSORT_FLEET", default_value = "ward", value_name = "NAME")]
    fleet: FleetId,
    /// Node of the fleet to connect to, as tcp/192.0.2.7:7448; may be given more than once
    #[arg(long, env = "CONSORT_CONNECT", required = true, value_delimiter = ',', value_name = "ADDRESS")]
    connect: Vec<String>,
    /// Map of the fleet: the name of a shipped map, or the path of a file
    #[arg(long, env = "CONSORT_MAP", default_value = "hospital", value_name = "MAP")]
    map: String,
    /// Router of rmw_zenoh to connect to; may be given more than once
    #[arg(long, default_value = "tcp/localhost:7447", value_delimiter = ',', value_name = "ADDRESS")]
    router: Vec<String>,
    /// Domain of the ROS 2 graph
    #[arg(long, env = "ROS_DOMAIN_ID", default_value_t = 0, value_name = "NUMBER")]
    domain: usize,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let filter = EnvFilter::try_new(cli.log.as_deref().unwrap_or(LOG)).unwrap_or_else(|_| EnvFilter::new(LOG));
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).init();
    let result =
        tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(Box::from).and_then(|runtime| {
            let result = runtime.block_on(run(cli.command));
            // Remaining tasks end with the process.
            runtime.shutdown_background();
            result
        });
    match result {
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
    let stop_requested = async move {
        tokio::select! {
            _ = terminate.recv() => {}
            _ = interrupt.recv() => {}
        }
        info!("stopping");
    };
    run_command(command, stop_requested).await
}

async fn run_command(command: Command, stop: impl Future<Output = ()>) -> Result<(), Box<dyn Error>> {
    match command {
        Command::Serve { connection } => {
            let graph = GraphArgs { router: connection.router.clone(), domain: connection.domain };
            let node = format!("{SERVE_NODE}{}", connection.fleet.as_str().replace(['-', '.'], "_"));
            let graph = graph.join(&node, String::new(), TypeRegistry::shipped()).await?;
            let is_served = |graph: &Graph| graph.nodes().contains(&format!("/{node}"));
            if graph.wait_for(OTHERS_WITHIN, is_served).await {
                let fleet = &connection.fleet;
                return Err(format!("another `consort-ros2 serve` offers the fleet {fleet} on this graph").into());
            }
            let (map, bus, keys, ros) = connection.open("consort_bridge").await?;
            let since_1970 = SystemTime::UNIX_EPOCH.elapsed()?;
            let run = u64::try_from(since_1970.as_millis())?;
            let planner = Arc::new(RoutePlanner::new(map)?);
            Ok(serve(&ros, ServeSettings { bus, keys, planner, run, graph: Some(Arc::new(graph)) }, stop).await?)
        }
        Command::Drive { connection, robot, place, action } => {
            let (map, bus, keys, ros) = connection.open("consort_driver").await?;
            let places = map.topology().places;
            Ok(drive(&ros, DriveSettings { bus, keys, robot, place, places, action }, stop).await?)
        }
        Command::Driver { file, graph } => {
            let (robot, types) = checked(&file)?;
            let graph = graph.join("consort_driver", robot.namespace(), types.clone()).await?;
            let name = format!("consort-ros2 {} ({file})", env!("CARGO_PKG_VERSION"));
            Ok(run::run(graph, robot, types, &name, stop).await?)
        }
        Command::Check { file } => {
            let (robot, types) = checked(&file)?;
            for name in consort_ros2::described::check::unknown_types(&robot, &types) {
                print(&format!("{name}: requested from the nodes that use it"))?;
            }
            print(&format!("{file}: {} actions, {} readings", robot.actions.len(), robot.readings.len()))
        }
        Command::Types => {
            let types = TypeRegistry::shipped();
            types.names().try_for_each(|name| print(&format!("{name} {}", types.hash(name)?)))
        }
        Command::Schema => print(&serde_json::to_string_pretty(&description::schema())?),
        Command::Doctor { file, wait, graph } => {
            let robot = file.as_deref().map(description::load).transpose()?;
            let types = robot.as_ref().map_or_else(|| Ok(TypeRegistry::shipped()), RobotDescription::definitions)?;
            let namespace = robot.as_ref().map(RobotDescription::namespace).unwrap_or_default();
            let graph = graph.join("consort_doctor", namespace, types.clone()).await?;
            let wait = Duration::try_from_secs_f64(wait)?;
            match &robot {
                Some(robot) => wait_for_needed(&graph, robot, wait).await,
                None => tokio::time::sleep(wait).await,
            }
            let findings = examine(&graph, robot.as_ref(), &types).await;
            for finding in &findings {
                print(&format!("{}  {}", if finding.ok { "ok     " } else { "PROBLEM" }, finding.text))?;
            }
            graph.leave().await;
            match findings.iter().filter(|finding| !finding.ok).count() {
                0 => Ok(()),
                1 => Err("1 problem".into()),
                count => Err(format!("{count} problems").into()),
            }
        }
    }
}

fn print(text: &str) -> Result<(), Box<dyn Error>> {
    Ok(writeln!(std::io::stdout(), "{text}")?)
}

/// Reads a description without problems.
fn checked(file: &str) -> Result<(RobotDescription, TypeRegistry), Box<dyn Error>> {
    let robot = description::load(file)?;
    let types = robot.definitions()?;
    let problems = problems(&robot, &types);
    match problems.is_empty() {
        true => Ok((robot, types)),
        false => Err(problems.iter().map(|problem| format!("{file}: {problem}")).collect::<Vec<_>>().join("\n").into()),
    }
}

impl ConnectionArgs {
    /// Opens the map, the bus of the fleet and the ROS 2 graph.
    async fn open(self, node: &str) -> Result<(Map, SharedBus, Keys, Ros), Box<dyn Error>> {
        let map = if map::SHIPPED.contains(&self.map.as_str()) {
            map::shipped(&self.map)?
        } else {
            consort_map_import::load(Path::new(&self.map))?
        };
        let bus = ZenohBus::open(ZenohSettings { connect: self.connect.clone(), ..ZenohSettings::default() }).await?;
        if bus.wait_connected(LINK_WARNING_AFTER).await.is_empty() {
            warn!(trying = self.connect.join(", "), "no link to a node of the fleet yet; retrying");
        }
        let ros = Ros::join(&RosSettings { routers: self.router, domain: self.domain, node: node.to_owned() })?;
        info!(fleet = %self.fleet, map = map.name(), links = bus.links().await.len(), "connected");
        Ok((map, Arc::new(bus), Keys::new(&self.fleet), ros))
    }
}
