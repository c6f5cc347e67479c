//! Builds the parts of a node from its configuration. The commands connect them to Zenoh; the
//! demo's virtual fleet uses the virtual bus.

use crate::config::{
    self, BusConfig, ChargerConfig, ChargingConfig, DeviceDriverConfig, FleetConfig, LinkRole, RobotConfig,
    StationConfig, WorldConfig, cancel_problems, zone_problems,
};
use crate::diagnostic::{Diagnostic, Diagnostics};
use crate::domains;
use crate::map_loader;
use crate::mission_files;
use consort_bus::ZenohSettings;
use consort_bus::clock::Clock;
use consort_bus::zenoh_bus::{LinkTrust, Mode};
use consort_dashboard::loaded_map::LoadedMap;
use consort_driver::{Contract, DriverEndpoint, DriverSetting, EndpointError, ProcessDriver, RobotStart};
use consort_fleet::autopilot;
use consort_fleet::coordinator::CandidateSettings;
use consort_fleet::node::{DevicePart, DriverServerPart, FleetSettings, NodeSettings, RobotPart};
use consort_protocol::auction::{BidLimits, OptimalAssignment};
use consort_protocol::ensemble::Ensembles;
use consort_protocol::ids::{FleetId, NodeId, PlaceId, RobotId};
use consort_protocol::knowledge::{Availability, RobotKnowledge};
use consort_protocol::lease::LeaseTerms;
use consort_protocol::mission::Domain;
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, Seconds};
use consort_protocol::versions::VersionRange;
use consort_protocol::view::MapView;
use consort_raft::StoreIdentity;
use consort_raft::store::{DurableStore, NodeStore, Quarantine, StoreOwner};
use consort_skills::actions::RobotBackend;
use consort_skills::descriptor::{Calibration, DescriptorRegistry, ESTIMATOR_VERSION, Estimator};
use consort_skills::domain::device_domain;
use consort_skills::domain_file::DomainFile;
use consort_skills::environment::{Environment, Passages, Routes, TopologicalMap};
use consort_skills::extensions::Extensions;
use consort_skills::library::SkillLibrary;
use consort_skills::skill::member_value_errors;
use consort_text::AllowedNames;
use consort_world::SharedWorld;
use consort_world::device::{DeviceSwitch, SimulatedDevice};
use consort_world::map::{Map, PlaceKind};
use consort_world::world::{World, WorldSetup};
use rand::TryRng;
use rand::rngs::SysRng;
use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tracing::{error, warn};

/// Values of a single incarnation of a node.
#[derive(Clone)]
pub struct NodeIncarnation {
    /// Its clock.
    pub clock: Clock,
    /// Incarnation number, larger than in any former run of the node: milliseconds since 1970,
    /// unless the clock was set back.
    pub incarnation: u64,
    /// Seed of its random numbers.
    pub seed: u64,
    /// Its store, with the state of former runs.
    pub store: NodeStore,
}

impl NodeIncarnation {
    /// Starts an incarnation of `node` on a real machine, with the state in `data_dir`. Called
    /// within a tokio runtime.
    ///
    /// # Errors
    /// [`Diagnostics`] of the data directory.
    pub fn start(node: &NodeId, fleet: &FleetConfig, data_dir: Option<&Path>) -> Result<NodeIncarnation, Diagnostics> {
        let clock = Clock::real();
        let seed = random_u64();
        let (store, incarnation) = match data_dir {
            Some(folder) => {
                let of = |problem: &dyn Display| Diagnostics::from(Diagnostic::for_file("data_dir", problem));
                let owner = StoreOwner { fleet: fleet.name.clone(), node: node.clone() };
                let opened = DurableStore::open_or_replace(folder, &owner, new_store_identity());
                let (store, quarantine) = opened.map_err(|problem| of(&problem))?;
                if let Some(Quarantine { file, damage, moved_to }) = quarantine {
                    let (file, moved_to) = (file.display(), moved_to.display());
                    error!(%node, %file, damage, %moved_to, "damaged store moved away: the node joins again as an empty member");
                }
                let incarnation = store.begin_incarnation(clock.wall_ms()).map_err(|problem| of(&problem))?;
                (store.into_node_store(), incarnation)
            }
            None => {
                warn!(
                    %node,
                    "no --data-dir: the node's state is kept in memory only and is lost when it ends; \
                     the node then returns as a new member"
                );
                (NodeStore::in_memory(seed), clock.wall_ms())
            }
        };
        Ok(NodeIncarnation { clock, incarnation, seed, store })
    }
}

