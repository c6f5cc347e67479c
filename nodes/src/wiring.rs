//! From configuration to the parts of a node. The commands wire them to Zenoh; the demo, for a virtual fleet, to the
//! virtual bus.

use crate::config::{self, BusConfig, Diagnostic, Diagnostics, FleetConfig, RobotConfig, StationConfig, WorldConfig};
use crate::extensions;
use crate::map_loader::{self, LoadedMap};
use consort_actors::bus::ZenohSettings;
use consort_actors::bus::zenoh_bus::LinkTrust;
use consort_actors::clock::Clock;
use consort_actors::coordinator::RequestLimits;
use consort_actors::node::{DriverServerPart, FleetSettings, NodeSettings, RobotPart};
use consort_actors::raft::StoreIdentity;
use consort_actors::store::{DurableStore, NodeStore, StoreOwner};
use consort_protocol::auction::{BidLimits, OptimalAssignment};
use consort_protocol::ensemble::Ensemble;
use consort_protocol::ids::{FleetId, NodeId, PlaceId};
use consort_protocol::knowledge::{Availability, RobotKnowledge};
use consort_protocol::lease::LeaseTerms;
use consort_protocol::mission::AllowedNames;
use consort_protocol::pose::Pose;
use consort_sim::experiment::calibration::Calibration;
use consort_sim::map::Map;
use consort_sim::world::{SharedWorld, World, WorldSetup};
use consort_skills::descriptor::{DescriptorRegistry, Estimator};
use consort_skills::environment::{Environment, Passages, Routes};
use consort_skills::library::SkillLibrary;
use rand::TryRng;
use rand::rngs::SysRng;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tracing::warn;

/// Which edition of the estimators this program has, as nodes tell one another. It changes when they reckon otherwise, and not with
/// each release: bids of two releases in one fleet are to compare.
pub const ESTIMATOR_VERSION: &str = "standard-1";

/// What is particular to one life of a node.
#[derive(Clone)]
pub struct NodeIncarnation {
    /// Its clock.
    pub clock: Clock,
    /// Larger than in any former life of the node: milliseconds since 1970 do, unless the clock is put back.
    pub incarnation: u64,
    /// Where all its chance comes from.
    pub seed: u64,
    /// What it remembers of former lives.
    pub store: NodeStore,
}

impl NodeIncarnation {
    /// A life of `node` that begins now, on a real machine, with what `data_dir` holds of former ones. Called within a
    /// tokio runtime.
    ///
    /// # Errors
    /// [`Problems`] of the data directory.
    pub fn start(node: &NodeId, fleet: &FleetConfig, data_dir: Option<&Path>) -> Result<NodeIncarnation, Diagnostics> {
        let clock = Clock::real();
        let seed = random_u64();
        let (store, incarnation) = match data_dir {
            Some(folder) => {
                let of = |problem: &dyn Display| Diagnostics::from(Diagnostic::for_file("data_dir", problem));
                let owner = StoreOwner { fleet: fleet.name.clone(), node: node.clone() };
                let store = DurableStore::open(folder, &owner, new_store_identity()).map_err(|problem| of(&problem))?;
                let incarnation = store.begin_incarnation(clock.wall_ms()).map_err(|problem| of(&problem))?;
                (store.into_node_store(), incarnation)
            }
            None => {
                warn!(
                    %node,
                    "no --data-dir: what this node promises is kept in its memory alone; when it ends it forgets all, \
                     and comes back as a new member"
                );
                (NodeStore::in_memory(seed), clock.wall_ms())
            }
        };
        Ok(NodeIncarnation { clock, incarnation, seed, store })
    }
}

/// A name for a store that no other has had.
pub(crate) fn new_store_identity() -> StoreIdentity {
    StoreIdentity(u128::from(random_u64()) << 64 | u128::from(random_u64()))
}

/// Chance of the system's.
pub(crate) fn random_u64() -> u64 {
    SysRng.try_next_u64().expect("the system has random numbers")
}

/// What robots in one place price and carry out their work with; the same for all of them, so it may be shared.
#[derive(Clone)]
pub struct SkillResources {
    /// Where each place is.
    pub places: BTreeMap<PlaceId, Pose>,
    /// Prices tasks.
    pub estimator: Arc<Estimator>,
    /// Carries tasks out.
    pub library: Arc<SkillLibrary>,
}

