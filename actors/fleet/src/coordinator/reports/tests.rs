use super::*;
use consort_protocol::auction::{AuctionId, AuctionRecord};
use consort_protocol::ids::{MissionId, RequestId, RoleId};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{RecoveryBranch, Submission};
use consort_protocol::message::TaskFailure;
use consort_protocol::mission::{Format, MissionTemplate};
use consort_protocol::plan::divide_and_check;
use consort_skills::domain::hospital;
use std::collections::BTreeSet;

/// The nurse has a plan in both branches: she inserts a sample, and another sample if the first is
/// lost.
const MISSION: &str = r#"{"mission": "fetch", "roles": {
    "nurse": {"kind": "unmanaged"}, "r1": {"kind": "managed"}, "r2": {"kind": "managed"}},
  "root": {"task": "fetch", "method": "sequential", "tasks": [
    {"task": "open", "type": "operate_drawer", "roles": ["r1"], "parameters": {"action": "open"}},
    {"task": "deposit", "type": "deposit", "roles": ["nurse"], "parameters": {"into_role": "r1"}, "acquires": {"sample": "r1"}},
    {"task": "close", "type": "operate_drawer", "roles": ["r1"], "parameters": {"action": "close"}}]},
  "recovery": {"task": "again", "method": "sequential", "tasks": [
    {"task": "open-2", "type": "operate_drawer", "roles": ["r2"], "parameters": {"action": "open"}},
    {"task": "deposit-2", "type": "deposit", "roles": ["nurse"], "parameters": {"into_role": "r2"}},
    {"task": "close-2", "type": "operate_drawer", "roles": ["r2"], "parameters": {"action": "close"}}]}}"#;

fn nurse() -> RoleId {
    RoleId::new("nurse").unwrap()
}

/// Ledger with the mission in progress; `lost` means that the sample is lost in the drawer of `r1`.
fn ledger(lost: bool) -> (Ledger, MissionId) {
    let template = MissionTemplate::parse(MISSION, Format::Json).unwrap();
    let (mission, recovery) = template.instantiate_with_recovery(&BTreeMap::new(), &hospital()).unwrap();
    let division = divide_and_check(&mission).unwrap();
    let recovery = recovery.map(|mission| RecoveryBranch { division: divide_and_check(&mission).unwrap(), mission });
    let mut ledger = Ledger::default();
    let submission = Submission { recovery, ..Submission::of(RequestId::new("a").unwrap(), mission, division) };
    let at = |index| Epoch { term: 1, index };
    ledger.apply(at(1), Command::Submit(Box::new(submission)));
    let mission = ledger.missions().next().unwrap().id.clone();
    let auction = AuctionId { mission: mission.clone(), term: 1, round: 1 };
    let auction =
        AuctionRecord { auction, at_ms: 0, entries: vec![], omitted: 0, chosen: BTreeMap::new(), failure: None };
    let (r1, amber) = (RoleId::new("r1").unwrap(), RobotId::new("amber").unwrap());
    let holders = BTreeMap::from([(r1.clone(), amber)]);
    assert_eq!(
        ledger.apply(at(2), Command::Award { mission: mission.clone(), branch: Branch::Main, holders, auction }),
        CommandOutcome::Awarded { epoch: at(2) }
    );
    if lost {
        let (incarnation, resumes) = (1, false);
        let accept = Command::Accept {
            mission: mission.clone(),
            role: r1.clone(),
            epoch: at(2),
            incarnation,
            from_checkpoint: resumes,
        };
        assert_eq!(ledger.apply(at(3), accept), CommandOutcome::Done);
        let progress_of = |role, epoch, ended: &[u32]| Command::Progress {
            mission: mission.clone(),
            role,
            epoch,
            branch: Branch::Main,
            ended: ended.iter().copied().collect(),
            outcomes: BTreeMap::new(),
        };
        assert_eq!(ledger.apply(at(3), progress_of(r1.clone(), at(2), &[0, 1, 2])), CommandOutcome::Done);
        let (cause, place) = ("silent".to_owned(), None);
        let release =
            Command::Release { mission: mission.clone(), role: r1, epoch: at(2), cause, robot_failed: false, place };
        assert_eq!(ledger.apply(at(4), release), CommandOutcome::Done);
        assert_eq!(ledger.mission(&mission).unwrap().branch, Branch::Recovery);
    }
    (ledger, mission)
}

fn report(mission: &MissionId, branch: Branch, ended: &[u32]) -> Report {
    Report {
        robot: RobotId::new("ward").unwrap(),
        incarnation: 0,
        mission: mission.clone(),
        role: nurse(),
        epoch: Epoch::default(),
        branch,
        ended: BTreeSet::from_iter(ended.iter().copied()),
        outcomes: BTreeMap::new(),
        current_task: None,
        place: None,
        from_checkpoint: false,
        failure: None,
    }
}

fn next_step(ledger: &Ledger, report: &Report) -> Step {
    next(ledger.mission(&report.mission), report, BTreeMap::new)
}

fn replaced() -> Step {
    let (epoch, reason) = (Epoch::default(), EndReason::Replaced);
    Step::Reply(ReportReply::Ended { epoch, reason, current: None })
}

#[test]
fn progress_of_a_person_is_recorded_with_its_branch() {
    for (lost, branch) in [(false, Branch::Main), (true, Branch::Recovery)] {
        let (ledger, mission) = ledger(lost);
        let (role, epoch, ended) = (nurse(), Epoch::default(), BTreeSet::from([0, 1]));
        let outcomes = BTreeMap::new();
        let progress = Command::Progress { mission: mission.clone(), role, epoch, branch, ended, outcomes };
        assert_eq!(next_step(&ledger, &report(&mission, branch, &[0, 1])), Step::Commit(progress));
    }
}

#[test]
fn a_late_report_of_the_other_branch_changes_nothing() {
    let (ledger, mission) = ledger(true);
    assert_eq!(next_step(&ledger, &report(&mission, Branch::Main, &[0, 1, 2])), replaced());
    assert_eq!(
        next_step(&ledger, &report(&mission, Branch::Main, &[])),
        replaced(),
        "the reply contains no ended steps"
    );
    let mut failed = report(&mission, Branch::Main, &[]);
    let (cause, kind) = ("she has none".to_owned(), FailureKind::Task);
    failed.failure = Some(TaskFailure { task: None, cause, kind });
    assert_eq!(next_step(&ledger, &failed), replaced());
}

#[test]
fn a_failure_ends_the_mission_only_in_the_reported_branch() {
    let (ledger, mission) = ledger(false);
    let mut failed = report(&mission, Branch::Main, &[]);
    let (cause, kind) = ("she has none".to_owned(), FailureKind::Task);
    failed.failure = Some(TaskFailure { task: None, cause, kind });
    let cause = "ward as nurse could not go on: she has none".to_owned();
    let fail = Command::Fail { mission, cause, branch: Some(Branch::Main), places: BTreeMap::new() };
    assert_eq!(next_step(&ledger, &failed), Step::Commit(fail));
}

#[test]
fn a_coordinator_behind_the_recovery_branch_replies_not_coordinator() {
    let (ledger, mission) = ledger(false);
    let behind = Step::Reply(ReportReply::NotCoordinator { coordinator: None });
    assert_eq!(next_step(&ledger, &report(&mission, Branch::Recovery, &[0])), behind);
}