/// Creates a unique store identity.
pub(crate) fn new_store_identity() -> StoreIdentity {
    StoreIdentity(u128::from(random_u64()) << 64 | u128::from(random_u64()))
}

/// Returns a random number of the system.
pub(crate) fn random_u64() -> u64 {
    SysRng.try_next_u64().expect("the system has random numbers")
}

/// Estimator and skills of robots in an environment; identical for all of them, so they may be
/// shared.
#[derive(Clone)]
pub(crate) struct SkillResources {
    /// The task types, with the places of the map.
    pub domain: Arc<Domain>,
    /// Positions of the places.
    pub places: BTreeMap<PlaceId, Pose>,
    /// Estimates the cost of tasks.
    pub estimator: Arc<Estimator>,
    /// Carries out tasks.
    pub library: Arc<SkillLibrary>,
}

/// Builds the settings common to all nodes of the fleet. Reads the fleet's map, since the
/// coordinator accepts missions to its places only, and the fleet's missions.
///
/// # Errors
/// [`Diagnostics`] of the ensembles, of the map, of zones, of trees that read what no ensemble exchanges, or of the
/// missions.
pub(crate) fn fleet_settings(config: &FleetConfig, extensions: Extensions) -> Result<FleetSettings, Diagnostics> {
    let floor = map_loader::load(&config.map)?;
    let charging = match &config.charging {
        Some(charging) => {
            // A station may lack the calibration, and does not forecast. A robot with a wrong one does not start.
            let learned = calibration(config, extensions).ok().flatten();
            let measured = learned.as_ref().and_then(|learned| learned.charging.as_ref());
            Some(Arc::new(charging.settings(chargers(charging, &floor)?, measured)))
        }
        None => None,
    };
    let candidates = candidates(config, &floor, extensions);
    let TopologicalMap { places, edges } = floor.topology;
    let cancel_times = extensions.files().flat_map(DomainFile::cancel_times);
    let wrong = zone_problems(&config.zones, &places).into_iter();
    let wrong = wrong.chain(cancel_problems(&config.lease, cancel_times));
    Diagnostics::into_result(wrong.map(|problem| Diagnostic::for_file("", problem)).collect())?;
    let domain = extensions.domain();
    let ensembles =
        Ensembles::compile(config.ensembles(&domain)).map_err(|problem| Diagnostic::for_file("", problem))?;
    let trees = extensions.files().flat_map(DomainFile::trees);
    let wrong = trees.flat_map(|tree| member_value_errors(tree, &ensembles));
    Diagnostics::into_result(wrong.map(|error| Diagnostic::for_file("", error)).collect())?;
    let lanes = edges.into_iter().map(|edge| (edge.a, edge.b));
    let domain = domain.with_places(places.into_keys()).with_lanes(lanes).with_zones(config.zones.clone());
    let domain = domain.with_ensembles(ensembles.names().cloned());
    let alarms = config::alarm_plans(&config.alarms, &domain).map_err(|problems| {
        Diagnostics(problems.into_iter().map(|problem| Diagnostic::for_file("", problem)).collect())
    })?;
    let devices = config::devices(&config.device, &domain).map_err(|problems| {
        Diagnostics(problems.into_iter().map(|problem| Diagnostic::for_file("", problem)).collect())
    })?;
    let missions = mission_files::of_fleet(&config.missions, &domain, &domains::library(extensions)?)?;
    if let Some(problem) = config.charging.as_ref().and_then(|charging| charging.swap_problem(&missions)) {
        return Err(Diagnostic::for_file("", problem).into());
    }
    Ok(FleetSettings {
        fleet: config.name.clone(),
        ensembles: Arc::new(ensembles),
        domain: Arc::new(domain),
        missions: Arc::new(missions),
        alarms: Arc::new(alarms),
        devices: Arc::new(devices),
        limits: limits(config),
        charging,
        promises: config.auction.promise_terms(),
        request_limits: config.requests.limits(),
        history_limits: config.history.limits(),
        allocator: Arc::new(OptimalAssignment),
        candidates,
        lease_terms: LeaseTerms {
            lease: Duration::from_millis(config.lease.lease_ms),
            grace: Duration::from_millis(config.lease.grace_ms),
        },
        bid_window: config.times().auction_window,
        stall_timeout: Duration::from_secs(config.stall_after_s),
        bootstrap_expect: config.bootstrap_expect,
        timing: config.timing,
        voters: config.voters,
        autopilot_rule: autopilot::decide,
        dead_after: config.times().dead_after,
        snapshot_every: consort_raft::SNAPSHOT_EVERY,
        log_entries_kept: consort_raft::LOG_ENTRIES_KEPT,
        scoped_knowledge: config.is_large(),
        map: None,
    })
}

