//! Test harness for whole fleets.

pub mod allocation;
pub mod behavior;
pub mod body_log;
pub mod chaos;
mod charging_setup;
mod checks;
mod client;
mod credentials;
pub(crate) mod disk;
mod event_log;
pub mod example_files;
pub mod experiment;
mod failing_domain;
mod fleet;
pub mod history;
pub mod host_network;
mod inspection;
pub mod ledger_copies;
mod order_bounds;
pub mod own_records;
pub mod percentiles;
mod robot_spec;
pub mod scale;
pub mod shift;
mod station_fleet;
mod stolen_key;
mod ward;

pub use charging_setup::ChargingSetup;
pub use credentials::{Credentials, Signatures};
pub use event_log::{EventLog, Observation, RoleInterval};
pub use failing_domain::{FAILING_TASKS, failing_domain};
pub(crate) use fleet::AdjustNode;
pub use fleet::{DomainSetup, Fleet};
pub use robot_spec::RobotSpec;
pub use station_fleet::StationFleet;
pub use stolen_key::{StolenKey, report_of_all_steps, signals_sent};

use std::fmt;
use tokio::runtime::{Builder, Runtime};

/// Parses a slug that the test itself contains.
pub fn slug<T: std::str::FromStr<Err: fmt::Debug>>(text: &str) -> T {
    text.parse().expect("a test's own name")
}

/// Returns a runtime whose clock advances while nothing else is to be done.
pub(crate) fn paused_runtime() -> Runtime {
    Builder::new_current_thread().enable_time().start_paused(true).build().expect("a runtime without I/O")
}

/// Runs a test once per seed, each time on a new paused runtime, so that no state passes from one
/// run to the next.
pub fn for_each_seed(seeds: impl IntoIterator<Item = u64>, test: impl AsyncFn(u64)) {
    for seed in seeds {
        paused_runtime().block_on(test(seed));
    }
}
