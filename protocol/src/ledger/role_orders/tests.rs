use super::super::branch::Branch;
use super::super::command::{Command, CommandOutcome, PromiseMove};
use super::super::mission_order::MissionChange;
use super::super::robot_order::{OrderChange, OrderRequest};
use super::super::submission::Submission;
use super::*;
use crate::auction::{AuctionId, AuctionRecord};
use crate::lease::Epoch;
use crate::ledger::history::HISTORY_SINCE;
use crate::ledger::{AuditEntry, MissionState};
use crate::mission::test_data::{FETCH_PARCEL, domain};
use crate::mission::{Format, MissionTemplate};
use crate::plan::{StepIndex, divide_and_check};
use crate::units::Seconds;

/// Two robots without items: `b` waits for `a`, which has a task left afterwards.
const RELAY: &str = r#"{"mission": "relay", "roles": {"a": {"kind": "managed"}, "b": {"kind": "managed"}},
  "root": {"task": "all", "method": "sequential", "tasks": [
    {"task": "t-a", "type": "wait", "roles": ["a"], "parameters": {"seconds": "1"}},
    {"task": "rest", "method": "unordered", "tasks": [
      {"task": "t-b", "type": "wait", "roles": ["b"], "parameters": {"seconds": "1"}},
      {"task": "t-a2", "type": "wait", "roles": ["a"], "parameters": {"seconds": "1"}}]}]}}"#;

fn role(name: &str) -> RoleId {
    name.parse().unwrap()
}

fn robot(name: &str) -> RobotId {
    name.parse().unwrap()
}

/// A ledger with a mission, and the index of its next entry.
struct Log(Ledger, u64, MissionId);

impl Log {
    fn of(text: &str, format: Format) -> Log {
        let mut log = Log(Ledger::default(), 1, "none".parse().unwrap());
        log.apply(Command::first_wire_version(HISTORY_SINCE));
        let template = MissionTemplate::parse(text, format).unwrap();
        let (mission, _) = template.instantiate_with_recovery(&BTreeMap::new(), &domain()).unwrap();
        let division = divide_and_check(&mission).unwrap();
        let submission = Submission::of("a".parse().unwrap(), mission, division);
        match log.apply(Command::Submit(Box::new(submission))) {
            CommandOutcome::Submitted { mission, .. } => log.2 = mission,
            other => panic!("{other:?}"),
        }
        log
    }

    fn fetch_parcel() -> Log {
        Log::of(FETCH_PARCEL, Format::Yaml)
    }

    /// The mission `fetch-parcel`, held by amber and arm.
    fn held_by_two() -> (Log, Epoch) {
        let mut log = Log::fetch_parcel();
        let epoch = log.hold(&[("r1", "amber"), ("lab_arm", "arm")]);
        (log, epoch)
    }

    fn apply(&mut self, command: Command) -> CommandOutcome {
        let at = Epoch { term: 1, index: self.1 };
        self.1 += 1;
        self.0.apply(at, command)
    }

    fn entry(&self) -> &MissionEntry {
        self.0.mission(&self.2).unwrap()
    }

    fn award(&mut self, holders: &[(&str, &str)], promised: &[&str]) -> CommandOutcome {
        let record = AuctionRecord::empty(AuctionId { mission: self.2.clone(), term: 1, round: 1 });
        let promised = promised.iter().map(|id| (role(id), Seconds::ZERO)).collect();
        let holders = holders.iter().map(|(id, name)| (role(id), robot(name))).collect();
        let (mission, auction) = (self.2.clone(), AuctionRecord { promised, ..record });
        self.apply(Command::Award { mission, branch: Branch::Main, holders, auction })
    }

    /// Awards and confirms roles.
    fn hold(&mut self, holders: &[(&str, &str)]) -> Epoch {
        let epoch = match self.award(holders, &[]) {
            CommandOutcome::Awarded { epoch } => epoch,
            other => panic!("{other:?}"),
        };
        for (name, _) in holders {
            let (mission, role) = (self.2.clone(), role(name));
            self.apply(Command::Accept { mission, role, epoch, incarnation: 1, from_checkpoint: false });
        }
        epoch
    }