/// Returns the choice of the robots that auctions ask in a large fleet. A station may lack the calibration, or a map that its domains need:
/// then auctions ask all robots.
fn candidates(config: &FleetConfig, floor: &LoadedMap, extensions: Extensions) -> Option<CandidateSettings> {
    let count = config.auction.candidates;
    let estimator = (count > 0).then(|| bounding_estimator(config, floor, extensions))?;
    match estimator {
        Ok(estimator) => Some(CandidateSettings {
            count,
            estimator: Arc::new(estimator),
            estimator_version: ESTIMATOR_VERSION.to_owned(),
        }),
        Err(problem) => {
            warn!(%problem, "the costs of robots cannot be estimated: auctions ask all robots");
            None
        }
    }
}

/// Returns an estimator that estimates no task to cost more than robots do.
fn bounding_estimator(
    config: &FleetConfig,
    floor: &LoadedMap,
    extensions: Extensions,
) -> Result<Estimator, Diagnostics> {
    let passages = floor.map.as_ref().map_or_else(Passages::default, Map::passages);
    let routes =
        Routes::shortest(&floor.topology, &passages).map_err(|problem| Diagnostic::for_file("map", problem))?;
    let descriptors = calibrated_descriptors(config, extensions)?;
    let estimator = descriptors.resolve(Environment::new().with(routes));
    Ok(estimator.map_err(|problem| Diagnostic::for_file("", problem))?)
}

/// Returns the descriptors of all robots, with learned corrections.
fn calibrated_descriptors(config: &FleetConfig, extensions: Extensions) -> Result<DescriptorRegistry, Diagnostics> {
    let descriptors = extensions.descriptors(DescriptorRegistry::standard());
    Ok(match calibration(config, extensions)? {
        Some(learned) => Arc::new(learned).correct(descriptors),
        None => descriptors,
    })
}

/// Reads the calibration that a fleet names, if any.
fn calibration(config: &FleetConfig, extensions: Extensions) -> Result<Option<Calibration>, Diagnostics> {
    config.calibration.as_ref().map(|file| config::load(file, &extensions.domain())).transpose()
}

/// Returns the chargers of a fleet on its map.
///
/// # Errors
/// [`Diagnostics`] of unknown places, of the lack of any charger, or of a charger for parking.
fn chargers(charging: &ChargingConfig, floor: &LoadedMap) -> Result<Vec<ChargerConfig>, Diagnostics> {
    let of_map = floor.map.iter().flat_map(Map::places).filter(|place| place.kind == PlaceKind::Charger);
    let chargers = charging.chargers(of_map.map(|place| &place.id), &floor.topology.places.keys().collect());
    chargers.map_err(|problems| {
        Diagnostics(problems.into_iter().map(|problem| Diagnostic::for_file("", problem)).collect())
    })
}

/// Returns the limits of bids.
pub(crate) fn limits(config: &FleetConfig) -> BidLimits {
    BidLimits { time: config.limits.time_s, charge_min: config.limits.charge_min }
}

/// Builds the estimator and the skills of robots on a map.
///
/// # Errors
/// [`Diagnostics`] of the map.
pub(crate) fn skill_resources(floor: &LoadedMap, extensions: Extensions) -> Result<SkillResources, Diagnostics> {
    let LoadedMap { topology, map } = floor;
    let routes = Routes::new(topology).map_err(|problem| Diagnostic::for_file("map", problem))?;
    let passages = map.as_ref().map_or_else(Passages::default, Map::passages);
    let environment = Environment::new().with(routes).with(passages);
    let estimator = extensions.descriptors(DescriptorRegistry::standard()).resolve(environment.clone());
    let estimator = estimator.map_err(|problem| Diagnostic::for_file("", problem))?;
    let library = Arc::new(extensions.library(environment).map_err(domains::diagnostic)?);
    let domain = Arc::new(extensions.domain().with_places(topology.places.keys().cloned()));
    Ok(SkillResources { domain, places: topology.places.clone(), estimator: Arc::new(estimator), library })
}

