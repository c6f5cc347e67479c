//! Audit trail: who requested which change, and when.

use super::shared_queue::SharedQueue;
use crate::bounds::limit_text;
use crate::codec;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Maximum number of entries; the earliest are dropped. A guess: some days of a busy fleet.
const ENTRIES_MAX: usize = 2000;

/// Maximum encoded size of all entries in bytes; the earliest are dropped. Raised: a snapshot may be too large
/// for every replica.
pub(super) const AUDIT_BYTES_MAX: usize = 256 * 1024;

/// Maximum size of the subject and of the details of an entry, in bytes.
const TEXT_BYTES_MAX: usize = 256;

/// Kind of a change that people request.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AuditAction {
    /// A mission was submitted.
    Submit,
    /// A mission was canceled.
    Cancel,
    /// An intervention was resolved.
    Resolve,
    /// A request to a person was answered.
    Answer,
    /// A schedule was added.
    AddSchedule,
    /// A schedule was paused.
    PauseSchedule,
    /// A schedule was resumed.
    ResumeSchedule,
    /// A schedule was removed.
    RemoveSchedule,
    /// Robots were held.
    Hold,
    /// Robots were released.
    Release,
    /// Robots were taken out of service.
    BeginMaintenance,
    /// Robots were returned to service.
    EndMaintenance,
    /// Zones, places or lanes were closed.
    Close,
    /// Zones, places or lanes were opened.
    Open,
    /// The wire version of the fleet was raised.
    RaiseWireVersion,
    /// Speed limits were set.
    LimitSpeed,
    /// Speed limits were cleared.
    ClearSpeedLimit,
    /// An alarm was raised.
    RaiseAlarm,
    /// Alarms were cleared.
    ClearAlarm,
    /// The priority of a mission was changed.
    SetPriority,
    /// A role was reassigned.
    Reassign,
    /// A role was pinned to a robot.
    Pin,
    /// The order about a role was ended.
    Unpin,
}

impl fmt::Display for AuditAction {
    /// The name, as in JSON.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// Change that a person requested, and that the ledger made.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct AuditEntry {
    /// Number among all entries ever made, from 1. Earlier entries may have been dropped.
    pub number: u64,
    /// Time in milliseconds since 1970. It never decreases.
    pub at_ms: u64,
    /// The person; in a closed fleet the signer.
    pub by: String,
    /// Kind of change.
    pub action: AuditAction,
    /// What was changed: a mission, a request to a person, a schedule, robots, zones, places and lanes, alarms, or the wire
    /// version.
    pub subject: String,
    /// Details, such as the reason; may be empty.
    pub details: String,
}

/// The audit trail, limited in number and size.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct AuditTrail {
    entries: SharedQueue<AuditEntry>,
    /// Number of entries ever made.
    made: u64,
    /// Encoded size of the entries.
    bytes: u64,
}

impl AuditTrail {
    /// Returns the entries in their order.
    pub(super) fn entries(&self) -> impl Iterator<Item = &AuditEntry> {
        self.entries.iter()
    }

    /// Adds an entry under the next number, and drops the earliest entries beyond the limits.
    pub(super) fn push(&mut self, mut entry: AuditEntry) {
        self.made = self.made.saturating_add(1);
        entry.number = self.made;
        entry.at_ms = entry.at_ms.max(self.entries.back().map_or(0, |latest| latest.at_ms));
        limit_text(&mut entry.subject, TEXT_BYTES_MAX);
        limit_text(&mut entry.details, TEXT_BYTES_MAX);
        self.bytes = self.bytes.saturating_add(size(&entry));
        self.entries.push_back(entry);
        while self.entries.len() > ENTRIES_MAX || self.bytes > AUDIT_BYTES_MAX as u64 {
            let Some(dropped) = self.entries.pop_front() else { return };
            self.bytes = self.bytes.saturating_sub(size(&dropped));
        }
    }
}

fn size(entry: &AuditEntry) -> u64 {
    codec::encoded_size(entry) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(at_ms: u64, details: &str) -> AuditEntry {
        let (by, subject) = ("Nia".to_owned(), "ada".to_owned());
        AuditEntry { number: 0, at_ms, by, action: AuditAction::Hold, subject, details: details.to_owned() }
    }

    #[test]
    fn the_trail_keeps_the_latest_entries_within_its_limits() {
        for details in ["", &"x".repeat(10_000)] {
            let mut trail = AuditTrail::default();
            (0..5000).for_each(|at_ms| trail.push(entry(at_ms, details)));
            let numbers: Vec<u64> = trail.entries().map(|entry| entry.number).collect();
            let bytes: u64 = trail.entries().map(size).sum();
            assert!(bytes <= AUDIT_BYTES_MAX as u64 && bytes == trail.bytes, "{bytes}");
            assert!(numbers.len() <= ENTRIES_MAX && numbers.len() > 500, "{}", numbers.len());
            let first = 5001 - numbers.len() as u64;
            assert_eq!(numbers, (first..=5000).collect::<Vec<_>>());
        }
    }

    #[test]
    fn the_time_of_an_entry_never_decreases() {
        let mut trail = AuditTrail::default();
        [500, 300, 0, 600].into_iter().for_each(|at_ms| trail.push(entry(at_ms, "")));
        assert_eq!(trail.entries().map(|entry| entry.at_ms).collect::<Vec<_>>(), [500, 500, 500, 600]);
    }
}