    fn ended(&mut self, name: &str, epoch: Epoch, steps: std::ops::Range<StepIndex>) {
        let (mission, role, branch, outcomes) = (self.2.clone(), role(name), Branch::Main, BTreeMap::new());
        self.apply(Command::Progress { mission, role, epoch, branch, ended: steps.collect(), outcomes });
    }

    /// The robot returns a role, or is lost.
    fn release(&mut self, name: &str, epoch: Epoch, gave_way: bool) {
        let (mission, role, cause) = (self.2.clone(), role(name), "test".to_owned());
        let release =
            Command::Release { mission, role, epoch, cause, class: None, moved_nothing: true, place: None, gave_way };
        assert_eq!(self.apply(release), CommandOutcome::Done);
    }

    fn change(&mut self, change: MissionChange, request: Option<&str>) -> CommandOutcome {
        let request = request.map(|request| request.parse().unwrap());
        let order = OrderRequest { change, by: "Nia".to_owned(), at_ms: 9, request };
        self.apply(Command::ChangeMission { mission: self.2.clone(), order })
    }

    fn reassign(&mut self, name: &str, to: Option<&str>, repeat: bool) -> CommandOutcome {
        let to = to.map(robot);
        self.change(MissionChange::Reassign { role: role(name), to, repeat }, None)
    }

    fn pin(&mut self, name: &str, to: Option<&str>) -> CommandOutcome {
        self.change(MissionChange::Pin { role: role(name), robot: to.map(robot) }, None)
    }

    /// Returns the reason for which a request was rejected.
    fn rejection(outcome: CommandOutcome) -> String {
        match outcome {
            CommandOutcome::Refused(problem) => problem.to_string(),
            other => panic!("{other:?}"),
        }
    }

    /// Returns the orders about roles as text.
    fn orders(&self) -> Vec<String> {
        self.entry().role_orders().iter().map(|(role, order)| format!("{role} is {order}")).collect()
    }

    fn returned(&self) -> Vec<&RoleId> {
        self.entry().roles_to_return().map(|(id, ..)| id).collect()
    }

    fn phase(&self, name: &str) -> RolePhase {
        self.entry().roles[&role(name)].phase
    }
}

fn is_awarded(outcome: &CommandOutcome) -> bool {
    matches!(outcome, CommandOutcome::Awarded { .. })
}

#[test]
fn a_reassigned_role_goes_to_another_robot_once_it_is_returned() {
    let (mut log, epoch) = Log::held_by_two();
    assert_eq!(log.reassign("r1", None, false), CommandOutcome::Done);
    assert_eq!((log.returned(), log.phase("r1")), (vec![&role("r1")], RolePhase::Active), "it stays with its robot");
    assert_eq!(log.orders(), ["r1 is reassigned from amber; its robot returns it"]);
    log.release("r1", epoch, true);
    assert_eq!((log.returned(), log.phase("r1")), (vec![], RolePhase::Open));
    let former = Log::rejection(log.award(&[("r1", "amber")], &[]));
    assert_eq!(former, format!("amber may not get r1 of {}, which is reassigned from amber", log.2));
    assert!(is_awarded(&log.award(&[("r1", "birch")], &[])));
    assert_eq!(log.orders(), [""; 0], "the order holds for a single award");
}

#[test]
fn a_role_that_is_reassigned_to_a_robot_goes_to_no_other() {
    let (mut log, epoch) = Log::held_by_two();
    assert_eq!(log.reassign("r1", Some("birch"), false), CommandOutcome::Done);
    log.release("r1", epoch, false);
    assert_eq!(log.orders(), ["r1 is reassigned to birch"], "its robot was lost before it returned the role");
    assert!(!is_awarded(&log.award(&[("r1", "fern")], &[])));
    assert!(is_awarded(&log.award(&[("r1", "birch")], &[])));
    assert_eq!(log.orders(), [""; 0]);
}

