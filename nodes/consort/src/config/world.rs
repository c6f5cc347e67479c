//! The world file: a node with a simulated world.

use super::devices::{DRIVERS_MAX, DeviceDriverConfig, driver_problems, resolve_drivers};
use super::node::{common_config, validate_common};
use super::read::join_normalized;
use super::{BusConfig, CommonConfig, ConfigFile, FleetRef, NodeFile, TelemetryConfig};
use crate::map_loader::is_shipped;
use consort_protocol::ids::NodeId;
use consort_protocol::mission::Domain;
use consort_world::world::{
    DoorSetup, Durations, ObjectSetup, Obstacle, PersonSetup, RobotSetup, WindSettings, WorldLimits, default_step_s,
    system_names,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// A world file. Every key has a default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct WorldConfig {
    /// The node's name: unique in the fleet. Default `world`.
    pub name: NodeId,
    /// The map, if it differs from the fleet's: the name of a bundled map, or the path of a file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub map: Option<String>,
    /// Seed of the world's random numbers. The same seed and the same requests give the same world.
    /// Default 1.
    pub seed: u64,
    /// World seconds per second. Default 1.
    pub speed: f64,
    /// True if the node may keep a copy of the ledger, and coordinate. Default: false, because a
    /// real fleet has no world node.
    pub may_vote: bool,
    /// Directory of the node's store, if it may vote. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub data_dir: Option<PathBuf>,
    /// Address of the dashboard, as `127.0.0.1:8088`; port 0 selects any free port. Default: none,
    /// and no dashboard is served.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dashboard: Option<SocketAddr>,
    /// The fleet: the path of its file, or a table with the same keys. Default: a fleet of all
    /// defaults.
    pub fleet: FleetRef,
    /// Network settings.
    pub bus: BusConfig,
    /// Log, metrics and spans.
    pub telemetry: TelemetryConfig,
    /// Drivers of doors, lifts and other devices of the building that the node runs. Default: none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub device: Vec<DeviceDriverConfig>,
    /// Durations of actions.
    pub durations: Durations,
    /// Size limits of the world.
    pub limits: WorldLimits,
    /// Simulated systems, by name, in the order in which they receive events. Default: all systems.
    pub systems: Vec<String>,
    /// Time step for systems that cannot be computed ahead, in seconds of world time.
    pub step_s: f64,
    /// Wind gusts that push hovering robots. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wind: Option<WindSettings>,
    /// The simulated robots, by name.
    pub robot: Vec<RobotSetup>,
    /// The people.
    pub person: Vec<PersonSetup>,
    /// Objects that lie on tables at the start.
    pub object: Vec<ObjectSetup>,
    /// Automatic doors of the map with settings other than the default.
    pub door: Vec<DoorSetup>,
    /// Obstacles, with their times.
    pub obstacle: Vec<Obstacle>,
}

impl Default for WorldConfig {
    fn default() -> Self {
        WorldConfig {
            name: NodeId::new("world").expect("a slug"),
            map: None,
            seed: 1,
            speed: 1.0,
            may_vote: false,
            data_dir: None,
            dashboard: None,
            fleet: FleetRef::default(),
            bus: BusConfig::default(),
            telemetry: TelemetryConfig::default(),
            device: vec![],
            durations: Durations::default(),
            limits: WorldLimits::default(),
            systems: system_names().map(str::to_owned).collect(),
            step_s: default_step_s(),
            wind: None,
            robot: vec![],
            person: vec![],
            object: vec![],
            door: vec![],
            obstacle: vec![],
        }
    }
}

/// Allowed speed of a world. Above the upper bound a second of node time is hours of world time.
const SPEED: std::ops::RangeInclusive<f64> = 0.001..=10_000.0;

impl ConfigFile for WorldConfig {
    const KIND: &'static str = "world";

    fn resolve_paths(&mut self, folder: &Path) {
        resolve_drivers(&mut self.device, folder);
        self.common_mut().resolve_paths(folder);
        if let Some(map) = self.map.as_mut().filter(|map| !is_shipped(map)) {
            *map = join_normalized(folder, Path::new(map)).display().to_string();
        }
    }

    fn validate(&self, domain: &Domain) -> Vec<String> {
        let mut validate = vec![];
        if !SPEED.contains(&self.speed) {
            let (speed, least, most) = (self.speed, SPEED.start(), SPEED.end());
            validate.push(format!("speed is {speed}, allowed is {least} to {most}"));
        }
        validate.extend(driver_problems(&self.device, DRIVERS_MAX));
        validate.extend(validate_common(&self.fleet, &self.bus, &self.telemetry, domain));
        validate
    }
}

impl NodeFile for WorldConfig {
    fn node(&self) -> NodeId {
        self.name.clone()
    }

    fn common_mut(&mut self) -> CommonConfig<'_> {
        common_config!(self, archive: None, is_powered: true)
    }
}
