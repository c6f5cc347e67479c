//! Limits of the history of ended missions.

use serde::{Deserialize, Serialize};

/// Limits of the history of ended missions. They are part of the ledger, so that all replicas forget
/// the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct HistoryLimits {
    /// Maximum number of ended missions kept whole, for display; the earliest ended are dropped.
    pub missions_max: u32,
    /// Time for which an outcome is known after the end of a mission, in milliseconds. Raised: later
    /// repetitions of a request are recognised, and the ledger is larger.
    pub outcome_age_max_ms: u64,
    /// Maximum size of all outcomes in bytes. Raised: more missions are remembered, and snapshots are
    /// larger.
    pub outcome_bytes_max: u64,
}

impl HistoryLimits {
    /// The largest limits.
    pub const LARGEST: HistoryLimits = HistoryLimits {
        missions_max: 500,
        outcome_age_max_ms: 365 * 24 * 60 * 60 * 1000,
        outcome_bytes_max: 16 * 1024 * 1024,
    };

    /// Returns limits that do not exceed the largest.
    #[must_use]
    pub(super) fn bounded(self) -> HistoryLimits {
        let largest = HistoryLimits::LARGEST;
        HistoryLimits {
            missions_max: self.missions_max.min(largest.missions_max),
            outcome_age_max_ms: self.outcome_age_max_ms.min(largest.outcome_age_max_ms),
            outcome_bytes_max: self.outcome_bytes_max.min(largest.outcome_bytes_max),
        }
    }
}

/// A day, and some twenty thousand outcomes. The day is a guess.
impl Default for HistoryLimits {
    fn default() -> HistoryLimits {
        HistoryLimits {
            outcome_age_max_ms: 24 * 60 * 60 * 1000,
            outcome_bytes_max: 4 * 1024 * 1024,
            ..HistoryLimits::LARGEST
        }
    }
}
