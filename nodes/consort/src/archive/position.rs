//! Position up to which the ledger has been archived.

use super::record::{ArchiveContent, ArchiveRecord, ArchivedMission};
use consort_protocol::ids::MissionId;
use consort_protocol::ledger::{Ledger, Tombstone};
use serde::{Deserialize, Serialize};

/// Position in the history and in the audit trail of the ledger. A station that was down continues there; what the ledger has
/// forgotten meanwhile is in the archives of other stations.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct ArchivePosition {
    /// The mission that ended last.
    mission: Option<MissionId>,
    /// Number of the latest entry of the audit trail.
    audit: u64,
}

impl ArchivePosition {
    /// Returns the records of what the ledger contains after this position, and moves it to the end.
    pub(super) fn advance(&mut self, ledger: &Ledger, now_ms: u64) -> Vec<ArchiveRecord> {
        let is_new = |(mission, _): &(&MissionId, &Tombstone)| self.mission.as_ref() != Some(*mission);
        let mut ended: Vec<(&MissionId, &Tombstone)> = ledger.latest_ended().take_while(is_new).collect();
        ended.reverse();
        let missions = ended.iter().map(|(mission, outcome)| {
            let ended = ArchivedMission::of(mission, outcome, ledger.mission(mission));
            ArchiveRecord { at_ms: now_ms, content: ArchiveContent::Mission(Box::new(ended)) }
        });
        let changes = ledger.audit_trail().filter(|entry| entry.number > self.audit);
        let changes =
            changes.map(|entry| ArchiveRecord { at_ms: entry.at_ms, content: ArchiveContent::Audit(entry.clone()) });
        let records: Vec<ArchiveRecord> = missions.chain(changes).collect();
        if let Some((mission, _)) = ended.last() {
            self.mission = Some(MissionId::clone(mission));
        }
        self.audit = ledger.audit_trail().last().map_or(self.audit, |entry| entry.number);
        records
    }
}

#[cfg(test)]
mod tests {
    use super::super::record::ArchiveKind;
    use super::*;
    use consort_protocol::lease::Epoch;
    use consort_protocol::ledger::{Command, HistoryLimits, Submission};
    use consort_protocol::mission::{Format, MissionTemplate};
    use consort_protocol::plan::divide_and_check;
    use consort_skills::domain::hospital;
    use std::collections::BTreeMap;

    const MISSION: &str = r#"{"mission": "rest", "roles": {"r1": {"kind": "managed"}},
        "root": {"task": "wait", "type": "wait", "roles": ["r1"], "parameters": {"seconds": "5"}}}"#;

    struct Log(Ledger, u64);

    impl Log {
        fn apply(&mut self, command: Command) {
            self.1 += 1;
            self.0.apply(Epoch { term: 1, index: self.1 }, command);
        }

        /// Submits a mission and cancels it.
        fn end_mission(&mut self, request: &str) {
            let mission = MissionTemplate::parse(MISSION, Format::Json).unwrap();
            let mission = mission.instantiate(&BTreeMap::new(), &hospital()).unwrap();
            let division = divide_and_check(&mission).unwrap();
            let submission = Submission::of(request.parse().unwrap(), mission, division);
            self.apply(Command::Submit(Box::new(submission)));
            let mission = self.0.active_missions()[0].id.clone();
            let (by, places) = ("Nia".to_owned(), BTreeMap::new());
            self.apply(Command::Cancel { mission, by, places, at_ms: 7 });
        }
    }

    #[test]
    fn each_end_and_each_change_is_archived_once_in_its_order() {
        let mut log = Log(Ledger::default(), 0);
        log.apply(Command::first_wire_version(3));
        let mut position = ArchivePosition::default();
        log.end_mission("a");
        log.end_mission("b");
        let archived = |records: Vec<ArchiveRecord>, kind: ArchiveKind| -> Vec<String> {
            let of_kind = records.iter().filter(|record| record.kind() == kind);
            of_kind.map(|record| record.subject().to_owned()).collect()
        };
        let records = position.advance(&log.0, 9);
        assert_eq!(archived(records.clone(), ArchiveKind::Mission), ["rest-1", "rest-2"]);
        assert_eq!(archived(records, ArchiveKind::Audit), ["rest-1", "rest-1", "rest-2", "rest-2"]);
        assert!(position.advance(&log.0, 9).is_empty());
        // The ledger keeps only the outcomes from now on.
        log.apply(Command::SetHistoryLimits(HistoryLimits { missions_max: 0, ..HistoryLimits::default() }));
        log.end_mission("c");
        let text = serde_json::to_string(&position).unwrap();
        let mut restarted: ArchivePosition = serde_json::from_str(&text).unwrap();
        let records = restarted.advance(&log.0, 9);
        assert_eq!(archived(records.clone(), ArchiveKind::Mission), ["rest-3"]);
        let ArchiveContent::Mission(ended) = &records[0].content else { panic!("{records:?}") };
        assert_eq!((ended.state.as_str(), &ended.details), ("canceled", &None));
    }
}
