//! Position up to which the ledger has been archived.

use super::record::{ArchiveContent, ArchiveRecord, ArchivedMission};
use consort_protocol::ids::{ClusterId, MissionId};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Ledger, Tombstone};
use serde::{Deserialize, Serialize};

/// Position in the history and in the audit trail of the ledger. A station that was down continues there; what the ledger has
/// forgotten meanwhile is in the archives of other stations.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct ArchivePosition {
    /// The ledger: another has a history and an audit trail of its own.
    cluster: Option<ClusterId>,
    /// Position in the log of the ledger.
    applied: Epoch,
    /// The mission that ended last.
    mission: Option<MissionId>,
    /// Number of the latest entry of the audit trail.
    audit: u64,
}

impl ArchivePosition {
    /// Returns the records of what the ledger contains after this position, and moves it to the end. `applied` is the position of
    /// the last entry in the ledger. After a start a replica has its latest snapshot first, which may be older than this position:
    /// then there are none.
    pub(super) fn advance(&mut self, ledger: &Ledger, applied: Epoch, now_ms: u64) -> Vec<ArchiveRecord> {
        let Some(cluster) = ledger.cluster() else { return vec![] };
        if self.cluster != Some(cluster) {
            *self = ArchivePosition { cluster: Some(cluster), ..ArchivePosition::default() };
        }
        if applied < self.applied {
            return vec![];
        }
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
        if !records.is_empty() {
            self.applied = applied;
        }
        records
    }
}

#[cfg(test)]
mod tests {
    use super::super::record::ArchiveKind;
    use super::*;
    use consort_protocol::ledger::{Command, HistoryLimits, Submission};
    use consort_protocol::mission::{Format, MissionTemplate};
    use consort_protocol::plan::divide_and_check;
    use consort_skills::domain::hospital;
    use std::collections::BTreeMap;

    const MISSION: &str = r#"{"mission": "rest", "roles": {"r1": {"kind": "managed"}},
        "root": {"task": "wait", "type": "wait", "roles": ["r1"], "parameters": {"seconds": "5"}}}"#;

    struct Log(Ledger, u64);

    impl Log {
        fn new(cluster: u64) -> Log {
            let mut log = Log(Ledger::default(), 0);
            log.apply(Command::Bootstrap { cluster: ClusterId(cluster) });
            log.apply(Command::first_wire_version(3));
            log
        }

        fn apply(&mut self, command: Command) {
            self.1 += 1;
            self.0.apply(Epoch { term: 1, index: self.1 }, command);
        }

        fn archive(&self, position: &mut ArchivePosition) -> Vec<ArchiveRecord> {
            position.advance(&self.0, Epoch { term: 1, index: self.1 }, 9)
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

    /// Returns the subjects of the records of a kind.
    fn archived(records: &[ArchiveRecord], kind: ArchiveKind) -> Vec<&str> {
        records.iter().filter(|record| record.kind() == kind).map(ArchiveRecord::subject).collect()
    }

    #[test]
    fn each_end_and_each_change_is_archived_once_in_its_order() {
        let mut log = Log::new(1);
        let mut position = ArchivePosition::default();
        log.end_mission("a");
        log.end_mission("b");
        let records = log.archive(&mut position);
        assert_eq!(archived(&records, ArchiveKind::Mission), ["rest-1", "rest-2"]);
        assert_eq!(archived(&records, ArchiveKind::Audit), ["rest-1", "rest-1", "rest-2", "rest-2"]);
        assert!(log.archive(&mut position).is_empty());
        // The ledger keeps only the outcomes from now on.
        log.apply(Command::SetHistoryLimits(HistoryLimits { missions_max: 0, ..HistoryLimits::default() }));
        log.end_mission("c");
        let text = serde_json::to_string(&position).unwrap();
        let mut restarted: ArchivePosition = serde_json::from_str(&text).unwrap();
        let records = log.archive(&mut restarted);
        assert_eq!(archived(&records, ArchiveKind::Mission), ["rest-3"]);
        let ArchiveContent::Mission(ended) = &records[0].content else { panic!("{records:?}") };
        assert_eq!((ended.state.as_str(), &ended.details), ("canceled", &None));
    }

    #[test]
    fn an_older_copy_of_the_ledger_is_not_archived_again_and_another_ledger_is_archived_as_a_whole() {
        let (mut log, mut position) = (Log::new(1), ArchivePosition::default());
        log.end_mission("a");
        let snapshot = Log(log.0.clone(), log.1);
        log.end_mission("b");
        assert_eq!(archived(&log.archive(&mut position), ArchiveKind::Mission), ["rest-1", "rest-2"]);
        // The station restarts with its snapshot, and receives the rest.
        assert!(snapshot.archive(&mut position).is_empty());
        assert!(log.archive(&mut position).is_empty());
        let mut other = Log::new(2);
        assert!(Log(Ledger::default(), 0).archive(&mut position).is_empty(), "the ledger of no cluster");
        other.end_mission("a");
        let records = other.archive(&mut position);
        assert_eq!(archived(&records, ArchiveKind::Mission), ["rest-1"]);
        assert_eq!(archived(&records, ArchiveKind::Audit), ["rest-1", "rest-1"]);
    }
}
