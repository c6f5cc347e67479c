//! What the stories are told with.

mod client;
mod closed;
mod fleet;
mod folder;
mod http;
mod program;

pub(crate) use client::{Client, config, tasks};
pub(crate) use closed::Closed;
pub(crate) use fleet::{Fleet, example, hospital, hospital_by};
pub(crate) use folder::Folder;
pub(crate) use http::{Answer, http};
pub(crate) use program::{Ended, Program};

use std::time::{Duration, Instant};

/// How often a condition is looked at.
const LOOK: Duration = Duration::from_millis(30);

/// Waits until a condition gives something.
///
/// # Panics
/// Saying what was awaited, if it does not come about within the limit.
#[track_caller]
pub(crate) fn until<T>(what: &str, limit: Duration, condition: impl FnMut() -> Option<T>) -> T {
    within(limit, condition).unwrap_or_else(|| panic!("awaited for {limit:?} in vain: {what}"))
}

/// Waits until a condition gives something, at most for the limit.
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
