//! The station file: a node without a robot, which keeps the ledger and may coordinate.

use super::node::validate_common;
use super::{BusConfig, CommonConfig, ConfigFile, FleetRef, NodeFile, TelemetryConfig, yes};
use consort_protocol::ids::NodeId;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// A station file. Only `name` must be there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StationConfig {
    /// The node's name: unique in the fleet.
    pub name: NodeId,
    /// Whether it stays where it is. Default: it does.
    #[serde(default = "yes")]
    pub stationary: bool,
    /// Whether it lives on mains power. Default: it does.
    #[serde(default = "yes")]
    pub mains_powered: bool,
    /// Whether it may keep a copy of the ledger, and coordinate. Default: it may.
    #[serde(default = "yes")]
    pub may_vote: bool,
    /// The directory in which the node keeps what it has promised. Default: none, and it forgets all when it ends.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub data_dir: Option<PathBuf>,
    /// Address at which the node serves the dashboard, as `127.0.0.1:8088`; port 0 is any free one. Default: none, and it
    /// serves none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dashboard: Option<SocketAddr>,
    /// The fleet: the path of its file, or a table with the same keys. Default: a fleet of all defaults.
    #[serde(default)]
    pub fleet: FleetRef,
    /// Where it is on the network.
    #[serde(default)]
    pub bus: BusConfig,
    /// What it tells those who operate it.
    #[serde(default)]
    pub telemetry: TelemetryConfig,
}

impl StationConfig {
    /// A station with the defaults of a station file.
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
        }
    }
}

impl ConfigFile for StationConfig {
    const KIND: &'static str = "station";

    fn resolve_paths(&mut self, folder: &Path) {
        self.common_mut().resolve_paths(folder);
    }

    fn validate(&self) -> Vec<String> {
        validate_common(&self.fleet, &self.bus, &self.telemetry)
    }
}

impl NodeFile for StationConfig {
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
