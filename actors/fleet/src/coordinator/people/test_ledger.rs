//! A ledger with a mission in which a clerk takes part.

use consort_protocol::auction::{AuctionId, AuctionRecord};
use consort_protocol::ids::{MissionId, RequestId, RobotId, RoleId};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{
    Branch, Command, CommandOutcome, Ledger, PersonQuestion, RecoveryBranch, Submission, TaskQuestion,
};
use consort_protocol::mission::{Escalation, Format, MissionTemplate};
use consort_protocol::plan::divide_and_check;
use consort_skills::domain::hospital;
use std::collections::BTreeMap;

/// The clerk has a plan in both branches: she inserts a parcel, and another parcel if the first is
/// lost. The first request is escalated to the head after 30 s.
const MISSION: &str = r#"{"mission": "fetch", "roles": {
    "clerk": {"kind": "unmanaged"}, "r1": {"kind": "managed"}, "r2": {"kind": "managed"}},
  "root": {"task": "fetch", "method": "sequential", "tasks": [
    {"task": "open", "type": "wait", "roles": ["r1"], "parameters": {"seconds": "1"}},
    {"task": "deposit", "type": "deposit", "roles": ["clerk"], "parameters": {"into_role": "r1"}, "acquires": {"parcel": "r1"},
     "escalate": {"to": "head", "after_s": 30}},
    {"task": "close", "type": "wait", "roles": ["r1"], "parameters": {"seconds": "1"}}]},
  "recovery": {"task": "again", "method": "sequential", "tasks": [
    {"task": "open-2", "type": "wait", "roles": ["r2"], "parameters": {"seconds": "1"}},
    {"task": "deposit-2", "type": "deposit", "roles": ["clerk"], "parameters": {"into_role": "r2"}},
    {"task": "close-2", "type": "wait", "roles": ["r2"], "parameters": {"seconds": "1"}}]}}"#;

pub(in crate::coordinator) fn clerk() -> RoleId {
    RoleId::new("clerk").unwrap()
}

/// Ledger with the mission in progress; `lost` means that the parcel is lost in the box of `r1`.
pub(in crate::coordinator) fn ledger(lost: bool) -> (Ledger, MissionId) {
    let template = MissionTemplate::parse(MISSION, Format::Json).unwrap();
    let (mission, recovery) = template.instantiate_with_recovery(&BTreeMap::new(), &hospital()).unwrap();
    let division = divide_and_check(&mission).unwrap();
    let recovery = recovery.map(|mission| RecoveryBranch { division: divide_and_check(&mission).unwrap(), mission });
    let mut ledger = Ledger::default();
    let submission = Submission { recovery, ..Submission::of(RequestId::new("a").unwrap(), mission, division) };
    let at = |index| Epoch { term: 1, index };
    ledger.apply(at(1), Command::Submit(Box::new(submission)));
    let mission = ledger.missions().next().unwrap().id.clone();
    award(&mut ledger, &mission, 2);
    if lost {
        put_parcel_in(&mut ledger, &mission, 2);
        let r1 = RoleId::new("r1").unwrap();
        let (cause, place) = ("silent".to_owned(), None);
        let release = Command::Release {
            mission: mission.clone(),
            role: r1,
            epoch: at(2),
            cause,
            class: None,
            moved_nothing: false,
            place,
            gave_way: false,
        };
        assert_eq!(ledger.apply(at(4), release), CommandOutcome::Done);
        assert_eq!(ledger.mission(&mission).unwrap().branch, Branch::Recovery);
    }
    (ledger, mission)
}

/// Awards `r1` to amber with the entry of the log at `index`.
pub(super) fn award(ledger: &mut Ledger, mission: &MissionId, index: u64) {
    let auction = AuctionRecord::empty(AuctionId { mission: mission.clone(), term: 1, round: 1 });
    let holders = BTreeMap::from([(RoleId::new("r1").unwrap(), RobotId::new("amber").unwrap())]);
    let (epoch, branch) = (Epoch { term: 1, index }, Branch::Main);
    let awarded = ledger.apply(epoch, Command::Award { mission: mission.clone(), branch, holders, auction });
    assert_eq!(awarded, CommandOutcome::Awarded { epoch });
}

/// Records that `r1`, which was awarded at `index`, is confirmed and has the parcel.
pub(super) fn put_parcel_in(ledger: &mut Ledger, mission: &MissionId, index: u64) {
    let (epoch, next) = (Epoch { term: 1, index }, Epoch { term: 1, index: index + 1 });
    let (mission, role, outcomes) = (mission.clone(), RoleId::new("r1").unwrap(), BTreeMap::new());
    let accept =
        Command::Accept { mission: mission.clone(), role: role.clone(), epoch, incarnation: 1, from_checkpoint: false };
    assert_eq!(ledger.apply(next, accept), CommandOutcome::Done);
    let ended = [0, 1, 2].into();
    let progress = Command::Progress { mission, role, epoch, branch: Branch::Main, ended, outcomes };
    assert_eq!(ledger.apply(next, progress), CommandOutcome::Done);
}

/// Command by which `r1` asks the clerk in its first task, or no longer asks. The question is
/// escalated to the head after 30 s and expires after 60 s.
pub(super) fn asking(ledger: &Ledger, is_open: bool, asked_ms: u64) -> Command {
    let entry = ledger.missions().next().unwrap();
    let (role, holder) = entry.role_holders().pop_first().expect("a holder");
    let escalation = Some(Box::new(Escalation { to: RoleId::new("head").unwrap(), after_s: 30 }));
    let (to, message) = (clerk(), "may I enter?".to_owned());
    let question = PersonQuestion { to, message, at: None, patience_s: Some(60), escalation };
    let question = TaskQuestion { task: "open".parse().unwrap(), number: 1, question, is_open };
    Command::SetQuestion { mission: entry.id.clone(), role, epoch: holder.epoch, question, asked_ms }
}