/// Returns the map for robots of a navigation graph; `None`: all lanes.
fn of_graph(floor: LoadedMap, graph: Option<&str>) -> Result<LoadedMap, Diagnostics> {
    let Some(graph) = graph else { return Ok(floor) };
    let graphs = floor.map.as_ref().map(Map::graphs).unwrap_or_default();
    let Some(map) = floor.map.as_ref().filter(|_| graphs.contains(graph)) else {
        let allowed = AllowedNames::suggest_for(graph, &graphs);
        let what = format!("graph: {graph:?} is not a navigation graph of the fleet's map; {allowed}");
        return Err(Diagnostic::for_file("", what).into());
    };
    Ok(LoadedMap { topology: map.topology_of(Some(graph)), map: floor.map })
}

/// Builds the estimator and the skills of robots on the fleet's map, with learned corrections. The robots drive on the
/// lanes of a navigation graph; `None`: on all lanes.
///
/// # Errors
/// [`Diagnostics`] of the map, of the graph, or of the calibration.
pub(crate) fn fleet_skill_resources(
    fleet: &FleetConfig,
    graph: Option<&str>,
    extensions: Extensions,
) -> Result<SkillResources, Diagnostics> {
    let equipment = skill_resources(&of_graph(map_loader::load(&fleet.map)?, graph)?, extensions)?;
    let Some(file) = &fleet.calibration else { return Ok(equipment) };
    let descriptors = calibrated_descriptors(fleet, extensions)?;
    let estimator = descriptors.resolve(equipment.estimator.environment().clone());
    let estimator = estimator.map_err(|problem| Diagnostic::for_file(file.display(), problem))?;
    Ok(SkillResources { estimator: Arc::new(estimator), ..equipment })
}

/// Builds a robot's node; reads the fleet's map.
///
/// # Errors
/// [`Diagnostics`] of the fleet, of its map, or of the robot on it.
pub(crate) fn robot_node(
    robot: &RobotConfig,
    fleet: &FleetConfig,
    incarnation: NodeIncarnation,
    extensions: Extensions,
) -> Result<NodeSettings, Diagnostics> {
    robot_node_with(
        &fleet_skill_resources(fleet, robot.graph.as_deref(), extensions)?,
        robot,
        fleet,
        incarnation,
        extensions,
    )
}

/// Builds a robot's node, with shared skill resources.
///
/// # Errors
/// [`Diagnostics`] of the fleet, or of the robot on its map.
pub(crate) fn robot_node_with(
    equipment: &SkillResources,
    robot: &RobotConfig,
    fleet: &FleetConfig,
    incarnation: NodeIncarnation,
    extensions: Extensions,
) -> Result<NodeSettings, Diagnostics> {
    let part = RobotPart {
        worker: worker(robot, &equipment.places)?,
        estimator: Arc::clone(&equipment.estimator),
        library: Arc::clone(&equipment.library),
        capacity: robot.capacity_wh,
    };
    let driver_server = robot.driver.clone().map(|driver| process_driver(driver, robot, equipment, extensions));
    let driver_server = driver_server.transpose()?;
    let node = NodeId::from(robot.name.clone());
    let bare = bare_node(node, fleet, incarnation, robot.may_vote, extensions)?;
    let RobotConfig { stationary, mains_powered, .. } = *robot;
    let node = NodeSettings { stationary, mains_powered, robot: Some(part), driver_server, ..bare };
    with_devices(node, &robot.device)
}

/// Builds the driver server of a robot whose driver is a process of this node, or on a socket.
///
/// # Errors
/// [`Diagnostics`] if the setting is invalid, or the program does not exist.
fn process_driver(
    driver: DriverSetting,
    robot: &RobotConfig,
    equipment: &SkillResources,
    extensions: Extensions,
) -> Result<DriverServerPart, Diagnostics> {
    let of = |problem: EndpointError| Diagnostic::for_file("", format!("robot {}: driver: {problem}", robot.name));
    let endpoint = DriverEndpoint::try_from(driver).map_err(of)?;
    endpoint.check_exists().map_err(|problem| of(problem.into()))?;
    let start = RobotStart {
        robot: robot.name.clone(),
        place: robot.place.clone(),
        charge: robot.battery,
        places: equipment.places.clone(),
    };
    let driver = ProcessDriver::new(start, endpoint, domains::driver_contract(extensions));
    Ok(DriverServerPart { world: Box::new(driver), speed: 1.0 })
}

