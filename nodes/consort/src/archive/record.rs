//! Records of the archive.

use consort_protocol::auction::AuctionRecord;
use consort_protocol::event::{Event, EventKind};
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId};
use consort_protocol::ledger::{AuditEntry, MissionEntry, MissionState, RoleRelease, Tombstone};
use consort_protocol::scalar::Scalar;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Record of the archive.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct ArchiveRecord {
    /// Time in milliseconds since 1970: of the event, of the change, or at which the station found the end of the mission.
    pub(crate) at_ms: u64,
    /// Content.
    pub(crate) content: ArchiveContent,
}

/// Content of a record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum ArchiveContent {
    /// A mission that has ended.
    Mission(Box<ArchivedMission>),
    /// An auction, with all replies.
    Auction(Box<AuctionRecord>),
    /// An event of a mission.
    Report {
        /// Node where it happened.
        node: NodeId,
        /// The event.
        event: Box<EventKind>,
    },
    /// A change that a person requested.
    Audit(AuditEntry),
}

/// Mission that has ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct ArchivedMission {
    /// Id of the mission.
    pub(crate) mission: MissionId,
    /// Its outcome.
    pub(crate) state: MissionState,
    /// Time of the request in milliseconds since 1970.
    pub(crate) submitted_ms: u64,
    /// The rest; `None` if the ledger kept only the outcome.
    pub(crate) details: Option<MissionDetails>,
}

/// Details of a mission that has ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct MissionDetails {
    /// Person or client that requested it.
    by: String,
    /// Priority.
    priority: i8,
    /// Values of its parameters.
    parameters: BTreeMap<String, String>,
    /// Robots that held, or completed, the roles.
    robots: BTreeMap<RoleId, RobotId>,
    /// Releases of roles.
    releases: Vec<RoleRelease>,
    /// Results.
    results: BTreeMap<String, Scalar>,
}

impl ArchivedMission {
    /// Returns the mission with this outcome; `entry` is the whole mission, if the ledger still contains it.
    pub(super) fn of(mission: &MissionId, outcome: &Tombstone, entry: Option<&MissionEntry>) -> ArchivedMission {
        let details = entry.map(|entry| MissionDetails {
            by: entry.submission.by.clone(),
            priority: entry.submission.priority.get(),
            parameters: entry.submission.parameters.clone(),
            robots: entry.holders(),
            releases: entry.releases.clone(),
            results: entry.results(),
        });
        let state = entry.map_or(&outcome.state, |entry| &entry.state).clone();
        ArchivedMission { mission: mission.clone(), state, submitted_ms: outcome.submitted_ms, details }
    }
}

/// Kind of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum ArchiveKind {
    /// Missions that have ended
    Mission,
    /// Auctions with all replies
    Auction,
    /// Awards, releases and tasks
    Report,
    /// Changes that people requested
    Audit,
}

impl ArchiveKind {
    fn as_str(self) -> &'static str {
        match self {
            ArchiveKind::Mission => "mission",
            ArchiveKind::Auction => "auction",
            ArchiveKind::Report => "report",
            ArchiveKind::Audit => "audit",
        }
    }
}

/// Columns of the records as CSV. The subject is a mission, or what a person changed; `who` is a person or a node; `details`
/// is JSON.
pub(crate) const CSV_HEADER: &str = "time,kind,subject,who,what,details";

impl ArchiveRecord {
    /// Returns the kind.
    pub(crate) fn kind(&self) -> ArchiveKind {
        match &self.content {
            ArchiveContent::Mission(_) => ArchiveKind::Mission,
            ArchiveContent::Auction(_) => ArchiveKind::Auction,
            ArchiveContent::Report { .. } => ArchiveKind::Report,
            ArchiveContent::Audit(_) => ArchiveKind::Audit,
        }
    }

    /// Returns what the record is about: a mission, or the subject of a change.
    pub(crate) fn subject(&self) -> &str {
        match &self.content {
            ArchiveContent::Mission(ended) => ended.mission.as_str(),
            ArchiveContent::Auction(auction) => auction.auction.mission.as_str(),
            ArchiveContent::Report { event, .. } => event.mission().map_or("", MissionId::as_str),
            ArchiveContent::Audit(entry) => entry.subject.as_str(),
        }
    }

