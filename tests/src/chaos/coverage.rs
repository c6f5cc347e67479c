//! Counts of what the limits and faults of chaos are meant to cause. An invariant says nothing about what never happens,
//! so the tests assert that each kind has happened.

use super::invariants::ReferenceLedger;
use crate::Observation;
use crate::disk::LogWrites;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId, RoleId};
use consort_protocol::ledger::{Command, MissionState};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::{self, Display};

/// Something that the limits and faults of chaos are meant to cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CoverageKind {
    /// The ledger has dropped an ended mission.
    MissionDropped,
    /// The ledger has forgotten the outcome of a mission that it dropped.
    OutcomeForgotten,
    /// The coordinator has refused the repetition of an acknowledged request, because the outcome is forgotten.
    RepetitionRefused,
    /// A node has stored a snapshot of its own state.
    SnapshotStored,
    /// A node has purged its log.
    LogPurged,
    /// A node has installed the snapshot of a leader.
    SnapshotInstalled,
    /// The coordinator has refused a new mission, because as many as allowed were active.
    MissionRefused,
    /// A node has left the fleet at the request of a person.
    NodeLeft,
    /// A node that had left has joined again, with an empty disk.
    NodeRejoined,
    /// A person has raised the wire version after the restarts of all nodes.
    FleetUpgraded,
    /// The certificate of the hostile node was revoked.
    AttackerRevoked,
    /// The certificate of a robot was revoked while the robot held a role.
    RobotRevoked,
    /// A role that such a robot held was awarded to another robot.
    RevokedRoleAwarded,
}

impl CoverageKind {
    /// All kinds.
    pub const ALL: [CoverageKind; 13] = [
        CoverageKind::MissionDropped,
        CoverageKind::OutcomeForgotten,
        CoverageKind::RepetitionRefused,
        CoverageKind::SnapshotStored,
        CoverageKind::LogPurged,
        CoverageKind::SnapshotInstalled,
        CoverageKind::MissionRefused,
        CoverageKind::NodeLeft,
        CoverageKind::NodeRejoined,
        CoverageKind::FleetUpgraded,
        CoverageKind::AttackerRevoked,
        CoverageKind::RobotRevoked,
        CoverageKind::RevokedRoleAwarded,
    ];

    fn text(self) -> &'static str {
        match self {
            CoverageKind::MissionDropped => "ended missions dropped",
            CoverageKind::OutcomeForgotten => "outcomes forgotten",
            CoverageKind::RepetitionRefused => "requests with forgotten outcomes refused",
            CoverageKind::SnapshotStored => "snapshots stored",
            CoverageKind::LogPurged => "purges of the log",
            CoverageKind::SnapshotInstalled => "snapshots installed",
            CoverageKind::MissionRefused => "refusals at the limit of missions",
            CoverageKind::NodeLeft => "nodes left",
            CoverageKind::NodeRejoined => "nodes joined again",
            CoverageKind::FleetUpgraded => "upgrades",
            CoverageKind::AttackerRevoked => "hostile nodes revoked",
            CoverageKind::RobotRevoked => "robots in a role revoked",
            CoverageKind::RevokedRoleAwarded => "their roles awarded again",
        }
    }
}

/// Counts of all kinds.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Coverage(BTreeMap<CoverageKind, usize>);

impl Coverage {
    /// Returns the count of a kind.
    pub fn count(&self, kind: CoverageKind) -> usize {
        self.0.get(&kind).copied().unwrap_or_default()
    }

    /// Adds the counts of another run.
    pub fn merge(&mut self, other: &Coverage) {
        other.0.iter().for_each(|(kind, times)| self.add(*kind, *times));
    }

    /// Returns the kinds that never happened, of those that must, as a text; empty if all happened.
    pub fn missing(&self, kinds: &[CoverageKind]) -> String {
        let missing = kinds.iter().filter(|kind| self.count(**kind) == 0);
        missing.map(|kind| kind.text()).collect::<Vec<_>>().join(", ")
    }

    fn add(&mut self, kind: CoverageKind, times: usize) {
        *self.0.entry(kind).or_default() += times;
    }
}

/// All counts in a single line.
impl Display for Coverage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let counts = CoverageKind::ALL.map(|kind| format!("{}: {}", kind.text(), self.count(kind)));
        f.write_str(&counts.join(", "))
    }
}