/// Returns a robot's knowledge record before its driver has reported.
///
/// # Errors
/// [`Diagnostics`] if its place is not on the map, or a skill is not in the library.
pub(crate) fn worker(robot: &RobotConfig, places: &BTreeMap<PlaceId, Pose>) -> Result<RobotKnowledge, Diagnostics> {
    let Some(pose) = places.get(&robot.place) else {
        let allowed = AllowedNames::suggest_for(robot.place.as_str(), places.keys());
        let (name, place) = (&robot.name, robot.place.as_str());
        let what = format!("robot {name}: place: {place:?} is not on the fleet's map; {allowed}");
        return Err(Diagnostic::for_file("", what).into());
    };
    Ok(RobotKnowledge {
        skills: robot.skills.clone(),
        attributes: robot.attributes.clone(),
        place: robot.place.clone(),
        pose: *pose,
        battery: robot.battery,
        discharge: robot.discharge_share_per_s,
        useful_charge: robot.useful_charge,
        speed: robot.speed_mps,
        availability: Availability::Free,
        estimator: ESTIMATOR_VERSION.to_owned(),
        charging: None,
    })
}

/// Builds a node without a robot.
///
/// # Errors
/// [`Diagnostics`] of the fleet.
pub fn station_node(
    station: &StationConfig,
    fleet: &FleetConfig,
    incarnation: NodeIncarnation,
    extensions: Extensions,
) -> Result<NodeSettings, Diagnostics> {
    let StationConfig { stationary, mains_powered, may_vote, .. } = *station;
    let bare = bare_node(station.name.clone(), fleet, incarnation, may_vote, extensions)?;
    with_devices(NodeSettings { stationary, mains_powered, ..bare }, &station.device)
}

/// Adds the drivers of devices to a node.
///
/// # Errors
/// [`Diagnostics`] of a driver.
fn with_devices(node: NodeSettings, configs: &[DeviceDriverConfig]) -> Result<NodeSettings, Diagnostics> {
    let device = |config: &DeviceDriverConfig| device_part(config, &node.node, &node.fleet);
    let devices = configs.iter().map(device).collect::<Result<_, _>>()?;
    Ok(NodeSettings { devices, ..node })
}

/// Builds the driver of a device at a node: a program, a socket, or a simulated device.
///
/// # Errors
/// [`Diagnostics`] if the fleet file does not declare the device, or names another host, the setting is invalid, or the
/// program does not exist.
fn device_part(config: &DeviceDriverConfig, node: &NodeId, fleet: &FleetSettings) -> Result<DevicePart, Diagnostics> {
    let of = |problem: &dyn Display| Diagnostic::for_file("", format!("device {}: {problem}", config.name));
    let Some(device) = fleet.devices.get(&config.name) else {
        let declared = fleet.devices.iter().map(|device| &device.name);
        let allowed = AllowedNames::suggest_for(config.name.as_str(), declared);
        return Err(of(&format!("the fleet file declares no such device; {allowed}")).into());
    };
    if device.host != *node {
        return Err(of(&format!("the fleet file names {} as its host", device.host)).into());
    }
    let robot = RobotId::new(config.name.as_str()).map_err(|problem| of(&problem))?;
    let driver: Box<dyn RobotBackend> = match config.driver.clone() {
        None => {
            let moving = Seconds::new(f64::from(config.simulated_s)).map_err(|problem| of(&problem))?;
            Box::new(SimulatedDevice::new(robot, moving, DeviceSwitch::default()))
        }
        Some(driver) => {
            let endpoint = DriverEndpoint::try_from(driver).map_err(|problem| of(&problem))?;
            endpoint.check_exists().map_err(|problem| of(&problem))?;
            // A driver starts at a place; that of a device is the first place that it guards.
            let places = device.pairs().map(|(place, _)| (place, Pose::default())).collect::<BTreeMap<_, _>>();
            let place = places.keys().next().cloned().ok_or_else(|| of(&"it guards nothing"))?;
            let start = RobotStart { robot, place, charge: BatteryShare::FULL, places };
            Box::new(ProcessDriver::new(start, endpoint, Contract::new([device_domain()])))
        }
    };
    Ok(DevicePart { device: config.name.clone(), driver })
}

