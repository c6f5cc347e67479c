//! What the files of all nodes have in common, whatever the node is for.

use super::read::resolve_path;
use super::{BusConfig, ConfigFile, FleetRef, TelemetryConfig};
use consort_protocol::ids::NodeId;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// The file of one node.
pub trait NodeFile: ConfigFile {
    /// The node's name.
    fn node(&self) -> NodeId;

    /// What the node works with and among.
    fn common_mut(&mut self) -> CommonConfig<'_>;
}

/// The part of a node's file that says what the node works with and among.
pub struct CommonConfig<'a> {
    /// Where it keeps what it has promised.
    pub data_dir: &'a mut Option<PathBuf>,
    /// Where it serves the dashboard, if it does.
    pub dashboard: &'a mut Option<SocketAddr>,
    /// What it tells those who operate it.
    pub telemetry: &'a mut TelemetryConfig,
    /// The fleet that it belongs to.
    pub fleet: &'a mut FleetRef,
    /// Where it is on the network.
    pub bus: &'a mut BusConfig,
}

impl CommonConfig<'_> {
    /// Makes paths relative to `folder`, where the file lies.
    pub(super) fn resolve_paths(self, folder: &Path) {
        self.fleet.resolve_paths(folder);
        self.bus.resolve_paths(folder);
        resolve_path(self.data_dir, folder);
    }
}

/// What is wrong with the fleet, the bus or the telemetry of a node's file.
pub(super) fn validate_common(fleet: &FleetRef, bus: &BusConfig, telemetry: &TelemetryConfig) -> Vec<String> {
    let mut problems = fleet.validate();
    problems.extend(bus.validate());
    problems.extend(telemetry.validate());
    problems
}
