//! Stations with a dashboard.

use crate::browser::SOON;
use crate::support::{Fleet, Program, example, until};
use toml::Table;

/// Returns the settings of a node with a changed value.
pub(crate) fn with(mut table: Table, key: &str, value: impl Into<toml::Value>) -> Table {
    table.insert(key.to_owned(), value.into());
    table
}

/// Returns the settings of a station with a dashboard on a free port.
pub(crate) fn station_with_dashboard() -> Table {
    with(example("station"), "dashboard", "127.0.0.1:0")
}

/// Starts a fleet of a single station. Returns it with the address of its dashboard.
pub(crate) fn start_station() -> (Fleet, String) {
    let mut fleet = Fleet::new(&with(example("fleet"), "bootstrap_expect", 1));
    fleet.start("station", station_with_dashboard(), &[]);
    let url = dashboard_address(fleet.node("station-1"));
    (fleet, url)
}

/// Waits until a program prints the address of its dashboard.
#[track_caller]
pub(crate) fn dashboard_address(program: &mut Program) -> String {
    until("the address of the dashboard", SOON, || {
        assert!(!program.has_ended(), "it has ended: {}", program.stderr());
        Some(program.stdout().lines().find_map(|line| line.strip_prefix("dashboard: "))?.to_owned())
    })
}