/// Builds a node with a simulated world, and returns the world for inspection.
///
/// # Errors
/// [`Diagnostics`] of the fleet, of the map, or of objects on it.
pub(crate) fn world_node(
    world: &WorldConfig,
    fleet: &FleetConfig,
    incarnation: NodeIncarnation,
    extensions: Extensions,
) -> Result<(NodeSettings, SharedWorld), Diagnostics> {
    let shared = SharedWorld::new(build_world(world, fleet, extensions)?);
    let host = DriverServerPart { world: Box::new(shared.clone()), speed: world.speed };
    let bare = bare_node(world.name.clone(), fleet, incarnation, world.may_vote, extensions)?;
    let node = NodeSettings { stationary: true, mains_powered: true, driver_server: Some(host), ..bare };
    Ok((with_devices(node, &world.device)?, shared))
}

/// Builds the world of a world file, at time zero.
///
/// # Errors
/// [`Diagnostics`] of the map, or of objects on it.
pub(crate) fn build_world(
    world: &WorldConfig,
    fleet: &FleetConfig,
    extensions: Extensions,
) -> Result<World, Diagnostics> {
    let name = world.map.as_ref().unwrap_or(&fleet.map);
    let floor = map_loader::load(name)?;
    let chargers = match &fleet.charging {
        Some(charging) => chargers(charging, &floor)?,
        None => vec![],
    };
    let Some(map) = floor.map else {
        let what = "a map of the published format has no floor plan; a world needs a map in Consort's own format";
        return Err(Diagnostic::for_file(name, what).into());
    };
    let setup = WorldSetup {
        robots: world.robot.clone(),
        people: world.person.clone(),
        objects: world.object.clone(),
        chargers: chargers.into_iter().map(|charger| (charger.place, charger.power_w)).collect(),
        charging_curve: fleet.charging.as_ref().map(|charging| charging.curve.clone()).unwrap_or_default(),
        doors: world.door.clone(),
        obstacles: world.obstacle.clone(),
        durations: world.durations,
        limits: world.limits,
        systems: world.systems.clone(),
        step_s: world.step_s,
        wind: world.wind,
        ..WorldSetup::new(map, world.seed)
    };
    World::new(setup.extended(extensions))
        .map_err(|errors| Diagnostics(errors.0.iter().map(|problem| Diagnostic::for_file("", problem)).collect()))
}

fn bare_node(
    node: NodeId,
    fleet: &FleetConfig,
    incarnation: NodeIncarnation,
    may_vote: bool,
    extensions: Extensions,
) -> Result<NodeSettings, Diagnostics> {
    let NodeIncarnation { clock, incarnation, seed, store } = incarnation;
    Ok(NodeSettings {
        fleet: FleetSettings { map: display_map(fleet), ..fleet_settings(fleet, extensions)? },
        node,
        incarnation,
        seed,
        store,
        clock,
        supported_versions: VersionRange::OWN,
        may_vote,
        stationary: false,
        mains_powered: false,
        robot: None,
        driver_server: None,
        devices: vec![],
        observer: None,
        record_signer: None,
    })
}

/// Returns the fleet's map, for display. A node that does not need the map itself may lack the
/// file.
fn display_map(fleet: &FleetConfig) -> Option<Arc<MapView>> {
    match map_loader::load(&fleet.map) {
        Ok(floor) => Some(Arc::new(floor.to_view())),
        Err(problem) => {
            warn!(map = fleet.map, %problem, "the fleet's map cannot be read: this node cannot publish it");
            None
        }
    }
}

/// Returns the credentials of links, from a folder of `consort cert`.
pub fn link_trust(certs: &Path, fleet: &FleetId) -> LinkTrust {
    LinkTrust { files: config::trust_files(certs), fleet: fleet.clone() }
}

/// Returns the Zenoh settings of a node with a role towards its neighbours.
pub(crate) fn bus_settings(bus: &BusConfig, fleet: &FleetConfig, role: LinkRole) -> ZenohSettings {
    let (mode, listen, connect) = match role {
        LinkRole::Relay(_) => (Mode::Router, bus.listen_addresses(), bus.connect.clone()),
        LinkRole::Client(_, relays) => (Mode::NodeClient, vec![], relays),
    };
    ZenohSettings {
        mode,
        listen,
        connect,
        lease: fleet.times().link_lease,
        link_trust: bus.certs.as_deref().map(|folder| link_trust(folder, &fleet.name)),
        ..ZenohSettings::default()
    }
}