/// Counts what happens in a run.
#[derive(Default)]
pub(super) struct CoverageObserver {
    coverage: Coverage,
    /// Index of the last entry of the log that was seen.
    index: u64,
    /// Shows which ended missions are dropped or forgotten.
    reference: ReferenceLedger,
    /// Outcomes of all missions that have ended.
    ended: BTreeMap<MissionId, MissionState>,
    /// Wire version of the fleet.
    wire: Option<u8>,
    /// Nodes that have left and have not joined again.
    left: BTreeSet<NodeId>,
    /// Roles of revoked robots that no other robot has received.
    revoked_roles: BTreeMap<(MissionId, RoleId), NodeId>,
}

impl CoverageObserver {
    pub(super) fn observe(&mut self, entry: &Observation) {
        match entry {
            Observation::TestAction { node, action: "left" } => {
                self.coverage.add(CoverageKind::NodeLeft, 1);
                self.left.insert(node.clone());
            }
            Observation::TestAction { node, action: "starts again" } => {
                self.coverage.add(CoverageKind::NodeRejoined, usize::from(self.left.remove(node)));
            }
            Observation::CertificateRevoked { node, role } => self.revoked(node, role.clone()),
            Observation::EntryApplied { at, commands, .. } if at.index > self.index => {
                self.index = at.index;
                commands.iter().for_each(|command| self.command(command));
                self.reference.apply(*at, commands);
                self.keep_outcomes();
            }
            Observation::Published(event) => {
                if let EventKind::Awarded { mission, holders, .. } = &event.kind {
                    for (role, robot) in holders {
                        self.awarded((mission.clone(), role.clone()), &robot.clone().into());
                    }
                }
            }
            _ => {}
        }
    }

    /// Keeps the outcomes of the missions that have just ended: the ledger may forget them.
    fn keep_outcomes(&mut self) {
        for (mission, tombstone) in self.reference.ledger.latest_ended() {
            if self.ended.contains_key(mission) {
                return;
            }
            self.ended.insert(mission.clone(), tombstone.state.clone());
        }
    }

    /// Returns the outcome of a mission that the ledger has forgotten.
    pub(super) fn forgotten_outcome(&self, mission: &MissionId) -> Option<&MissionState> {
        self.ended.get(mission).filter(|_| self.reference.ledger.mission_state(mission).is_none())
    }

    fn revoked(&mut self, node: &NodeId, role: Option<(MissionId, RoleId)>) {
        let kind = if role.is_some() { CoverageKind::RobotRevoked } else { CoverageKind::AttackerRevoked };
        self.coverage.add(kind, 1);
        self.revoked_roles.extend(role.map(|role| (role, node.clone())));
    }

    fn awarded(&mut self, role: (MissionId, RoleId), node: &NodeId) {
        if self.revoked_roles.get(&role).is_some_and(|revoked| revoked != node) {
            self.revoked_roles.remove(&role);
            self.coverage.add(CoverageKind::RevokedRoleAwarded, 1);
        }
    }

    fn command(&mut self, command: &Command) {
        if let Command::RaiseWireVersion { wire, .. } = command {
            // The first version is that of a new ledger.
            let is_raised = self.wire.is_some_and(|known| known < *wire);
            self.coverage.add(CoverageKind::FleetUpgraded, usize::from(is_raised));
            self.wire = self.wire.max(Some(*wire));
        }
    }

    /// Returns all counts at the end of a run, with those of the disks, and of the refusals that clients got at the limit of
    /// missions and for forgotten requests.
    pub(super) fn end(self, writes: LogWrites, refusals: usize, forgotten_refused: usize) -> Coverage {
        let is_dropped = |mission: &&MissionId| self.reference.ledger.mission(mission).is_none();
        let dropped = self.ended.keys().filter(is_dropped).count();
        let forgotten = self.ended.keys().filter(|mission| self.forgotten_outcome(mission).is_some()).count();
        let mut coverage = self.coverage;
        coverage.add(CoverageKind::MissionDropped, dropped);
        coverage.add(CoverageKind::OutcomeForgotten, forgotten);
        coverage.add(CoverageKind::RepetitionRefused, forgotten_refused);
        coverage.add(CoverageKind::SnapshotStored, writes.snapshots);
        coverage.add(CoverageKind::LogPurged, writes.purges);
        coverage.add(CoverageKind::SnapshotInstalled, writes.installations);
        coverage.add(CoverageKind::MissionRefused, refusals);
        coverage
    }
}

