use super::super::branch::Branch;
use super::super::command::Command;
use super::super::mission_order::MissionChange;
use super::super::robot_order::OrderRequest;
use super::super::submission::{Priority, Submission};
use super::*;
use crate::auction::{AuctionEntry, AuctionId, AuctionRecord, BidPart, BidVerdict, ChargingStop, RoleSpan};
use crate::mission::test_data::domain;
use crate::mission::{Format, MissionTemplate};
use crate::plan::divide_and_check;
use crate::units::{BatteryShare, Energy, EnergyLimit};
use proptest::prelude::*;

/// The cart brings something, and the arm takes it.
const MISSION: &str = r#"
mission: bring
roles: { arm: { kind: managed }, cart: { kind: managed } }
root:
  task: all
  method: sequential
  tasks:
    - { task: go, type: wait, roles: [cart], parameters: { seconds: "5" } }
    - { task: take, type: wait, roles: [arm], parameters: { seconds: "5" } }
"#;

fn role(name: &str) -> RoleId {
    name.parse().unwrap()
}

fn robot(name: &str) -> RobotId {
    name.parse().unwrap()
}

/// A ledger, the index of its next entry, and the latest award of each role.
struct Log(Ledger, u64);

impl Log {
    fn with_missions(count: usize) -> (Log, Vec<MissionId>) {
        let mut log = Log(Ledger::default(), 1);
        let mission = MissionTemplate::parse(MISSION, Format::Yaml).unwrap();
        let mission = mission.instantiate(&BTreeMap::new(), &domain()).unwrap();
        let division = divide_and_check(&mission).unwrap();
        for number in 0..count {
            let request = format!("request-{number}").parse().unwrap();
            log.apply(Command::Submit(Box::new(Submission::of(request, mission.clone(), division.clone()))));
        }
        let missions = log.0.active_missions().into_iter().map(|entry| entry.id.clone()).collect();
        (log, missions)
    }

    fn apply(&mut self, command: Command) -> CommandOutcome {
        let at = Epoch { term: 1, index: self.1 };
        self.1 += 1;
        self.0.apply(at, command)
    }

    /// Awards the open roles of a mission, or promises those in `promised`.
    fn award(&mut self, mission: &MissionId, robots: &[(&str, &str)], promised: &[&str]) -> CommandOutcome {
        let holders = robots.iter().map(|(id, name)| (role(id), robot(name))).collect();
        let promised = promised.iter().map(|id| (role(id), Seconds::ZERO)).collect();
        let auction = AuctionRecord { promised, ..record(mission, robots) };
        self.apply(Command::Award { mission: mission.clone(), branch: Branch::Main, holders, auction })
    }

    /// Promises the arm of a mission before that of another, which it delays by this number of seconds; 60 s are permitted.
    fn insert(&mut self, mission: &MissionId, robot: &str, before: &MissionId, delay_s: f64) {
        let next = RoleOfMission { mission: before.clone(), role: role("arm") };
        let time = Seconds::new(delay_s).unwrap();
        let span = RoleSpan { from: None, to: None, time, energy: Energy::ZERO };
        let delay_max = Seconds::new(60.0).unwrap();
        let planned =
            PlannedRole { before: Some(next), delay: time, delay_max, ..PlannedRole::alone(span, Seconds::ZERO) };
        let promised = BTreeMap::from([(role("arm"), Seconds::ZERO)]);
        let planned = BTreeMap::from([(role("arm"), planned)]);
        let robots = [("arm", robot), ("cart", mission.as_str())];
        let holders = robots.iter().map(|(id, name)| (role(id), self::robot(name))).collect();
        let auction = AuctionRecord { promised, planned, ..record(mission, &robots) };
        let outcome = self.apply(Command::Award { mission: mission.clone(), branch: Branch::Main, holders, auction });
        assert!(matches!(outcome, CommandOutcome::Awarded { .. }), "{outcome:?}");
    }

    /// Returns the promised roles in a call of a mission to these robots; 60 s of delay are permitted.
    fn promised_roles(&self, mission: &MissionId, invited: &[&str]) -> Vec<PromisedRole> {
        let invited = invited.iter().map(|name| robot(name)).collect();
        let entry = self.0.mission(mission).unwrap();
        let call = entry.call_for_roles(&entry.open_roles(), record(mission, &[]).auction).unwrap();
        self.0.promised_roles(&call, Seconds::new(60.0).unwrap(), &invited, 0)
    }

