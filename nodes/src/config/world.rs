//! The world file: a node that hosts a simulated world.

use super::node::validate_common;
use super::read::join_normalized;
use super::{BusConfig, CommonConfig, ConfigFile, FleetRef, NodeFile, TelemetryConfig};
use crate::map_loader::is_shipped;
use consort_protocol::ids::NodeId;
use consort_sim::world::{
    DoorSetup, Durations, ObjectSetup, Obstacle, PersonSetup, RobotSetup, WindSettings, WorldLimits, default_step_s,
    system_names,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// A world file. Every key has a default; a world without robots is a dull one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct WorldConfig {
    /// The node's name: unique in the fleet. Default `world`.
    pub name: NodeId,
    /// The map, where it is not the fleet's: the name of one that is shipped, or the path of a file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub map: Option<String>,
    /// What the world's chance comes from. The same seed and the same requests give the same world. Default 1.
    pub seed: u64,
    /// World seconds that pass in one second. Default 1.
    pub speed: f64,
    /// Whether the node may keep a copy of the ledger, and coordinate. Default: it may not, for a world is no part of a
    /// real fleet.
    pub may_vote: bool,
    /// The directory in which the node keeps what it has promised, if it may vote. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub data_dir: Option<PathBuf>,
    /// Address at which the node serves the dashboard, as `127.0.0.1:8088`; port 0 is any free one. Default: none, and it
    /// serves none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dashboard: Option<SocketAddr>,
    /// The fleet: the path of its file, or a table with the same keys. Default: a fleet of all defaults.
    pub fleet: FleetRef,
    /// Where it is on the network.
    pub bus: BusConfig,
    /// What it tells those who operate it.
    pub telemetry: TelemetryConfig,
    /// How long things take.
    pub durations: Durations,
    /// How much the world holds and remembers.
    pub limits: WorldLimits,
    /// What can happen there, by name, in the order in which it hears of things. Default: all that can.
    pub systems: Vec<String>,
    /// Time between two instants at which what cannot be computed ahead is brought up to date, in seconds of world time.
    pub step_s: f64,
    /// Gusts that push at what hovers. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gusts: Option<WindSettings>,
    /// The robots' bodies, by the names of their robots.
    pub robot: Vec<RobotSetup>,
    /// The people.
    pub person: Vec<PersonSetup>,
    /// Things that lie on tables at first.
    pub object: Vec<ObjectSetup>,
    /// Automatic doors of the map that are not as usual.
    pub door: Vec<DoorSetup>,
    /// What stands in the way, and when.
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
            durations: Durations::default(),
            limits: WorldLimits::default(),
            systems: system_names().map(str::to_owned).collect(),
            step_s: default_step_s(),
            gusts: None,
            robot: vec![],
            person: vec![],
            object: vec![],
            door: vec![],
            obstacle: vec![],
        }
    }
}

/// Fastest and slowest a world may run. Beyond the upper bound a second of node time is hours of world time.
const SPEED: std::ops::RangeInclusive<f64> = 0.001..=10_000.0;

impl ConfigFile for WorldConfig {
    const KIND: &'static str = "world";

    fn resolve_paths(&mut self, folder: &Path) {
        self.common_mut().resolve_paths(folder);
        if let Some(map) = self.map.as_mut().filter(|map| !is_shipped(map)) {
            *map = join_normalized(folder, Path::new(map)).display().to_string();
        }
    }

    fn validate(&self) -> Vec<String> {
        let mut validate = vec![];
        if !SPEED.contains(&self.speed) {
            let (speed, least, most) = (self.speed, SPEED.start(), SPEED.end());
            validate.push(format!("speed is {speed}, allowed is {least} to {most}"));
        }
        validate.extend(validate_common(&self.fleet, &self.bus, &self.telemetry));
        validate
    }
}

impl NodeFile for WorldConfig {
    fn node(&self) -> NodeId {
        self.name.clone()
    }

    fn common_mut(&mut self) -> CommonConfig<'_> {
        CommonConfig {
            data_dir: &mut self.data_dir,
            dashboard: &mut self.dashboard,
            telemetry: &mut self.telemetry,
            fleet: &mut self.fleet,
            bus: &mut self.bus,
        }
    }
}
