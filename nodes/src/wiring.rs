//! From configuration to the parts of a node. The commands wire them to Zenoh; the demo, for a virtual fleet, to the
//! virtual bus.

use crate::config::{self, BusConfig, FleetConfig, Problem, Problems, RobotConfig, StationConfig, WorldConfig};
use crate::floor::{self, Floor};
use crate::kit;
use consort_actors::bus::ZenohSettings;
use consort_actors::bus::zenoh_bus::LinkTrust;
use consort_actors::clock::Clock;
use consort_actors::coordinator::IntakeLimits;
use consort_actors::node::{FleetSettings, HostPart, NodeSettings, RobotPart};
use consort_actors::replica::StoreIdentity;
use consort_actors::store::{DurableStore, Owner, Store};
use consort_protocol::auction::{Exact, Limits};
use consort_protocol::ensemble::Ensemble;
use consort_protocol::ids::{FleetId, NodeId, PlaceId};
use consort_protocol::knowledge::{Availability, Worker};
use consort_protocol::lease::LeaseTerms;
use consort_protocol::mission::Allowed;
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
pub const ESTIMATOR: &str = "standard-1";

/// What is particular to one life of a node.
#[derive(Clone)]
pub struct Life {
    /// Its clock.
    pub clock: Clock,
    /// Larger than in any former life of the node: milliseconds since 1970 do, unless the clock is put back.
    pub incarnation: u64,
    /// Where all its chance comes from.
    pub seed: u64,
    /// What it remembers of former lives.
    pub store: Store,
}

impl Life {
    /// A life of `node` that begins now, on a real machine, with what `data_dir` holds of former ones. Called within a
    /// tokio runtime.
    ///
    /// # Errors
    /// [`Problems`] of the data directory.
    pub fn real(node: &NodeId, fleet: &FleetConfig, data_dir: Option<&Path>) -> Result<Life, Problems> {
        let clock = Clock::real();
        let seed = random();
        let (store, incarnation) = match data_dir {
            Some(folder) => {
                let of = |problem: &dyn Display| Problems::from(Problem::of("data_dir", problem));
                let owner = Owner { fleet: fleet.name.clone(), node: node.clone() };
                let store = DurableStore::open(folder, &owner, fresh_store()).map_err(|problem| of(&problem))?;
                let incarnation = store.begin_life(clock.wall_ms()).map_err(|problem| of(&problem))?;
                (store.into_store(), incarnation)
            }
            None => {
                warn!(
                    %node,
                    "no --data-dir: what this node promises is kept in its memory alone; when it ends it forgets all, \
                     and comes back as a new member"
                );
                (Store::in_memory(seed), clock.wall_ms())
            }
        };
        Ok(Life { clock, incarnation, seed, store })
    }
}

/// A name for a store that no other has had.
pub(crate) fn fresh_store() -> StoreIdentity {
    StoreIdentity(u128::from(random()) << 64 | u128::from(random()))
}

/// Chance of the system's.
pub(crate) fn random() -> u64 {
    SysRng.try_next_u64().expect("the system has random numbers")
}

