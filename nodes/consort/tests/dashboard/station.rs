//! Stations with a dashboard.

use crate::browser::{Browser, SOON};
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

/// Starts a fleet of a single station, and opens its dashboard.
pub(crate) fn open_station(browser: &Browser) -> Fleet {
    let mut fleet = Fleet::new(&with(example("fleet"), "bootstrap_expect", 1));
    fleet.start("station", station_with_dashboard(), &[]);
    browser.open(&dashboard_address(fleet.node("station-1")));
    wait_for_coordinator(browser);
    fleet
}

/// Starts a ward with ada and an arm whose world runs at this speed, and opens its dashboard.
pub(crate) fn open_ward(browser: &Browser, speed: f64) -> Fleet {
    let mut fleet = Fleet::new(&example("fleet"));
    fleet.start("station", station_with_dashboard(), &[]);
    fleet.start("world", with(example("world"), "speed", speed), &["station-1"]);
    fleet.start("robot", example("robot"), &["station-1", "world"]);
    fleet.start("robot", example("arm"), &["station-1", "world"]);
    browser.open(&dashboard_address(fleet.node("station-1")));
    browser.wait_until("both robots", "document.querySelectorAll('#robots tbody tr').length === 2");
    wait_for_coordinator(browser);
    fleet
}

/// Waits until the page shows a coordinator, which may then receive orders.
#[track_caller]
pub(crate) fn wait_for_coordinator(browser: &Browser) {
    browser.wait_until("the coordinator", "/term \\d/.test(document.querySelector('#coordinator').innerText)");
}

/// Waits until a program prints the address of its dashboard.
#[track_caller]
pub(crate) fn dashboard_address(program: &mut Program) -> String {
    until("the address of the dashboard", SOON, || {
        assert!(!program.has_ended(), "it has ended: {}", program.stderr());
        Some(program.stdout().lines().find_map(|line| line.strip_prefix("dashboard: "))?.to_owned())
    })
}
