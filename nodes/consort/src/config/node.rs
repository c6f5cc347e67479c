//! Settings common to all node files.

use super::read::resolve_path;
use super::{ArchiveConfig, BusConfig, ConfigFile, FleetRef, TelemetryConfig};
use consort_protocol::ids::NodeId;
use consort_protocol::mission::Domain;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// The file of a node.
pub trait NodeFile: ConfigFile {
    /// Returns the node's name.
    fn node(&self) -> NodeId;

    /// Returns the common settings.
    fn common_mut(&mut self) -> CommonConfig<'_>;
}

/// The settings common to all node files.
pub struct CommonConfig<'a> {
    /// Directory of the node's store.
    pub data_dir: &'a mut Option<PathBuf>,
    /// Address of the dashboard, if it is served.
    pub dashboard: &'a mut Option<SocketAddr>,
    /// Log, metrics and spans.
    pub telemetry: &'a mut TelemetryConfig,
    /// The node's fleet.
    pub fleet: &'a mut FleetRef,
    /// Network settings.
    pub bus: &'a mut BusConfig,
    /// Archive of a station.
    pub archive: Option<ArchiveConfig>,
    /// True if the node is a station or a world, or runs on mains power.
    pub is_powered: bool,
    /// True if the node may keep a copy of the ledger, and coordinate.
    pub may_vote: bool,
}

/// Returns the [`CommonConfig`] of a node file, which has its fields.
macro_rules! common_config {
    ($file:ident, archive: $archive:expr, is_powered: $is_powered:expr) => {
        CommonConfig {
            data_dir: &mut $file.data_dir,
            dashboard: &mut $file.dashboard,
            telemetry: &mut $file.telemetry,
            fleet: &mut $file.fleet,
            bus: &mut $file.bus,
            archive: $archive,
            is_powered: $is_powered,
            may_vote: $file.may_vote,
        }
    };
}

pub(super) use common_config;

impl CommonConfig<'_> {
    /// Resolves paths relative to `folder`, the folder of the file.
    pub(super) fn resolve_paths(self, folder: &Path) {
        self.fleet.resolve_paths(folder);
        self.bus.resolve_paths(folder);
        resolve_path(self.data_dir, folder);
    }
}

/// Returns the problems of the fleet, bus and telemetry settings.
pub(super) fn validate_common(
    fleet: &FleetRef,
    bus: &BusConfig,
    telemetry: &TelemetryConfig,
    domain: &Domain,
) -> Vec<String> {
    let mut problems = fleet.validate(domain);
    problems.extend(bus.validate());
    problems.extend(telemetry.validate());
    problems
}
