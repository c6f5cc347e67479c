//! Configuration of nodes by files, flags and the environment.
//!
//! There are four kinds of TOML file: a *fleet* file, shared by all nodes of a fleet, and a
//! *robot*, *station* or *world* file for a single node, which names its fleet file. Flags override
//! environment variables (`CONSORT_…`), variables override files, and files override defaults. An
//! unknown key is an error that lists the allowed keys. A relative path is relative to the file
//! that contains it.
//!
//! ```
//! use consort_nodes::config::{FleetConfig, from_text};
//! use consort_skills::extensions::Extensions;
//!
//! let domain = Extensions::default().domain();
//! let fleet: FleetConfig = from_text("name = \"ward\"\nvoters = 3\n", "fleet.toml", &domain)?;
//! assert_eq!((fleet.voters, fleet.lease.lease_ms), (3, 4000));
//!
//! let wrong = from_text::<FleetConfig>("name = \"ward\"\nvotters = 3\n", "fleet.toml", &domain).unwrap_err();
//! assert!(wrong.to_string().starts_with("fleet.toml:2:1: unknown key `votters` in a fleet file; allowed: name, map, "));
//! # Ok::<(), consort_nodes::diagnostic::Diagnostics>(())
//! ```

mod alarms;
mod archive;
mod bus;
mod calibration;
mod charging;
mod devices;
mod fleet;
mod node;
mod read;
mod relay;
mod robot;
mod station;
mod telemetry;
mod world;

pub(crate) use alarms::alarm_plans;
pub use alarms::{AlarmConfig, PartConfig};
pub use archive::ArchiveConfig;
pub use bus::{BusConfig, RelaySetting, trust_files};
pub use charging::{ChargerConfig, ChargingConfig, SwapConfig};
pub(crate) use devices::devices;
pub use devices::{DeviceConfig, DeviceDriverConfig};
pub use fleet::{AuctionConfig, FleetConfig, FleetRef, LeaseConfig, LimitsConfig, ObjectiveName, RequestsConfig};
pub(crate) use fleet::{DEFAULT_FLEET, cancel_problems, zone_problems};
pub use node::{CommonConfig, NodeFile};
pub(crate) use read::load_unchecked;
pub use read::{ConfigFile, from_text, join_normalized, load, resolve_path, to_toml};
#[cfg(test)]
pub(crate) use relay::RoleReason;
pub(crate) use relay::{LARGE_FLEET, LinkRole, RelayError};
pub use robot::RobotConfig;
pub(crate) use robot::useful_charge;
pub use station::StationConfig;
pub use telemetry::{LogFormat, TelemetryConfig};
pub use world::WorldConfig;

fn yes() -> bool {
    true
}