    /// Moves the promise of the arm to another robot. It is promised to the robot with `is_promised`.
    fn move_promise(&mut self, mission: &MissionId, robot: &str, is_promised: bool) -> CommandOutcome {
        let (epoch, cause) = (self.epoch(mission, "arm"), "late".to_owned());
        let promised = is_promised.then(|| (role("arm"), Seconds::new(30.0).unwrap())).into_iter().collect();
        let auction = AuctionRecord { promised, at_ms: 1_000, ..record(mission, &[("arm", robot)]) };
        let (mission, role, robot) = (mission.clone(), role("arm"), self::robot(robot));
        self.apply(Command::MovePromise(Box::new(PromiseMove { mission, role, epoch, robot, cause, auction })))
    }

    /// Changes a mission at the request of a person.
    fn change(&mut self, mission: &MissionId, change: MissionChange) -> CommandOutcome {
        let order = OrderRequest { change, by: "Nia".to_owned(), at_ms: 1, request: None };
        self.apply(Command::ChangeMission { mission: mission.clone(), order })
    }

    /// Returns the missions of the promises of a robot in their order, with the delay of each.
    fn promises_of(&self, robot: &str) -> Vec<(MissionId, f64)> {
        let promises = self.0.promises_in_order().into_iter().filter(|(.., promise)| promise.robot.as_str() == robot);
        promises.map(|(entry, _, promise)| (entry.id.clone(), promise.delayed.get())).collect()
    }

    fn epoch(&self, mission: &MissionId, id: &str) -> Epoch {
        self.0.mission(mission).unwrap().role_robots()[&role(id)].epoch
    }

    fn award_promised(&mut self, mission: &MissionId, id: &str) -> CommandOutcome {
        let (epoch, role) = (self.epoch(mission, id), role(id));
        self.apply(Command::AwardPromised { mission: mission.clone(), role, epoch })
    }

    fn release(&mut self, mission: &MissionId, id: &str) -> CommandOutcome {
        let (epoch, role, cause) = (self.epoch(mission, id), role(id), "lost".to_owned());
        let (mission, class, place, gave_way) = (mission.clone(), None, None, false);
        self.apply(Command::Release { mission, role, epoch, cause, class, moved_nothing: true, place, gave_way })
    }

    /// Ends all steps of a held role.
    fn end(&mut self, mission: &MissionId, id: &str) {
        let (epoch, role, branch) = (self.epoch(mission, id), role(id), Branch::Main);
        let (ended, outcomes) = ((0..9).collect(), BTreeMap::new());
        self.apply(Command::Accept {
            mission: mission.clone(),
            role: role.clone(),
            epoch,
            incarnation: 1,
            from_checkpoint: false,
        });
        self.apply(Command::Progress { mission: mission.clone(), role, epoch, branch, ended, outcomes });
    }

    fn phase(&self, mission: &MissionId, id: &str) -> RolePhase {
        self.0.mission(mission).unwrap().roles[&role(id)].phase
    }
}

fn record(mission: &MissionId, robots: &[(&str, &str)]) -> AuctionRecord {
    let time = Seconds::new(20.0).unwrap();
    let part = BidPart { step: 0, label: "take".to_owned(), skill: "wait".parse().unwrap(), time, energy: 0.1 };
    let entry = |(id, name): &(&str, &str)| AuctionEntry {
        role: role(id),
        robot: robot(name),
        verdict: BidVerdict::Viable { time: Seconds::new(90.0).unwrap(), energy: 0.1, remaining: 0.5 },
        parts: vec![part.clone()],
    };
    AuctionRecord {
        entries: robots.iter().map(entry).collect(),
        ..AuctionRecord::empty(AuctionId { mission: mission.clone(), term: 1, round: 1 })
    }
}

