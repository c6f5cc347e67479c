//! A router like `rmw_zenohd`, a ROS 2 graph around it, and a world of the fleet; all on loopback,
//! at free ports.

use consort_bus::clock::Clock;
use consort_bus::{SharedBus, ZenohBus, ZenohSettings};
use consort_fleet::robot_driver::{CLIENT_TIMEOUT, DriverServer, DriverServerMessage, DriverServerSettings};
use consort_protocol::ids::FleetId;
use consort_protocol::keys::Keys;
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond};
use consort_ros2::dynamic::graph::{Graph, GraphSettings};
use consort_ros2::dynamic::types::TypeRegistry;
use consort_ros2::mapping;
use consort_ros2::messages::{Goal, Time};
use consort_ros2::ros::{Ros, RosSettings};
use consort_ros2::route_planner::RoutePlanner;
use consort_ros2::serve::{ServeSettings, serve};
use consort_world::SharedWorld;
use consort_world::map::{Map, shipped};
use consort_world::world::{RobotSetup, World, WorldSetup};
use hiroz::config::RouterConfigBuilder;
use ractor::{Actor, ActorRef};
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinSet;
use tokio::time::Instant;

/// World seconds per second of these tests.
pub(crate) const SPEED: f64 = 20.0;

/// A generous time limit of every wait.
pub(crate) const LIMIT: Duration = Duration::from_secs(60);

