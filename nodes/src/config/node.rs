//! What the files of all nodes have in common, whatever the node is for.

use super::read::settle_path;
use super::{BusConfig, ConfigFile, FleetRef, TelemetryConfig};
use consort_protocol::ids::NodeId;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// The file of one node.
pub trait NodeFile: ConfigFile {
    /// The node's name.
    fn node(&self) -> NodeId;

    /// What the node works with and among.
    fn surroundings(&mut self) -> Surroundings<'_>;
}

/// The part of a node's file that says what the node works with and among.
pub struct Surroundings<'a> {
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

impl Surroundings<'_> {
    /// Makes paths relative to `folder`, where the file lies.
    pub(super) fn settle(self, folder: &Path) {
        self.fleet.settle(folder);
        self.bus.settle(folder);
        settle_path(self.data_dir, folder);
    }
}

/// What is wrong with the fleet, the bus or the telemetry of a node's file.
pub(super) fn problems_around(fleet: &FleetRef, bus: &BusConfig, telemetry: &TelemetryConfig) -> Vec<String> {
    let mut problems = fleet.problems();
    problems.extend(bus.problems());
    problems.extend(telemetry.problems());
    problems
}