#[test]
fn a_promised_role_is_awarded_once_its_robot_is_free() {
    let (mut log, missions) = Log::with_missions(2);
    let [first, second] = &missions[..] else { panic!() };
    log.award(first, &[("arm", "arm"), ("cart", "ada")], &[]);
    let outcome = log.award(second, &[("arm", "arm"), ("cart", "bob")], &["arm"]);
    assert!(matches!(outcome, CommandOutcome::Awarded { .. }), "{outcome:?}");
    let entry = log.0.mission(second).unwrap();
    assert_eq!((log.phase(second, "arm"), entry.state.as_str()), (RolePhase::Promised, "running"));
    let (_, promise) = entry.promised_roles().next().unwrap();
    assert_eq!(promise.time, Seconds::new(20.0).unwrap(), "the time of its tasks, without the wait");
    assert_eq!(entry.holders(), BTreeMap::from([(role("cart"), robot("bob"))]));
    assert!(entry.role_robots().contains_key(&role("arm")), "other robots learn who comes");
    assert!(!entry.can_proceed(&role("arm")), "the cart is still on its way");

    assert!(matches!(log.award_promised(second, "arm"), CommandOutcome::Refused(CommandError::TwoRoles { .. })));
    log.end(first, "arm");
    log.end(second, "cart");
    assert!(log.0.mission(second).unwrap().can_proceed(&role("arm")));
    let promised = log.epoch(second, "arm");
    assert!(matches!(log.award_promised(second, "arm"), CommandOutcome::Awarded { .. }));
    assert_eq!(log.phase(second, "arm"), RolePhase::Awarded);
    assert!(log.epoch(second, "arm") > promised, "the award has an epoch of its own");
    assert_eq!(log.0.held_by(&robot("arm")).unwrap().0.id, *second);
    let again = log.award_promised(second, "arm");
    assert!(matches!(again, CommandOutcome::Refused(CommandError::NotPromised { .. })), "{again:?}");
}

#[test]
fn a_promise_is_inserted_before_another_within_its_bound() {
    let (mut log, missions) = Log::with_missions(5);
    let [held, first, second, third, fourth] = &missions[..] else { panic!() };
    log.award(held, &[("arm", "arm"), ("cart", "ada")], &[]);
    log.award(first, &[("arm", "arm"), ("cart", "bob")], &["arm"]);
    log.award(second, &[("arm", "arm"), ("cart", "cyd")], &["arm"]);
    let of = |promises: &[(&MissionId, f64)]| -> Vec<(MissionId, f64)> {
        promises.iter().map(|(mission, delayed)| (MissionId::clone(mission), *delayed)).collect()
    };
    assert_eq!(log.promises_of("arm"), of(&[(first, 0.0), (second, 0.0)]));
    log.insert(third, "arm", second, 40.0);
    assert_eq!(log.promises_of("arm"), of(&[(first, 0.0), (third, 0.0), (second, 40.0)]));
    let (arm, entry) = (role("arm"), log.0.mission(second).unwrap());
    let (_, promise) = entry.promised_roles().next().unwrap();
    let before = log.0.roles_before(second, &arm, promise);
    assert!(before.iter().map(|role| &role.mission).eq([held, first, third]), "{before:?}");
    assert_eq!(promise.planned_ms, 40_000, "the insertion delays its start");
    let sent = log.promised_roles(fourth, &["arm"]);
    assert!(sent.is_empty(), "the estimates of two promises are unknown: {sent:?}");
    // It would delay the second mission by 70 s in all.
    log.insert(fourth, "arm", first, 30.0);
    assert_eq!(log.promises_of("arm"), of(&[(first, 0.0), (third, 0.0), (second, 40.0), (fourth, 0.0)]));
}

#[test]
fn a_call_for_bids_contains_the_promises_in_their_order() {
    let (mut log, missions) = Log::with_missions(3);
    let [first, second, third] = &missions[..] else { panic!() };
    log.insert(first, "arm", third, 20.0);
    log.insert(second, "arm", first, 40.0);
    let sent = log.promised_roles(third, &["arm"]);
    let slack: Vec<_> = sent.iter().map(|promise| (&promise.role.mission, promise.slack.map(Seconds::get))).collect();
    assert_eq!(slack, [(second, Some(60.0)), (first, Some(20.0))]);
    assert!(sent.iter().all(|promise| promise.robot.as_str() == "arm"));
    assert_eq!(sent[1].span.time.get(), 20.0);
    assert_eq!(log.promised_roles(third, &["ada"]), [], "the arm is not called");
}

