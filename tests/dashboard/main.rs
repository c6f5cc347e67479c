//! The dashboard in a real browser: Chromium without a window, driven over WebDriver.
//!
//! They need the programs `chromium` and `chromedriver` (Debian: `apt-get install chromium chromium-driver`); without them
//! each test is skipped, and says so. Pictures of what was seen are left in `target/tmp/dashboard/`; those in `nodes/docs/` are
//! made by the same tests, where `CONSORT_PICTURES` is set.

mod browser;
mod closed;
mod demo_fleet;
mod doors_and_interventions;
mod many_robots;
mod recording;
#[path = "../processes/support/mod.rs"]
#[expect(dead_code, unused_imports, reason = "the tests of processes use the rest")]
mod support;