/// What robots in one place price and carry out their work with; the same for all of them, so it may be shared.
#[derive(Clone)]
pub struct Equipment {
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
pub fn fleet_settings(config: &FleetConfig) -> Result<FleetSettings, Problems> {
    let places = floor::load(&config.map)?.topology.places;
    let ensemble = Ensemble::compile(config.ensemble()).map_err(|problem| Problem::of("", problem))?;
    Ok(FleetSettings {
        fleet: config.name.clone(),
        ensemble: Arc::new(ensemble),
        domain: Arc::new(kit::domain().with_places(places.into_keys())),
        limits: limits(config),
        intake: IntakeLimits { missions: config.requests.missions, requests_per_s: config.requests.per_s },
        choice: Arc::new(Exact),
        terms: LeaseTerms {
            lease: Duration::from_millis(config.lease.lease_ms),
            grace: Duration::from_millis(config.lease.grace_ms),
        },
        window: config.times().window,
        stall_after: Duration::from_secs(config.stall_after_s),
        bootstrap_expect: config.bootstrap_expect,
        timing: config.timing,
        voters: config.voters,
        dead_after: config.times().dead_after,
        map: None,
    })
}

/// What bids must keep to.
pub fn limits(config: &FleetConfig) -> Limits {
    Limits { time: config.limits.time_s, charge_min: config.limits.charge_min }
}

/// The estimator and the skills of robots on a map.
///
/// # Errors
/// [`Problems`] of the map.
pub fn equipment(floor: &Floor) -> Result<Equipment, Problems> {
    let Floor { topology, map } = floor;
    let routes = Routes::new(topology).map_err(|problem| Problem::of("map", problem))?;
    let passages = map.as_ref().map_or_else(Passages::default, Map::passages);
    let environment = Environment::new().with(routes).with(passages);
    let estimator = kit::descriptors(DescriptorRegistry::standard()).resolve(environment.clone());
    let estimator = estimator.map_err(|problem| Problem::of("", problem))?;
    let library = Arc::new(kit::library(environment)?);
    Ok(Equipment { places: topology.places.clone(), estimator: Arc::new(estimator), library })
}

/// The estimator and the skills of robots on the fleet's map, with what they have learned.
///
/// # Errors
/// [`Problems`] of the map, or of the calibration.
pub fn fleet_equipment(fleet: &FleetConfig) -> Result<Equipment, Problems> {
    let equipment = equipment(&floor::load(&fleet.map)?)?;
    let Some(file) = &fleet.calibration else { return Ok(equipment) };
    let learned: Arc<Calibration> = Arc::new(config::load(file)?);
    let estimator = kit::descriptors(learned.descriptors()).resolve(equipment.estimator.environment().clone());
    let estimator = estimator.map_err(|problem| Problem::of(file.display(), problem))?;
    Ok(Equipment { estimator: Arc::new(estimator), ..equipment })
}

/// A robot's node; reads the fleet's map.
///
/// # Errors
/// [`Problems`] of the fleet, of its map, or of the robot on it.
pub fn robot_node(robot: &RobotConfig, fleet: &FleetConfig, life: Life) -> Result<NodeSettings, Problems> {
    robot_node_with(&fleet_equipment(fleet)?, robot, fleet, life)
}

/// A robot's node, with equipment that several share.
///
/// # Errors
/// [`Problems`] of the fleet, or of the robot on its map.
pub fn robot_node_with(
    equipment: &Equipment,
    robot: &RobotConfig,
    fleet: &FleetConfig,
    life: Life,
) -> Result<NodeSettings, Problems> {
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
pub fn worker(robot: &RobotConfig, places: &BTreeMap<PlaceId, Pose>) -> Result<Worker, Problems> {
    let Some(pose) = places.get(&robot.place) else {
        let allowed = Allowed::instead_of(robot.place.as_str(), places.keys());
        let (name, place) = (&robot.name, robot.place.as_str());
        let what = format!("robot {name}: place: {place:?} is not on the fleet's map; {allowed}");
        return Err(Problem::of("", what).into());
    };
    Ok(Worker {
        skills: robot.skills.clone(),
        place: robot.place.clone(),
        pose: *pose,
        battery: robot.battery,
        discharge: robot.discharge_share_per_s,
        useful_charge: robot.useful_charge,
        speed: robot.speed_mps,
        availability: Availability::Free,
        estimator: ESTIMATOR.to_owned(),
    })
}

/// A node without a robot.
///
/// # Errors
/// [`Problems`] of the fleet.
pub fn station_node(station: &StationConfig, fleet: &FleetConfig, life: Life) -> Result<NodeSettings, Problems> {
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
    life: Life,
) -> Result<(NodeSettings, SharedWorld), Problems> {
    let shared = SharedWorld::new(build_world(world, fleet)?);
    let host = HostPart { world: Box::new(shared.clone()), speed: world.speed };
    let bare = bare_node(world.name.clone(), fleet, life, world.may_vote)?;
    Ok((NodeSettings { stationary: true, mains_powered: true, host: Some(host), ..bare }, shared))
}

/// The world of a world file, at time zero.
///
/// # Errors
/// [`Problems`] of the map, or of what is on it.
pub fn build_world(world: &WorldConfig, fleet: &FleetConfig) -> Result<World, Problems> {
    let name = world.map.as_ref().unwrap_or(&fleet.map);
    let Floor { map: Some(map), .. } = floor::load(name)? else {
        let what = "a map of the published form has nothing to drive on; a world needs one of our own form";
        return Err(Problem::of(name, what).into());
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
    World::new(setup).map_err(|errors| Problems(errors.0.iter().map(|problem| Problem::of("", problem)).collect()))
}

fn bare_node(node: NodeId, fleet: &FleetConfig, life: Life, may_vote: bool) -> Result<NodeSettings, Problems> {
    let Life { clock, incarnation, seed, store } = life;
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
        host: None,
        observer: None,
        notary: None,
    })
}

/// The fleet's map, to be looked at. A node that does not need it for itself may lack the file.
fn shown_map(fleet: &FleetConfig) -> Option<Arc<Value>> {
    match floor::load(&fleet.map) {
        Ok(floor) => Some(Arc::new(floor.show())),
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
        listen: bus.listening(),
        connect: bus.connect.clone(),
        lease: fleet.times().link_lease,
        links: bus.certs.as_deref().map(|folder| link_trust(folder, &fleet.name)),
        ..ZenohSettings::default()
    }
}