#[test]
fn an_insertion_keeps_the_deadlines_of_promises() {
    let (mut log, missions) = Log::with_missions(4);
    let [first, second, third, fourth] = &missions[..] else { panic!() };
    log.insert(first, "arm", fourth, 20.0);
    // Its role takes 20 s.
    log.0.missions.get_mut(first).unwrap().submission.deadline_ms = Some(30_000);
    let slack = |log: &Log| log.promised_roles(fourth, &["arm"]).last().unwrap().slack.map(Seconds::get);
    assert_eq!(slack(&log), Some(10.0));
    log.insert(second, "arm", first, 8.0);
    assert_eq!(log.promises_of("arm"), [(second.clone(), 0.0), (first.clone(), 8.0)]);
    assert_eq!(slack(&log), Some(2.0));
    log.insert(third, "arm", first, 3.0);
    let missions: Vec<_> = log.promises_of("arm").into_iter().map(|(mission, _)| mission).collect();
    assert_eq!(missions, [second.clone(), first.clone(), third.clone()], "the first would end too late");
}

#[test]
fn a_promised_role_is_released_when_the_roles_before_it_are_planned_to_end() {
    let (mut log, missions) = Log::with_missions(2);
    let [first, second] = &missions[..] else { panic!() };
    // The cart begins at 0 and takes 20 s.
    log.insert(first, "arm", second, 20.0);
    let release_at = |log: &Log, now_ms| {
        let entry = log.0.mission(second).unwrap();
        let call = entry.call_for_roles(&entry.open_roles(), record(second, &[]).auction).unwrap();
        let sent = log.0.promised_roles(&call, Seconds::ZERO, &[robot("arm")].into(), now_ms);
        sent[0].release.get()
    };
    assert_eq!([0, 5_000, 30_000].map(|now_ms| release_at(&log, now_ms)), [20.0, 15.0, 0.0]);
    log.end(first, "cart");
    assert_eq!(release_at(&log, 5_000), 0.0, "the cart has ended early");
    log.0.missions.get_mut(first).unwrap().submission.not_before_ms = Some(40_000);
    assert_eq!(
        [0, 30_000, 40_000].map(|now_ms| release_at(&log, now_ms)),
        [40.0, 10.0, 0.0],
        "its mission starts later"
    );
}

#[test]
fn the_first_drive_of_a_promise_counts_towards_its_deadline() {
    let (mut log, missions) = Log::with_missions(2);
    let [first, second] = &missions[..] else { panic!() };
    // Its tasks take 5 s, and with the drive to them 20 s.
    log.insert(first, "arm", second, 5.0);
    log.0.missions.get_mut(first).unwrap().submission.deadline_ms = Some(30_000);
    let slack = log.promised_roles(second, &["arm"])[0].slack;
    assert_eq!(slack.map(Seconds::get), Some(10.0));
}

#[test]
fn a_stop_at_a_charger_counts_once_towards_the_deadline_of_a_promise() {
    let (mut log, missions) = Log::with_missions(2);
    let [first, second] = &missions[..] else { panic!() };
    log.insert(first, "arm", second, 325.0);
    let entry = log.0.missions.get_mut(first).unwrap();
    // It begins at 310 s, after the stop, and takes 25 s.
    entry.submission.deadline_ms = Some(345_000);
    let promise = entry.roles.get_mut(&role("arm")).unwrap().holder.as_mut().unwrap();
    let (charger, time) = ("dock".parse().unwrap(), Seconds::new(300.0).unwrap());
    let stop = ChargingStop { charger, time, until: BatteryShare::FULL, remaining: BatteryShare::FULL };
    (promise.planned_ms, promise.charging) = (310_000, Some(stop));
    let slack = log.promised_roles(second, &["arm"])[0].slack;
    assert_eq!(slack.map(Seconds::get), Some(10.0));
}

#[test]
fn a_call_has_a_bounded_size_and_names_the_shortest_queues() {
    const ROBOTS: usize = 400;
    let (mut log, missions) = Log::with_missions(ROBOTS + 1);
    let names: Vec<String> = (0..ROBOTS).map(|number| format!("arm-with-a-name-of-some-length-{number:04}")).collect();
    let (called, promised) = missions.split_last().unwrap();
    for (index, (mission, robot)) in promised.iter().zip(&names).enumerate() {
        // The last robots have promised the least.
        log.insert(mission, robot, called, (ROBOTS - index) as f64);
    }
    let robots: Vec<&str> = names.iter().map(String::as_str).collect();
    let sent = log.promised_roles(called, &robots);
    assert!(codec::encoded_size(&sent) <= PROMISED_BYTES_MAX, "{} bytes", codec::encoded_size(&sent));
    assert!(sent.len() > 50, "{} promises", sent.len());
    let expected = robots.iter().rev().take(sent.len());
    assert!(sent.iter().map(|promise| promise.robot.as_str()).eq(expected.copied()), "{sent:?}");
}