    /// Returns the record as a line of CSV.
    pub(crate) fn csv(&self) -> String {
        let (who, what, details) = match &self.content {
            ArchiveContent::Mission(ended) => {
                let by = ended.details.as_ref().map_or("", |details| details.by.as_str());
                (by, ended.state.as_str().to_owned(), serde_json::to_string(ended))
            }
            ArchiveContent::Auction(auction) => {
                let what = if auction.chosen.is_empty() { "no_result" } else { "awarded" };
                ("", what.to_owned(), serde_json::to_string(auction))
            }
            ArchiveContent::Report { node, event } => {
                (node.as_str(), event.as_str().to_owned(), serde_json::to_string(event))
            }
            ArchiveContent::Audit(entry) => (entry.by.as_str(), entry.action.to_string(), serde_json::to_string(entry)),
        };
        let details = details.expect("a record has a JSON form");
        let (time, kind) = (rfc3339(self.at_ms), self.kind().as_str());
        [time.as_str(), kind, self.subject(), who, what.as_str(), details.as_str()].map(csv_field).join(",")
    }
}

/// Returns a field of CSV (RFC 4180). Spreadsheets would evaluate a text that begins as a formula.
fn csv_field(text: &str) -> String {
    let formula = if text.starts_with(['=', '+', '-', '@']) { "'" } else { "" };
    match formula.is_empty() && !text.contains(['"', ',', '\n', '\r']) {
        true => text.to_owned(),
        false => format!("\"{formula}{}\"", text.replace('"', "\"\"")),
    }
}

/// Formats a time in milliseconds since 1970: `2026-11-27T08:00:00.25Z`.
fn rfc3339(at_ms: u64) -> String {
    let at = OffsetDateTime::from_unix_timestamp_nanos(i128::from(at_ms) * 1_000_000).ok();
    at.and_then(|at| at.format(&Rfc3339).ok()).unwrap_or_default()
}

/// Returns the content of an event for the archive. `failures` are the reasons for which the latest auctions of missions had
/// no result: a repeated auction with the same reason is left out, as is what other records contain.
pub(super) fn content_of(
    Event { node, kind, .. }: Event,
    failures: &mut BTreeMap<MissionId, String>,
) -> Option<ArchiveContent> {
    match kind {
        EventKind::Closed { mission, record } => {
            let is_repeated = match &record.failure {
                Some(failure) => failures.insert(mission, failure.clone()).as_ref() == Some(failure),
                None => {
                    failures.remove(&mission);
                    false
                }
            };
            (!is_repeated).then(|| ArchiveContent::Auction(Box::new(record)))
        }
        EventKind::Mission { mission, state, .. } if state.has_ended() => {
            failures.remove(&mission); // the ledger contains more
            None
        }
        EventKind::BidsRequested { .. }
        | EventKind::Bid { .. }
        | EventKind::Progress { .. }
        | EventKind::Sent { .. }
        | EventKind::Received { .. } => None,
        kind if kind.mission().is_some() => Some(ArchiveContent::Report { node, event: Box::new(kind) }),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::auction::AuctionId;
    use consort_protocol::ledger::AuditAction;

    fn event(kind: EventKind) -> Event {
        Event { node: "base-1".parse().unwrap(), sequence: 1, at_ms: 5, kind }
    }

    #[test]
    fn repeated_auctions_without_a_result_are_left_out() {
        let mission: MissionId = "m-1".parse().unwrap();
        let closed = |failure: Option<&str>| {
            let auction = AuctionId { mission: mission.clone(), term: 1, round: 1 };
            let record = AuctionRecord { failure: failure.map(str::to_owned), ..AuctionRecord::empty(auction) };
            event(EventKind::Closed { mission: mission.clone(), record })
        };
        let mut failures = BTreeMap::new();
        let events = [Some("busy"), Some("busy"), Some("silent"), None, Some("silent")];
        let kept = events.map(|failure| content_of(closed(failure), &mut failures).is_some());
        assert_eq!(kept, [true, false, true, true, true]);
        let progress = EventKind::Progress { mission: mission.clone(), done: 1, steps: 2 };
        assert_eq!(content_of(event(progress), &mut failures), None);
        let state = MissionState::Completed;
        assert_eq!(content_of(event(EventKind::Mission { mission, state, submitted_at_ms: 1 }), &mut failures), None);
        assert!(failures.is_empty());
    }

    #[test]
    fn a_line_of_csv_quotes_texts_and_defuses_formulas() {
        let entry = AuditEntry {
            number: 7,
            at_ms: 1_000,
            by: "=Nia, \"PC\"".to_owned(),
            action: AuditAction::Cancel,
            subject: "m-1".to_owned(),
            details: String::new(),
        };
        let record = ArchiveRecord { at_ms: 1_250, content: ArchiveContent::Audit(entry) };
        let line = record.csv();
        assert!(line.starts_with("1970-01-01T00:00:01.25Z,audit,m-1,\"'=Nia, \"\"PC\"\"\",cancel,\"{"), "{line}");
        let text = serde_json::to_string(&record).unwrap();
        assert_eq!(serde_json::from_str::<ArchiveRecord>(&text).unwrap(), record);
    }
}
