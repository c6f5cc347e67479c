//! The station file: a node without a robot, which keeps the ledger and may coordinate.

use super::devices::{DRIVERS_MAX, DeviceDriverConfig, driver_problems, resolve_drivers};
use super::node::{common_config, validate_common};
use super::{ArchiveConfig, BusConfig, CommonConfig, ConfigFile, FleetRef, NodeFile, TelemetryConfig, yes};
use consort_protocol::ids::NodeId;
use consort_protocol::mission::Domain;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// A station file. Only `name` is required.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StationConfig {
    /// The node's name: unique in the fleet.
    pub name: NodeId,
    /// True if the node does not move. Default: true.
    #[serde(default = "yes")]
    pub stationary: bool,
    /// True if the node runs on mains power. Default: true.
    #[serde(default = "yes")]
    pub mains_powered: bool,
    /// True if the node may keep a copy of the ledger, and coordinate. Default: true.
    #[serde(default = "yes")]
    pub may_vote: bool,
    /// Directory of the node's store. Default: none, and all state is lost when the node ends.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub data_dir: Option<PathBuf>,
    /// Address of the dashboard, as `127.0.0.1:8088`; port 0 selects any free port. Default: none,
    /// and no dashboard is served.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dashboard: Option<SocketAddr>,
    /// The fleet: the path of its file, or a table with the same keys. Default: a fleet of all
    /// defaults.
    #[serde(default)]
    pub fleet: FleetRef,
    /// Network settings.
    #[serde(default)]
    pub bus: BusConfig,
    /// Log, metrics and spans.
    #[serde(default)]
    pub telemetry: TelemetryConfig,
    /// Drivers of doors, lifts and other devices of the building that the node runs. Default: none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub device: Vec<DeviceDriverConfig>,
    /// Archive in the data directory. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub archive: Option<ArchiveConfig>,
}

impl StationConfig {
    /// Creates the configuration of a station, with the defaults of a station file.
    pub fn new(name: NodeId) -> StationConfig {
        StationConfig {
            name,
            stationary: true,
            mains_powered: true,
            may_vote: true,
            data_dir: None,
            dashboard: None,
            fleet: FleetRef::default(),
            bus: BusConfig::default(),
            telemetry: TelemetryConfig::default(),
            device: vec![],
            archive: None,
        }
    }
}

impl ConfigFile for StationConfig {
    const KIND: &'static str = "station";

    fn resolve_paths(&mut self, folder: &Path) {
        resolve_drivers(&mut self.device, folder);
        self.common_mut().resolve_paths(folder);
    }

    fn validate(&self, domain: &Domain) -> Vec<String> {
        let mut problems = validate_common(&self.fleet, &self.bus, &self.telemetry, domain);
        problems.extend(driver_problems(&self.device, DRIVERS_MAX));
        problems.extend(self.archive.iter().flat_map(ArchiveConfig::validate));
        problems
    }
}

impl NodeFile for StationConfig {
    fn node(&self) -> NodeId {
        self.name.clone()
    }

    fn common_mut(&mut self) -> CommonConfig<'_> {
        common_config!(self, archive: self.archive, is_powered: true)
    }
}
