//! What was not listened to, told in the log: often enough to be noticed, not so often that whoever is refused fills the disk.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;
use tokio::time::Instant;
use tracing::warn;

/// How often the same is told.
const AGAIN: Duration = Duration::from_secs(10);

/// How many different ones are told apart.
const KINDS: usize = 64;

/// What was refused, by its reason in words.
#[derive(Default)]
pub(super) struct RejectionLog(Mutex<BTreeMap<String, Told>>);

struct Told {
    at: Instant,
    since: u64,
}

impl RejectionLog {
    /// What was not listened to lately, in words.
    pub(super) fn recent(&self) -> Vec<String> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).keys().cloned().collect()
    }

    /// Something was not listened to.
    pub(super) fn record(&self, reason: String) {
        let mut told = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Instant::now();
        if told.len() >= KINDS && !told.contains_key(&reason) {
            told.retain(|_, told| now < told.at + AGAIN);
            if told.len() >= KINDS {
                return;
            }
        }
        match told.get_mut(&reason) {
            Some(before) if now < before.at + AGAIN => before.since += 1,
            Some(before) => {
                warn!(reason, more = before.since, "not listened to");
                *before = Told { at: now, since: 0 };
            }
            None => {
                warn!(reason, "not listened to");
                told.insert(reason, Told { at: now, since: 0 });
            }
        }
    }
}
