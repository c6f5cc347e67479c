//! The archive of a station.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

/// `[archive]`: ended missions, auctions, tasks and the audit trail, kept in the data directory longer than the ledger
/// remembers them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ArchiveConfig {
    /// Maximum age in days, 1 to 36500. Default: 90.
    pub days: u32,
    /// Maximum size in megabytes, 10 to 1000000; the earliest records are removed. Default: 512.
    pub megabytes: u32,
}

/// Both are guesses: a quarter, and a small part of any disk.
impl Default for ArchiveConfig {
    fn default() -> ArchiveConfig {
        ArchiveConfig { days: 90, megabytes: 512 }
    }
}

impl ArchiveConfig {
    pub(super) fn validate(&self) -> Vec<String> {
        let problem = |key: &str, value: u32, allowed: RangeInclusive<u32>| {
            let (min, max) = (allowed.start(), allowed.end());
            (!allowed.contains(&value)).then(|| format!("archive.{key} is {value}, allowed is {min} to {max}"))
        };
        let days = problem("days", self.days, 1..=36_500);
        days.into_iter().chain(problem("megabytes", self.megabytes, 10..=1_000_000)).collect()
    }
}