#[cfg(test)]
mod tests {
    use super::super::invariants::test_missions::{cancel, submit_rest};
    use super::*;
    use crate::slug;
    use consort_protocol::lease::Epoch;
    use consort_protocol::ledger::HistoryLimits;

    fn test_action(node: &str, action: &'static str) -> Observation {
        Observation::TestAction { node: slug(node), action }
    }

    fn raised(index: u64, wire: u8) -> Observation {
        let commands = [Command::RaiseWireVersion { wire, by: String::new(), at_ms: 0 }].into();
        Observation::EntryApplied { node: slug("aster"), at: Epoch { term: 1, index }, digest: None, commands }
    }

    #[test]
    fn nodes_that_leave_and_join_again_are_counted() {
        let mut observer = CoverageObserver::default();
        for (node, action) in [("garnet", "killed"), ("garnet", "starts again"), ("hazel", "left")] {
            observer.observe(&test_action(node, action));
        }
        let kinds = [CoverageKind::NodeLeft, CoverageKind::NodeRejoined];
        assert_eq!(observer.coverage.missing(&kinds), "nodes joined again");
        observer.observe(&test_action("hazel", "starts again"));
        assert_eq!(kinds.map(|kind| observer.coverage.count(kind)), [1, 1]);
    }

    #[test]
    fn the_first_wire_version_and_entries_of_other_replicas_are_no_upgrade() {
        let mut observer = CoverageObserver::default();
        [raised(1, 6), raised(1, 6), raised(2, 7), raised(2, 7)].iter().for_each(|entry| observer.observe(entry));
        assert_eq!(observer.coverage.count(CoverageKind::FleetUpgraded), 1);
    }

    #[test]
    fn a_role_of_a_revoked_robot_counts_once_another_has_it() {
        let mut observer = CoverageObserver::default();
        let role = || (slug::<MissionId>("rest-1"), slug::<RoleId>("r1"));
        observer.observe(&Observation::CertificateRevoked { node: slug("mallory"), role: None });
        observer.observe(&Observation::CertificateRevoked { node: slug("garnet"), role: Some(role()) });
        observer.awarded(role(), &slug("garnet"));
        assert_eq!(observer.coverage.count(CoverageKind::RevokedRoleAwarded), 0);
        observer.awarded(role(), &slug("hazel"));
        observer.awarded(role(), &slug("indigo"));
        let kinds = [CoverageKind::AttackerRevoked, CoverageKind::RobotRevoked, CoverageKind::RevokedRoleAwarded];
        assert_eq!(kinds.map(|kind| observer.coverage.count(kind)), [1, 1, 1]);
    }

    #[test]
    fn dropped_missions_and_forgotten_outcomes_are_counted_at_the_end() {
        let mut observer = CoverageObserver::default();
        // The outcome of a rest that Nia canceled takes 55 bytes.
        let limits = HistoryLimits { missions_max: 1, outcome_bytes_max: 120, ..HistoryLimits::default() };
        let mut commands = vec![Command::first_wire_version(3), Command::SetHistoryLimits(limits)];
        for (request, mission) in [("a", "rest-1"), ("b", "rest-2"), ("c", "rest-3")] {
            commands.extend([submit_rest(request), cancel("Nia", &[mission])]);
        }
        for (index, command) in (1..).zip(commands) {
            let (node, at, commands) = (slug("aster"), Epoch { term: 1, index }, [command].into());
            observer.observe(&Observation::EntryApplied { node, at, digest: None, commands });
        }
        assert!(observer.forgotten_outcome(&slug("rest-1")).is_some_and(MissionState::is_final));
        assert_eq!(observer.forgotten_outcome(&slug("rest-2")), None, "it is dropped and remembered");
        let coverage = observer.end(LogWrites::default(), 0, 4);
        let kinds = [CoverageKind::MissionDropped, CoverageKind::OutcomeForgotten, CoverageKind::RepetitionRefused];
        assert_eq!(kinds.map(|kind| coverage.count(kind)), [2, 1, 4]);
    }

    #[test]
    fn counts_of_runs_are_added() {
        let (mut all, mut run) = (Coverage::default(), Coverage::default());
        run.add(CoverageKind::LogPurged, 2);
        all.merge(&run);
        all.merge(&run);
        assert_eq!(all.count(CoverageKind::LogPurged), 4);
        assert_eq!(all.missing(&[CoverageKind::LogPurged]), "");
        assert!(all.to_string().contains("snapshots stored: 0, purges of the log: 4"), "{all}");
    }
}
