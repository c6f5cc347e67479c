//! The dashboard in a real browser: headless Chromium, driven over WebDriver.
//!
//! The tests need the programs `chromium` and `chromedriver` (Debian:
//! `apt-get install chromium chromium-driver`); without them each test is skipped.
//! Screenshots are stored in `target/tmp/dashboard/`. With `CONSORT_PICTURES` set, the same tests
//! also write the screenshots in `docs/`.

mod alarms;
mod browser;
mod closed;
mod closures;
mod demo_fleet;
mod doors_and_interventions;
mod limits;
mod mission_files;
mod mission_orders;
mod orders;
mod people;
mod recording;
mod robot_panel;
mod schedules;
mod shown_model;
#[path = "../../../../tests/support/slots.rs"]
mod slots;
mod station;
#[path = "../processes/support/mod.rs"]
#[expect(dead_code, unused_imports, reason = "the tests of processes use the rest")]
mod support;
