//! The frame rate of the dashboard in a real browser. A program of its own, so that no other test
//! runs at the same time. The tests of `dashboard` explain the browser.

#[path = "../dashboard/browser.rs"]
#[expect(dead_code, reason = "the tests of the dashboard use the rest")]
mod browser;
mod many_robots;
#[path = "../dashboard/shown_model.rs"]
mod shown_model;
#[path = "../../../../tests/support/slots.rs"]
mod slots;
#[path = "../processes/support/mod.rs"]
#[expect(dead_code, unused_imports, reason = "the tests of processes use the rest")]
mod support;