/// What all nodes of the fleet agree on; reads the fleet's map, since whoever coordinates takes missions to its places alone.
///
/// # Errors
/// [`Problems`] of the ensemble, or of the map.
pub fn fleet_settings(config: &FleetConfig) -> Result<FleetSettings, Diagnostics> {
    let places = map_loader::load(&config.map)?.topology.places;
    let ensemble = Ensemble::compile(config.ensemble()).map_err(|problem| Diagnostic::for_file("", problem))?;
    Ok(FleetSettings {
        fleet: config.name.clone(),
        ensemble: Arc::new(ensemble),
        domain: Arc::new(extensions::domain().with_places(places.into_keys())),
        limits: limits(config),
        request_limits: RequestLimits { missions_max: config.requests.missions, requests_per_s: config.requests.per_s },
        allocator: Arc::new(OptimalAssignment),
        lease_terms: LeaseTerms {
            lease: Duration::from_millis(config.lease.lease_ms),
            grace: Duration::from_millis(config.lease.grace_ms),
        },
        bid_window: config.times().auction_window,
        stall_timeout: Duration::from_secs(config.stall_after_s),
        bootstrap_expect: config.bootstrap_expect,
        timing: config.timing,
        voters: config.voters,
        dead_after: config.times().dead_after,
        map: None,
    })
}

/// What bids must keep to.
pub fn limits(config: &FleetConfig) -> BidLimits {
    BidLimits { time: config.limits.time_s, charge_min: config.limits.charge_min }
}

/// The estimator and the skills of robots on a map.
///
/// # Errors
/// [`Problems`] of the map.
pub fn skill_resources(floor: &LoadedMap) -> Result<SkillResources, Diagnostics> {
    let LoadedMap { topology, map } = floor;
    let routes = Routes::new(topology).map_err(|problem| Diagnostic::for_file("map", problem))?;
    let passages = map.as_ref().map_or_else(Passages::default, Map::passages);
    let environment = Environment::new().with(routes).with(passages);
    let estimator = extensions::descriptors(DescriptorRegistry::standard()).resolve(environment.clone());
    let estimator = estimator.map_err(|problem| Diagnostic::for_file("", problem))?;
    let library = Arc::new(extensions::library(environment)?);
    Ok(SkillResources { places: topology.places.clone(), estimator: Arc::new(estimator), library })
}

/// The estimator and the skills of robots on the fleet's map, with what they have learned.
///
/// # Errors
/// [`Problems`] of the map, or of the calibration.
pub fn fleet_skill_resources(fleet: &FleetConfig) -> Result<SkillResources, Diagnostics> {
    let equipment = skill_resources(&map_loader::load(&fleet.map)?)?;
    let Some(file) = &fleet.calibration else { return Ok(equipment) };
    let learned: Arc<Calibration> = Arc::new(config::load(file)?);
    let estimator = extensions::descriptors(learned.descriptors()).resolve(equipment.estimator.environment().clone());
    let estimator = estimator.map_err(|problem| Diagnostic::for_file(file.display(), problem))?;
    Ok(SkillResources { estimator: Arc::new(estimator), ..equipment })
}

/// A robot's node; reads the fleet's map.
///
/// # Errors
/// [`Problems`] of the fleet, of its map, or of the robot on it.
pub fn robot_node(
    robot: &RobotConfig,
    fleet: &FleetConfig,
    life: NodeIncarnation,
) -> Result<NodeSettings, Diagnostics> {
    robot_node_with(&fleet_skill_resources(fleet)?, robot, fleet, life)
}

/// A robot's node, with equipment that several share.
///
/// # Errors
/// [`Problems`] of the fleet, or of the robot on its map.
pub fn robot_node_with(
    equipment: &SkillResources,
    robot: &RobotConfig,
    fleet: &FleetConfig,
    life: NodeIncarnation,
) -> Result<NodeSettings, Diagnostics> {
    let part = RobotPart {
        worker: worker(robot, &equipment.places)?,
        estimator: Arc::clone(&equipment.estimator),
        library: Arc::clone(&equipment.library),
    };
    let node = NodeId::from(robot.name.clone());
    let bare = bare_node(node, fleet, life, robot.may_vote)?;
    Ok(NodeSettings { stationary: robot.stationary, mains_powered: robot.mains_powered, robot: Some(part), ..bare })
}

