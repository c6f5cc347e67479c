//! Support for tests with processes.

mod client;
mod closed;
mod fleet;
mod folder;
#[path = "../../../../../tests/support/free_port.rs"]
mod free_port;
mod http;
mod program;
mod published;
#[path = "../../../../../tests/support/skip.rs"]
mod skip;

pub(crate) use client::{Client, config, tasks};
pub(crate) use closed::Closed;
pub(crate) use consort_tests::example_files::example;
pub(crate) use fleet::{Fleet, VIEWS, hospital, hospital_by};
pub(crate) use folder::Folder;
pub(crate) use free_port::free_port;
pub(crate) use http::{Answer, http};
pub(crate) use program::{Ended, Program};
pub(crate) use published::reference;
pub(crate) use skip::skip;

use std::time::{Duration, Instant};

/// Limit for events that must happen. It is generous, because the tests run side by side.
pub(crate) const LONG: Duration = Duration::from_secs(150);

/// Interval between two checks of a condition.
const LOOK: Duration = Duration::from_millis(30);

/// Waits until a condition returns a value.
///
/// # Panics
/// If the condition returns none within the limit.
#[track_caller]
pub(crate) fn until<T>(what: &str, limit: Duration, condition: impl FnMut() -> Option<T>) -> T {
    within(limit, condition).unwrap_or_else(|| panic!("not within {limit:?}: {what}"))
}

/// Waits at most `limit` until a condition returns a value.
fn within<T>(limit: Duration, mut condition: impl FnMut() -> Option<T>) -> Option<T> {
    let deadline = Instant::now() + limit;
    loop {
        let found = condition();
        if found.is_some() || Instant::now() >= deadline {
            return found;
        }
        std::thread::sleep(LOOK);
    }
}
