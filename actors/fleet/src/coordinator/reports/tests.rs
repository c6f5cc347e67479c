use super::*;
use crate::coordinator::people::test_ledger::{clerk, ledger};
use consort_protocol::ids::{MissionId, RobotId};
use consort_protocol::lease::Epoch;
use std::collections::{BTreeMap, BTreeSet};

pub(super) fn report(mission: &MissionId, ended: &[u32]) -> Report {
    Report {
        robot: RobotId::new("ward").unwrap(),
        incarnation: 0,
        mission: mission.clone(),
        role: clerk(),
        epoch: Epoch::default(),
        ended: BTreeSet::from_iter(ended.iter().copied()),
        outcomes: BTreeMap::new(),
        current_task: None,
        place: None,
        from_checkpoint: false,
        failure: None,
        question: None,
    }
}

#[test]
fn nobody_reports_for_a_person() {
    for lost in [false, true] {
        let (ledger, mission) = ledger(lost);
        let reason = if lost { EndReason::Replaced } else { EndReason::Released };
        let ended = Step::Reply(ReportReply::Ended { epoch: Epoch::default(), reason, current: None });
        let mut failed = report(&mission, &[]);
        failed.failure = Some(TaskFailure::new(FailureKind::UnknownResult, "she has none"));
        for report in [report(&mission, &[0, 1]), report(&mission, &[]), failed] {
            assert_eq!(next(ledger.mission(&mission), &report), ended);
        }
    }
}

/// A role returned to give way does not count towards the limit of releases.
#[test]
fn the_ledger_learns_that_a_robot_gives_way() {
    let (ledger, mission) = ledger(false);
    let entry = ledger.mission(&mission).unwrap();
    let (role, held) = entry.role_holders().pop_first().unwrap();
    for (kind, expected) in [(FailureKind::GaveWay, true), (FailureKind::Checkpoint, false), (FailureKind::Task, false)]
    {
        let report =
            Report { robot: held.robot.clone(), role: role.clone(), epoch: held.epoch, ..report(&mission, &[]) };
        let Command::Release { gave_way, .. } = release_failed(&report, &TaskFailure::new(kind, "a cause")) else {
            panic!("no release")
        };
        assert_eq!(gave_way, expected, "{kind:?}");
    }
}
