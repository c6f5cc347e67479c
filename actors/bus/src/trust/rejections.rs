//! Log of rejected messages, rate-limited: frequent enough to be noticed, and rare enough that a
//! sender of rejected messages cannot fill the disk.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;
use tokio::time::Instant;
use tracing::warn;

/// Minimum interval between log lines with the same reason.
const LOG_INTERVAL: Duration = Duration::from_secs(10);

/// Maximum number of distinct reasons.
const REASONS_MAX: usize = 64;

/// Rejected messages by reason, and their number.
#[derive(Default)]
pub(super) struct RejectionLog {
    entries: Mutex<BTreeMap<String, LogEntry>>,
    count: AtomicU64,
}

struct LogEntry {
    at: Instant,
    suppressed: u64,
}

impl RejectionLog {
    /// Returns the recent reasons, as text.
    pub(super) fn recent(&self) -> Vec<String> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner).keys().cloned().collect()
    }

    /// Returns the number of rejections so far.
    pub(super) fn count(&self) -> u64 {
        self.count.load(Ordering::Relaxed)
    }

    /// Records a rejection.
    pub(super) fn record(&self, reason: String) {
        self.count.fetch_add(1, Ordering::Relaxed);
        let mut entries = self.entries.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Instant::now();
        if entries.len() >= REASONS_MAX && !entries.contains_key(&reason) {
            entries.retain(|_, entry| now < entry.at + LOG_INTERVAL);
            if entries.len() >= REASONS_MAX {
                return;
            }
        }
        match entries.get_mut(&reason) {
            Some(entry) if now < entry.at + LOG_INTERVAL => entry.suppressed += 1,
            Some(entry) => {
                warn!(reason, more = entry.suppressed, "rejected a message");
                *entry = LogEntry { at: now, suppressed: 0 };
            }
            None => {
                warn!(reason, "rejected a message");
                entries.insert(reason, LogEntry { at: now, suppressed: 0 });
            }
        }
    }
}