/// What a robot says of itself before its body has reported.
///
/// # Errors
/// [`Problems`] if its place is not on the map, or a skill is not in the library.
pub fn worker(robot: &RobotConfig, places: &BTreeMap<PlaceId, Pose>) -> Result<RobotKnowledge, Diagnostics> {
    let Some(pose) = places.get(&robot.place) else {
        let allowed = AllowedNames::suggest_for(robot.place.as_str(), places.keys());
        let (name, place) = (&robot.name, robot.place.as_str());
        let what = format!("robot {name}: place: {place:?} is not on the fleet's map; {allowed}");
        return Err(Diagnostic::for_file("", what).into());
    };
    Ok(RobotKnowledge {
        skills: robot.skills.clone(),
        place: robot.place.clone(),
        pose: *pose,
        battery: robot.battery,
        discharge: robot.discharge_share_per_s,
        useful_charge: robot.useful_charge,
        speed: robot.speed_mps,
        availability: Availability::Free,
        estimator: ESTIMATOR_VERSION.to_owned(),
    })
}

/// A node without a robot.
///
/// # Errors
/// [`Problems`] of the fleet.
pub fn station_node(
    station: &StationConfig,
    fleet: &FleetConfig,
    life: NodeIncarnation,
) -> Result<NodeSettings, Diagnostics> {
    let StationConfig { stationary, mains_powered, may_vote, .. } = *station;
    Ok(NodeSettings { stationary, mains_powered, ..bare_node(station.name.clone(), fleet, life, may_vote)? })
}

/// A node that hosts a simulated world, and the world to look at.
///
/// # Errors
/// [`Problems`] of the fleet, of the map, or of what is on it.
pub fn world_node(
    world: &WorldConfig,
    fleet: &FleetConfig,
    life: NodeIncarnation,
) -> Result<(NodeSettings, SharedWorld), Diagnostics> {
    let shared = SharedWorld::new(build_world(world, fleet)?);
    let host = DriverServerPart { world: Box::new(shared.clone()), speed: world.speed };
    let bare = bare_node(world.name.clone(), fleet, life, world.may_vote)?;
    Ok((NodeSettings { stationary: true, mains_powered: true, driver_server: Some(host), ..bare }, shared))
}

/// The world of a world file, at time zero.
///
/// # Errors
/// [`Problems`] of the map, or of what is on it.
pub fn build_world(world: &WorldConfig, fleet: &FleetConfig) -> Result<World, Diagnostics> {
    let name = world.map.as_ref().unwrap_or(&fleet.map);
    let LoadedMap { map: Some(map), .. } = map_loader::load(name)? else {
        let what = "a map of the published form has nothing to drive on; a world needs one of our own form";
        return Err(Diagnostic::for_file(name, what).into());
    };
    let setup = WorldSetup {
        map,
        robots: world.robot.clone(),
        people: world.person.clone(),
        objects: world.object.clone(),
        doors: world.door.clone(),
        obstacles: world.obstacle.clone(),
        seed: world.seed,
        durations: world.durations,
        limits: world.limits,
        systems: world.systems.clone(),
        step_s: world.step_s,
        gusts: world.gusts,
    };
    World::new(setup)
        .map_err(|errors| Diagnostics(errors.0.iter().map(|problem| Diagnostic::for_file("", problem)).collect()))
}

fn bare_node(
    node: NodeId,
    fleet: &FleetConfig,
    life: NodeIncarnation,
    may_vote: bool,
) -> Result<NodeSettings, Diagnostics> {
    let NodeIncarnation { clock, incarnation, seed, store } = life;
    Ok(NodeSettings {
        fleet: FleetSettings { map: shown_map(fleet), ..fleet_settings(fleet)? },
        node,
        incarnation,
        seed,
        store,
        clock,
        may_vote,
        stationary: false,
        mains_powered: false,
        robot: None,
        driver_server: None,
        observer: None,
        record_signer: None,
    })
}

/// The fleet's map, to be looked at. A node that does not need it for itself may lack the file.
fn shown_map(fleet: &FleetConfig) -> Option<Arc<Value>> {
    match map_loader::load(&fleet.map) {
        Ok(floor) => Some(Arc::new(floor.to_json())),
        Err(problem) => {
            warn!(map = fleet.map, %problem, "the fleet's map cannot be read: this node cannot show it");
            None
        }
    }
}

/// What links prove themselves with, by a folder that `consort cert` has made.
pub fn link_trust(certs: &Path, fleet: &FleetId) -> LinkTrust {
    LinkTrust { files: config::trust_files(certs), fleet: fleet.clone() }
}

/// How a node opens Zenoh: as a router between its neighbours.
pub fn bus_settings(bus: &BusConfig, fleet: &FleetConfig) -> ZenohSettings {
    ZenohSettings {
        listen: bus.listen_addresses(),
        connect: bus.connect.clone(),
        lease: fleet.times().link_lease,
        link_trust: bus.certs.as_deref().map(|folder| link_trust(folder, &fleet.name)),
        ..ZenohSettings::default()
    }
}