#[test]
fn a_promise_passes_to_another_robot() {
    let (mut log, missions) = Log::with_missions(3);
    let [held, first, second] = &missions[..] else { panic!() };
    log.award(held, &[("arm", "arm-1"), ("cart", "ada")], &[]);
    log.insert(first, "arm-1", held, 20.0);
    log.insert(second, "arm-1", held, 20.0);
    let call =
        log.0.mission(second).unwrap().call_for_roles(&[role("arm")].into(), record(second, &[]).auction).unwrap();
    let sent = log.0.promised_roles(&call, Seconds::ZERO, &[robot("arm-1")].into(), 0);
    let sent: Vec<_> = sent.iter().map(|promise| &promise.role.mission).collect();
    assert_eq!(sent, [first], "the role of the call is left out");

    let promised = log.epoch(second, "arm");
    for robot in ["arm-1", second.as_str()] {
        let own = log.move_promise(second, robot, true);
        assert!(matches!(own, CommandOutcome::Refused(CommandError::TwoRoles { .. })), "{own:?}");
    }
    assert!(matches!(log.move_promise(second, "arm-2", true), CommandOutcome::Awarded { .. }));
    let entry = log.0.mission(second).unwrap();
    let (_, promise) = entry.promised_roles().next().unwrap();
    assert_eq!((promise.robot.as_str(), promise.planned_ms), ("arm-2", 31_000));
    assert!(promise.epoch > promised, "others learn of the change");
    assert_eq!(entry.state.as_str(), "running");
    let releases: Vec<_> = entry.releases.iter().map(|release| (release.robot.as_str(), release.confirmed)).collect();
    assert_eq!(releases, [("arm-1", false)]);
    assert_eq!(log.promises_of("arm-1").len(), 1);

    // A free robot gets the role at once.
    assert!(matches!(log.move_promise(second, "arm-3", false), CommandOutcome::Awarded { .. }));
    assert_eq!(log.phase(second, "arm"), RolePhase::Awarded);
    let held = log.move_promise(second, "arm-4", true);
    assert!(matches!(held, CommandOutcome::Refused(CommandError::NotPromised { .. })), "{held:?}");
    let busy = log.move_promise(first, "arm-3", false);
    assert!(matches!(busy, CommandOutcome::Refused(CommandError::TwoRoles { .. })), "{busy:?}");
}

#[test]
fn a_promise_that_is_auctioned_again_uses_no_energy() {
    let (mut log, missions) = Log::with_missions(1);
    log.award(&missions[0], &[("arm", "arm-1"), ("cart", "ada")], &["arm"]);
    let entry = log.0.missions.get_mut(&missions[0]).unwrap();
    entry.submission.mission.energy_max = EnergyLimit::new(1.0).ok();
    let used = |role_of_call: &str| {
        let call = entry.call_for_roles(&[role(role_of_call)].into(), record(&missions[0], &[]).auction).unwrap();
        entry.energy_budget(&call).map(|budget| budget.used)
    };
    assert_eq!(entry.estimated_energy(), Energy::of_share(0.2));
    assert_eq!(used("arm"), Some(Energy::of_share(0.1)));
}

/// The robot may know the epoch of its promise, which permits nothing.
#[test]
fn a_promise_is_neither_accepted_nor_executed() {
    let (mut log, missions) = Log::with_missions(2);
    log.award(&missions[0], &[("arm", "arm"), ("cart", "ada")], &[]);
    log.award(&missions[1], &[("arm", "arm"), ("cart", "bob")], &["arm"]);
    let before = log.0.clone();
    log.end(&missions[1], "arm");
    assert_eq!(log.0, before);
    assert_eq!(log.release(&missions[1], "arm"), CommandOutcome::Done);
    assert_eq!(
        (log.phase(&missions[1], "arm"), log.phase(&missions[1], "cart")),
        (RolePhase::Open, RolePhase::Awarded)
    );
    let releases = &log.0.mission(&missions[1]).unwrap().releases;
    assert!(releases.iter().all(|release| !release.confirmed), "it does not count as a lost robot");
}