#[test]
fn a_role_stays_with_its_robot_if_another_cannot_do_it_from_its_start() {
    let (mut log, epoch) = Log::held_by_two();
    log.ended("r1", epoch, 0..1);
    let repeated = Log::rejection(log.reassign("r1", None, false));
    assert!(repeated.contains("has ended tasks, which another robot would repeat: "), "{repeated}");
    log.ended("r1", epoch, 0..4);
    let custody = format!("r1 of {} cannot leave amber, which has, or may have, the parcel", log.2);
    assert_eq!(Log::rejection(log.reassign("r1", None, true)), custody);
    assert_eq!(log.orders(), [""; 0]);

    let mut log = Log::of(RELAY, Format::Json);
    let epoch = log.hold(&[("a", "amber"), ("b", "birch")]);
    log.ended("a", epoch, 0..2);
    log.ended("b", epoch, 0..1);
    let acted = format!("a of {} cannot start again, because other roles have acted on its work", log.2);
    assert_eq!(Log::rejection(log.reassign("a", None, true)), acted);
}

#[test]
fn ended_tasks_are_repeated_with_the_permission_of_the_person() {
    let (mut log, epoch) = Log::held_by_two();
    log.ended("r1", epoch, 0..1);
    assert_eq!(log.reassign("r1", None, true), CommandOutcome::Done);
    log.ended("r1", epoch, 0..2);
    assert_eq!(log.returned(), [&role("r1")]);
    log.release("r1", epoch, true);
    assert!(log.entry().roles[&role("r1")].ended.is_empty());
}

#[test]
fn a_reassignment_ends_if_a_task_ends_before_the_return() {
    let (mut log, epoch) = Log::held_by_two();
    log.reassign("r1", Some("birch"), false);
    log.ended("r1", epoch, 0..1);
    assert_eq!((log.returned(), log.orders()), (vec![], vec![]));
    // With the permission to repeat tasks it ends once the robot may have the item.
    log.reassign("r1", Some("birch"), true);
    assert_eq!(log.returned(), [&role("r1")]);
    log.ended("r1", epoch, 0..4);
    assert_eq!((log.returned(), log.orders()), (vec![], vec![]));
}

#[test]
fn a_wrong_reassignment_is_rejected_with_the_reason() {
    let mut log = Log::fetch_parcel();
    let of = format!("of {}", log.2);
    let rejected = |log: &mut Log, name: &str, to: Option<&str>| Log::rejection(log.reassign(name, to, false));
    assert_eq!(rejected(&mut log, "r9", None), format!("mission {} has no role r9", log.2));
    assert_eq!(rejected(&mut log, "clerk", None), format!("clerk {of} is a role of people"));
    assert_eq!(rejected(&mut log, "r1", None), format!("r1 {of} has no robot; name the robot that should get it"));
    log.hold(&[("r1", "amber"), ("lab_arm", "arm")]);
    assert_eq!(rejected(&mut log, "r1", Some("amber")), format!("r1 {of} belongs to amber already"));
    let two = format!("arm would hold two roles: it already holds lab_arm {of}");
    assert_eq!(rejected(&mut log, "r1", Some("arm")), two);
    let held = Log::rejection(log.pin("r1", Some("birch")));
    assert_eq!(held, format!("r1 {of} is held by amber; reassign it instead"));
    let hold = OrderChange::Hold { until_ms: 60_000, reason: "a spill".to_owned() };
    let order = OrderRequest { change: hold, by: "Abe".to_owned(), at_ms: 9, request: None };
    log.apply(Command::OrderRobots { robots: [robot("birch")].into(), order });
    assert_eq!(rejected(&mut log, "r1", Some("birch")), "birch is held by Abe: a spill");
    let (mission, by) = (log.2.clone(), "Abe".to_owned());
    log.apply(Command::Cancel { mission, by, places: BTreeMap::new(), at_ms: 9 });
    assert!(matches!(log.entry().state, MissionState::Canceled { .. }));
    assert_eq!(rejected(&mut log, "r1", None), format!("mission {} is canceled", log.2));
}