/// Waits until a condition holds.
pub(crate) async fn until(what: &str, mut holds: impl AsyncFnMut() -> bool) {
    let end = Instant::now() + LIMIT;
    while !holds().await {
        assert!(Instant::now() < end, "{what}: not within {LIMIT:?}");
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}

/// Waits for a future that must complete.
pub(crate) async fn within<T>(what: &str, future: impl Future<Output = T>) -> T {
    tokio::time::timeout(LIMIT, future).await.unwrap_or_else(|_| panic!("{what}: not within {LIMIT:?}"))
}

/// The router of a ROS 2 graph.
pub(crate) struct Router {
    session: zenoh::Session,
    pub(crate) address: String,
}

impl Router {
    pub(crate) async fn start() -> Router {
        let config = RouterConfigBuilder::new().with_listen_endpoint("tcp/127.0.0.1:0").build_config().unwrap();
        let session = zenoh::open(config).await.unwrap();
        let address = session.info().locators().await.first().expect("it listens").to_string();
        Router { session, address }
    }

    /// Joins the router's graph with a separate session.
    pub(crate) fn join(&self, node: &str) -> Ros {
        let settings = RosSettings { routers: vec![self.address.clone()], domain: 0, node: node.to_owned() };
        Ros::join(&settings).unwrap()
    }

    /// Joins the router's graph with a node for messages of any type.
    pub(crate) async fn graph(&self, node: &str) -> Arc<Graph> {
        let (routers, namespace) = (vec![self.address.clone()], String::new());
        let settings = GraphSettings { routers, domain: 0, node: node.to_owned(), namespace };
        Arc::new(Graph::join(settings, TypeRegistry::shipped()).await.unwrap())
    }

    /// Returns the session of the router, which receives all traffic.
    pub(crate) fn session(&self) -> &zenoh::Session {
        &self.session
    }
}

pub(crate) fn keys() -> Keys {
    Keys::new(&FleetId::new("ward").unwrap())
}

/// Opens a bus of the fleet, linked with another bus if given.
pub(crate) async fn bus(linked_to: Option<&ZenohBus>) -> ZenohBus {
    let connect = match linked_to {
        Some(other) => other.listen_addresses().await,
        None => vec![],
    };
    let linked = !connect.is_empty();
    let bus = ZenohBus::open(ZenohSettings { connect, ..ZenohSettings::default() }).await.unwrap();
    if linked {
        assert!(!bus.wait_connected(LIMIT).await.is_empty(), "a link within {LIMIT:?}");
    }
    bus
}

pub(crate) fn hospital() -> Map {
    shipped("hospital").unwrap()
}

/// Returns a carrier with a speed of 0.5 m/s that uses 0.1 % of its battery per second.
pub(crate) fn carrier(name: &str, place: &str, battery: f64) -> RobotSetup {
    let (speed, discharge) = (MetresPerSecond::new(0.5).unwrap(), SharePerSecond::new(0.001).unwrap());
    let battery = BatteryShare::new(battery).unwrap();
    RobotSetup::carrier(name.parse().unwrap(), place.parse().unwrap(), speed, battery, discharge)
}

/// Hosts a world with robots in the hospital.
pub(crate) async fn host_world(
    bus: &ZenohBus,
    robots: Vec<RobotSetup>,
) -> (ActorRef<DriverServerMessage>, SharedWorld) {
    let setup = WorldSetup { robots, ..WorldSetup::new(hospital(), 7) };
    let world = SharedWorld::new(World::new(setup).unwrap());
    let settings = DriverServerSettings {
        boot: 1,
        keys: keys(),
        bus: Arc::new(bus.clone()),
        clock: Clock::real(),
        speed: SPEED,
        publish_interval: Duration::from_millis(500),
        client_timeout: CLIENT_TIMEOUT,
    };
    let (server, _) = Actor::spawn(None, DriverServer, (settings, Box::new(world.clone()))).await.unwrap();
    (server, world)
}

/// A world of the fleet with robots in the hospital, offered to ROS 2.
pub(crate) struct Offered {
    pub(crate) router: Router,
    pub(crate) world: SharedWorld,
    server: ActorRef<DriverServerMessage>,
    pub(crate) bus: ZenohBus,
    tasks: JoinSet<()>,
}

impl Offered {
    /// Starts the world and the bridge in this process.
    pub(crate) async fn with(robots: Vec<RobotSetup>) -> Offered {
        Offered::with_graph(robots, async |_: &Router| None).await
    }

    /// Starts the world and the bridge, with a session for the states of the robots.
    pub(crate) async fn with_states(robots: Vec<RobotSetup>) -> Offered {
        Offered::with_graph(robots, async |router: &Router| Some(router.graph("consort_serve").await)).await
    }

    async fn with_graph(robots: Vec<RobotSetup>, graph: impl AsyncFnOnce(&Router) -> Option<Arc<Graph>>) -> Offered {
        let mut offered = Offered::without_bridge(robots).await;
        let (router, bus_of_world) = (&offered.router, &offered.bus);
        let shared: SharedBus = Arc::new(bus(Some(bus_of_world)).await);
        let (ros, graph) = (router.join("consort_bridge"), graph(router).await);
        offered.tasks.spawn(async move {
            let planner = Arc::new(RoutePlanner::new(hospital()).unwrap());
            let settings = ServeSettings { bus: shared, keys: keys(), planner, run: 1, graph };
            panic!("the bridge stopped: {}", serve(&ros, settings, std::future::pending()).await.unwrap_err());
        });
        offered
    }

    /// Starts the world without the bridge.
    pub(crate) async fn without_bridge(robots: Vec<RobotSetup>) -> Offered {
        let (router, bus) = (Router::start().await, bus(None).await);
        let (server, world) = host_world(&bus, robots).await;
        Offered { router, world, server, bus, tasks: JoinSet::new() }
    }

    /// Kills the world's driver server without notice.
    pub(crate) fn kill_world(&self) {
        self.server.kill();
    }
}

/// Returns the goal of a place in the hospital.
pub(crate) fn to_place(name: &str) -> Goal {
    to_pose(hospital().place(&name.parse().unwrap()).unwrap().pose)
}

pub(crate) fn to_pose(pose: Pose) -> Goal {
    Goal { pose: mapping::to_ros(pose, Time::default()), behavior_tree: String::new() }
}