#[test]
fn an_untouched_role_is_postponed() {
    let (mut log, missions) = Log::with_missions(1);
    log.award(&missions[0], &[("arm", "arm"), ("cart", "ada")], &[]);
    let postpone = |log: &mut Log, id: &str| {
        let (mission, role, epoch) = (missions[0].clone(), role(id), log.epoch(&missions[0], id));
        log.apply(Command::Postpone { mission, role, epoch })
    };
    assert_eq!(postpone(&mut log, "arm"), CommandOutcome::Done);
    assert_eq!(log.phase(&missions[0], "arm"), RolePhase::Promised);
    assert!(log.0.held_by(&robot("arm")).is_none() && log.0.mission(&missions[0]).unwrap().releases.is_empty());
    log.end(&missions[0], "cart");
    assert!(matches!(log.award_promised(&missions[0], "arm"), CommandOutcome::Awarded { .. }));
    let late = postpone(&mut log, "cart");
    assert!(matches!(late, CommandOutcome::Refused(CommandError::CanStart { .. })), "{late:?}");
}

#[test]
fn missions_do_not_wait_for_each_other() {
    let (mut log, missions) = Log::with_missions(2);
    let [first, second] = &missions[..] else { panic!() };
    log.award(first, &[("arm", "bob"), ("cart", "ada")], &["arm"]);
    let crossed = log.award(second, &[("arm", "ada"), ("cart", "bob")], &["arm"]);
    assert_eq!(crossed, CommandOutcome::Refused(CommandError::CircularWait { mission: second.clone() }));
    assert_eq!(log.phase(second, "cart"), RolePhase::Open);
    // A robot has a single role in a mission, promised or not.
    log.release(first, "cart");
    let twice = log.award(first, &[("cart", "bob")], &[]);
    assert!(matches!(twice, CommandOutcome::Refused(CommandError::TwoRoles { .. })), "{twice:?}");
}

#[derive(Debug, Clone)]
enum Move {
    Award { mission: usize, arm: usize, cart: usize, promised: (bool, bool) },
    AwardPromised { mission: usize, of_arm: bool },
    End { mission: usize, of_arm: bool },
    Release { mission: usize, of_arm: bool },
    Postpone { mission: usize, of_arm: bool },
    PassPromise { mission: usize, arm: usize, is_promised: bool },
    Restrict { mission: usize, of_arm: bool, to: Option<usize>, is_pin: bool },
    SetPriority { mission: usize, priority: i64 },
}

const ROBOTS: [&str; 4] = ["ada", "bob", "cyd", "dan"];
const ROLES: [&str; 2] = ["cart", "arm"];

fn moves() -> impl Strategy<Value = Move> {
    let (mission, robot) = (|| 0..5_usize, || 0..ROBOTS.len());
    prop_oneof![
        3 => (mission(), robot(), robot(), any::<(bool, bool)>())
            .prop_map(|(mission, arm, cart, promised)| Move::Award { mission, arm, cart, promised }),
        2 => (mission(), any::<bool>()).prop_map(|(mission, of_arm)| Move::AwardPromised { mission, of_arm }),
        1 => (mission(), any::<bool>()).prop_map(|(mission, of_arm)| Move::End { mission, of_arm }),
        1 => (mission(), any::<bool>()).prop_map(|(mission, of_arm)| Move::Release { mission, of_arm }),
        1 => (mission(), any::<bool>()).prop_map(|(mission, of_arm)| Move::Postpone { mission, of_arm }),
        1 => (mission(), robot(), any::<bool>())
            .prop_map(|(mission, arm, is_promised)| Move::PassPromise { mission, arm, is_promised }),
        1 => (mission(), any::<bool>(), proptest::option::of(robot()), any::<bool>())
            .prop_map(|(mission, of_arm, to, is_pin)| Move::Restrict { mission, of_arm, to, is_pin }),
        1 => (mission(), -1..=1_i64).prop_map(|(mission, priority)| Move::SetPriority { mission, priority }),
    ]
}