#[test]
fn a_pinned_role_goes_to_no_other_robot_until_it_is_unpinned() {
    let mut log = Log::fetch_parcel();
    assert_eq!(log.pin("r1", Some("birch")), CommandOutcome::Done);
    assert!(!is_awarded(&log.award(&[("r1", "amber"), ("lab_arm", "arm")], &[])));
    let epoch = log.hold(&[("r1", "birch"), ("lab_arm", "arm")]);
    log.release("r1", epoch, false);
    assert_eq!(log.orders(), ["r1 is pinned to birch"]);
    assert!(!is_awarded(&log.award(&[("r1", "amber")], &[])));
    assert_eq!(log.pin("r1", None), CommandOutcome::Done);
    assert!(is_awarded(&log.award(&[("r1", "amber")], &[])));
}

#[test]
fn a_promised_role_is_reassigned_at_once() {
    let mut log = Log::fetch_parcel();
    assert!(is_awarded(&log.award(&[("r1", "amber"), ("lab_arm", "arm")], &["lab_arm"])));
    assert_eq!(log.phase("lab_arm"), RolePhase::Promised);
    assert_eq!(log.reassign("lab_arm", None, false), CommandOutcome::Done);
    assert_eq!((log.phase("lab_arm"), log.returned()), (RolePhase::Open, vec![]));
    assert!(!is_awarded(&log.award(&[("lab_arm", "arm")], &["lab_arm"])));
    assert!(is_awarded(&log.award(&[("lab_arm", "other")], &["lab_arm"])));
    assert_eq!(log.orders(), ["lab_arm is reassigned from arm"], "the promise may move");
    assert_eq!(log.pin("lab_arm", Some("arm")), CommandOutcome::Done);
    assert_eq!((log.phase("lab_arm"), log.orders()), (RolePhase::Open, vec!["lab_arm is pinned to arm".to_owned()]));
}

#[test]
fn orders_about_roles_are_recorded_and_copies_change_nothing() {
    let (mut log, epoch) = Log::held_by_two();
    let reassign = || MissionChange::Reassign { role: role("r1"), to: Some(robot("birch")), repeat: false };
    log.change(reassign(), Some("order-7"));
    log.release("r1", epoch, true);
    log.hold(&[("r1", "birch")]);
    assert_eq!(log.change(reassign(), Some("order-7")), CommandOutcome::Done);
    assert_eq!(log.orders(), [""; 0]);
    log.pin("r1", Some("birch"));
    log.pin("r1", None);
    log.pin("r1", None);
    let line = |entry: &AuditEntry| format!("{} {} {}", entry.by, entry.action, entry.details);
    let trail: Vec<String> = log.0.audit_trail().map(line).filter(|line| !line.contains("submit")).collect();
    assert_eq!(trail, ["Nia reassign r1 to birch", "Nia pin r1 to birch", "Nia unpin r1"]);
}

#[test]
fn the_promise_of_a_reassigned_role_moves_to_no_other_robot() {
    let mut log = Log::fetch_parcel();
    assert_eq!(log.reassign("lab_arm", Some("arm"), false), CommandOutcome::Done);
    let epoch = match log.award(&[("r1", "amber"), ("lab_arm", "arm")], &["lab_arm"]) {
        CommandOutcome::Awarded { epoch } => epoch,
        other => panic!("{other:?}"),
    };
    let (mission, role) = (log.2.clone(), role("lab_arm"));
    let (robot, cause) = (robot("other"), "it costs less".to_owned());
    let auction = AuctionRecord::empty(AuctionId { mission: mission.clone(), term: 1, round: 2 });
    let change = PromiseMove { mission: mission.clone(), role: role.clone(), epoch, robot, cause, auction };
    let moved = Log::rejection(log.apply(Command::MovePromise(Box::new(change))));
    assert_eq!(moved, format!("other may not get lab_arm of {mission}, which is reassigned to arm"));
    assert_eq!(log.orders(), ["lab_arm is reassigned to arm"]);
    assert!(is_awarded(&log.apply(Command::AwardPromised { mission, role, epoch })));
    assert_eq!(log.orders(), [""; 0]);
}
