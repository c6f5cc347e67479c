//! Dates of a run: each run begins at the same date.

use std::time::Duration;

/// Date at the start of every run, in milliseconds since 1970.
pub(crate) const DATE_MS: u64 = 1_790_000_000_000;

/// Returns the date at this time since the start of a run, in milliseconds since 1970.
pub(super) fn date_ms(elapsed: Duration) -> u64 {
    DATE_MS + millis(elapsed)
}

/// Returns a time in milliseconds.
pub(super) fn millis(time: Duration) -> u64 {
    u64::try_from(time.as_millis()).unwrap_or(u64::MAX)
}