fn perform(log: &mut Log, missions: &[MissionId], next: &Move) {
    let has = |log: &Log, mission: &MissionId, id: &str| {
        log.0.mission(mission).is_some_and(|entry| entry.role_robots().contains_key(&role(id)))
    };
    match *next {
        Move::Award { mission, arm, cart, promised } => {
            let mission = &missions[mission];
            let open = log.0.mission(mission).map(MissionEntry::open_roles).unwrap_or_default();
            let robots = [("arm", ROBOTS[arm], promised.0), ("cart", ROBOTS[cart], promised.1)];
            let robots: Vec<_> = robots.into_iter().filter(|(id, ..)| open.contains(&role(id))).collect();
            let promised: Vec<&str> = robots.iter().filter(|(.., promised)| *promised).map(|(id, ..)| *id).collect();
            let robots: Vec<(&str, &str)> = robots.iter().map(|(id, robot, _)| (*id, *robot)).collect();
            log.award(mission, &robots, &promised);
        }
        Move::AwardPromised { mission, of_arm } if has(log, &missions[mission], ROLES[usize::from(of_arm)]) => {
            log.award_promised(&missions[mission], ROLES[usize::from(of_arm)]);
        }
        Move::End { mission, of_arm } if has(log, &missions[mission], ROLES[usize::from(of_arm)]) => {
            log.end(&missions[mission], ROLES[usize::from(of_arm)]);
        }
        Move::Release { mission, of_arm } if has(log, &missions[mission], ROLES[usize::from(of_arm)]) => {
            log.release(&missions[mission], ROLES[usize::from(of_arm)]);
        }
        Move::Postpone { mission, of_arm } if has(log, &missions[mission], ROLES[usize::from(of_arm)]) => {
            let id = ROLES[usize::from(of_arm)];
            let (mission, role, epoch) = (missions[mission].clone(), role(id), log.epoch(&missions[mission], id));
            log.apply(Command::Postpone { mission, role, epoch });
        }
        Move::PassPromise { mission, arm, is_promised } if has(log, &missions[mission], "arm") => {
            log.move_promise(&missions[mission], ROBOTS[arm], is_promised);
        }
        Move::Restrict { mission, of_arm, to, is_pin } => {
            let (role, robot) = (role(ROLES[usize::from(of_arm)]), to.map(|to| robot(ROBOTS[to])));
            let change = match is_pin {
                true => MissionChange::Pin { role, robot },
                false => MissionChange::Reassign { role, to: robot, repeat: true },
            };
            log.change(&missions[mission], change);
        }
        Move::SetPriority { mission, priority } => {
            log.change(&missions[mission], MissionChange::SetPriority(Priority::new(priority).unwrap()));
        }
        Move::AwardPromised { .. }
        | Move::End { .. }
        | Move::Release { .. }
        | Move::Postpone { .. }
        | Move::PassPromise { .. } => {}
    }
}

proptest! {
    /// No robot ever holds two roles, no missions wait for each other, and a free robot with promises can
    /// get one of them.
    #[test]
    fn promises_can_always_be_kept(moves in proptest::collection::vec(moves(), 1..60)) {
        let (mut log, missions) = Log::with_missions(5);
        log.apply(Command::first_wire_version(3));
        for next in &moves {
            perform(&mut log, &missions, next);
            let active = log.0.active_missions();
            let held: Vec<&RobotId> =
                active.iter().flat_map(|entry| entry.held_roles().map(|(.., holder)| &holder.robot)).collect();
            prop_assert_eq!(held.len(), held.iter().collect::<BTreeSet<_>>().len());
            let waits = Waits::of(&log.0);
            prop_assert!(!missions.iter().any(|mission| waits.contain_cycle_of(mission)));
            for free in ROBOTS.map(robot).iter().filter(|robot| !held.contains(robot)) {
                let promises: Vec<_> = active
                    .iter()
                    .flat_map(|entry| entry.promised_roles().map(move |(role, robot)| (&entry.id, role, robot)))
                    .filter(|(.., robot)| robot.robot == *free)
                    .collect();
                let can_be_kept =
                    |(mission, role, robot): &(&MissionId, &RoleId, &RoleAssignment)| log.0.check_promise(mission, role, robot.epoch).is_ok();
                prop_assert!(promises.is_empty() || promises.iter().any(can_be_kept), "{:?}", promises);
            }
        }
    }
}

#[test]
fn the_order_of_promises_follows_a_new_priority() {
    let (mut log, missions) = Log::with_missions(2);
    log.apply(Command::first_wire_version(3));
    for mission in &missions {
        log.award(mission, &[("arm", "lab-arm"), ("cart", mission.as_str())], &["arm"]);
    }
    let order = |log: &Log| log.promises_of("lab-arm").into_iter().map(|(mission, _)| mission).collect::<Vec<_>>();
    assert_eq!(order(&log), missions);
    log.change(&missions[1], MissionChange::SetPriority(Priority::new(1).unwrap()));
    assert_eq!(order(&log), [missions[1].clone(), missions[0].clone()]);
}
