mod sizes;

use super::super::limits::UNENDED_MAX;
use super::*;
use crate::auction::AuctionId;
use crate::cause::CauseClass;
use crate::codec;
use crate::ids::{TaskId, TaskType};
use crate::mission::{Method, Mission, Role, TaskBody, TaskNode, TaskOrder, TaskOutcome, TaskSpec};
use crate::plan::{Division, LocalPlan, Signal, SignalKind, Step, StepAction};
use crate::scalar::Scalar;
use crate::trust::REQUEST_SKEW_MAX_MS;
use std::time::{Duration, Instant};

fn role(name: &str) -> RoleId {
    RoleId::new(name).unwrap()
}

fn robot(name: &str) -> RobotId {
    RobotId::new(name).unwrap()
}

/// `lab_arm` executes a task and then signals `r1`, which waits for it.
fn submission(request: &str) -> Box<Submission> {
    let task = TaskId::new("pick_up_parcel").unwrap();
    let spec = TaskSpec::of(TaskType::new("pick_up").unwrap(), vec![role("lab_arm")]);
    let signal = Signal { kind: SignalKind::Done, task: task.clone(), from: role("lab_arm"), to: role("r1") };
    let managed = Role::of(RoleKind::Managed);
    let method = Method::of(TaskOrder::Sequential, vec![1]);
    let mission = Mission {
        name: TaskId::new("unload").unwrap(),
        roles: BTreeMap::from([(role("lab_arm"), managed.clone()), (role("r1"), managed)]),
        ensembles: vec![],
        energy_max: None,
        tasks: vec![
            TaskNode { id: TaskId::new("root").unwrap(), body: TaskBody::Abstract(method) },
            TaskNode { id: task.clone(), body: TaskBody::Elementary(spec.clone()) },
        ],
        results: BTreeMap::new(),
    };
    let arm = vec![
        Step { action: StepAction::Task { id: task, spec }, after: vec![] },
        Step { action: StepAction::Send(signal.clone()), after: vec![0] },
    ];
    let cart = vec![Step { action: StepAction::Wait(signal), after: vec![] }];
    let plan = |name: &str, steps| (role(name), LocalPlan::of(role(name), steps));
    let division = Division { plans: BTreeMap::from([plan("lab_arm", arm), plan("r1", cart)]) };
    Box::new(Submission::of(RequestId::new(request).unwrap(), mission, division))
}

fn record() -> AuctionRecord {
    let mission = MissionId::new("unload-1").unwrap();
    let auction = AuctionId { mission, term: 1, round: 1 };
    AuctionRecord::empty(auction)
}

/// A ledger and the index of its next entry.
struct Log(Ledger, u64);

impl Log {
    fn new() -> Log {
        Log(Ledger::default(), 1)
    }

    fn apply(&mut self, command: Command) -> CommandOutcome {
        let at = Epoch { term: 1, index: self.1 };
        self.1 += 1;
        self.0.apply(at, command)
    }

    /// A ledger of the wire version that has a history.
    fn with_history() -> Log {
        let mut log = Log::new();
        log.apply(Command::first_wire_version(3));
        log
    }

    /// Submits missions, each of which fails at once.
    fn fail_others(&mut self, count: usize) {
        for number in 0..count {
            let mission = self.submit(&format!("other{number}"));
            let (cause, places, class) = ("test".to_owned(), BTreeMap::new(), CauseClass::Task);
            self.apply(Command::Fail { mission, cause, branch: None, places, class });
        }
    }

    fn cancel(&mut self, mission: &MissionId) -> CommandOutcome {
        self.apply(Command::Cancel {
            mission: mission.clone(),
            by: "Nia".to_owned(),
            places: BTreeMap::new(),
            at_ms: 7,
        })
    }

    fn submit(&mut self, request: &str) -> MissionId {
        self.submit_at(request, 0)
    }

    fn submit_at(&mut self, request: &str, at_ms: u64) -> MissionId {
        match self.apply_submission(request, at_ms) {
            CommandOutcome::Submitted { mission, .. } => mission,
            other => panic!("{other:?}"),
        }
    }

    fn apply_submission(&mut self, request: &str, at_ms: u64) -> CommandOutcome {
        self.apply(Command::Submit(Box::new(Submission { at_ms, ..*submission(request) })))
    }

    fn award(&mut self, mission: &MissionId, arm: &str, r1: &str) -> CommandOutcome {
        let holders = BTreeMap::from([(role("lab_arm"), robot(arm)), (role("r1"), robot(r1))]);
        self.apply(Command::Award { mission: mission.clone(), branch: Branch::Main, holders, auction: record() })
    }

    fn ended(&mut self, mission: &MissionId, who: &str, epoch: Epoch, ended: &[StepIndex]) -> CommandOutcome {
        let ended = ended.iter().copied().collect();
        let (mission, role, branch) = (mission.clone(), role(who), Branch::Main);
        self.apply(Command::Progress { mission, role, epoch, branch, ended, outcomes: BTreeMap::new() })
    }

    fn release(&mut self, mission: &MissionId, who: &str, epoch: Epoch) -> CommandOutcome {
        let cause = "silent for 7 s".to_owned();
        let (mission, role) = (mission.clone(), role(who));
        self.apply(Command::Release {
            mission,
            role,
            epoch,
            cause,
            class: None,
            moved_nothing: false,
            place: None,
            gave_way: false,
        })
    }

    fn state(&self, mission: &MissionId) -> &MissionState {
        &self.0.mission(mission).unwrap().state
    }
}

fn epoch(index: u64) -> Epoch {
    Epoch { term: 1, index }
}

#[test]
fn a_repeated_request_is_answered_again_and_executed_once() {
    let mut log = Log::new();
    let first = log.submit("a");
    assert_eq!(first.as_str(), "unload-1");
    let again = CommandOutcome::Submitted { mission: first, again: true };
    assert_eq!(log.apply(Command::Submit(submission("a"))), again);
    assert_eq!(log.submit("b").as_str(), "unload-2");
}

#[test]
fn a_mission_ends_when_all_its_managed_roles_have_ended() {
    let mut log = Log::new();
    let mission = log.submit("a");
    assert_eq!(log.award(&mission, "arm", "ada"), CommandOutcome::Awarded { epoch: epoch(2) });
    assert_eq!(log.ended(&mission, "lab_arm", epoch(2), &[0, 1]), CommandOutcome::Done);
    assert_eq!(log.state(&mission), &MissionState::Running);
    assert_eq!(log.ended(&mission, "r1", epoch(2), &[0, 99]), CommandOutcome::Done);
    assert_eq!(log.state(&mission), &MissionState::Completed);
    assert!(log.0.held_by(&robot("ada")).is_none());
}

/// Roles decide by outcomes, so that none may change after the first report.
#[test]
fn the_first_outcome_of_a_task_is_kept() {
    let mut log = Log::new();
    let mission = log.submit("a");
    log.award(&mission, "arm", "ada");
    let pulse = |bpm: i64| TaskOutcome::Done(BTreeMap::from([("pulse_bpm".to_owned(), Scalar::Integer(bpm))]));
    let report = |log: &mut Log, who: &str, epoch: Epoch, outcome: TaskOutcome| {
        let outcomes = BTreeMap::from([(TaskId::new("pick_up_parcel").unwrap(), outcome)]);
        let (mission, role, branch, ended) = (mission.clone(), role(who), Branch::Main, BTreeSet::new());
        log.apply(Command::Progress { mission, role, epoch, branch, ended, outcomes })
    };
    let recorded = |log: &Log| log.0.mission(&mission).unwrap().outcomes.values().cloned().collect::<Vec<_>>();
    assert_eq!(report(&mut log, "r1", epoch(2), pulse(99)), CommandOutcome::Done);
    assert_eq!(recorded(&log), [], "the plan of r1 does not contain the task");
    report(&mut log, "lab_arm", epoch(2), pulse(70));
    report(&mut log, "lab_arm", epoch(2), pulse(80));
    report(&mut log, "lab_arm", epoch(2), TaskOutcome::Skipped);
    assert_eq!(recorded(&log), [pulse(70)]);
    // The next holder has a result of its own, which comes too late.
    let released = log.release(&mission, "lab_arm", epoch(2));
    assert_eq!(released, CommandOutcome::Done);
    let holders = BTreeMap::from([(role("lab_arm"), robot("arm"))]);
    let again =
        log.apply(Command::Award { mission: mission.clone(), branch: Branch::Main, holders, auction: record() });
    let CommandOutcome::Awarded { epoch: later } = again else { panic!("{again:?}") };
    assert_eq!(report(&mut log, "lab_arm", later, pulse(90)), CommandOutcome::Done);
    assert_eq!(recorded(&log), [pulse(70)]);
}

#[test]
fn no_robot_holds_two_roles() {
    let mut log = Log::new();
    let (first, second) = (log.submit("a"), log.submit("b"));
    let two_roles = |mission: &MissionId, held| {
        CommandOutcome::Refused(CommandError::TwoRoles {
            robot: robot("ada"),
            mission: mission.clone(),
            role: role(held),
        })
    };
    assert_eq!(log.award(&first, "ada", "ada"), two_roles(&first, "lab_arm"));
    log.award(&first, "arm", "ada");
    assert_eq!(log.award(&second, "bob", "ada"), two_roles(&first, "r1"));
    assert_eq!(log.state(&second), &MissionState::Pending);
}

#[test]
fn an_award_fills_all_open_roles_or_is_rejected() {
    let mut log = Log::new();
    let mission = log.submit("a");
    let holders = BTreeMap::from([(role("r1"), robot("ada"))]);
    let outcome =
        log.apply(Command::Award { mission: mission.clone(), branch: Branch::Main, holders, auction: record() });
    let open = BTreeSet::from([role("lab_arm"), role("r1")]);
    assert_eq!(outcome, CommandOutcome::Refused(CommandError::NotOpen { mission: mission.clone(), open }));
    log.award(&mission, "arm", "ada");
    assert!(matches!(log.award(&mission, "bob", "cyd"), CommandOutcome::Refused(CommandError::NotOpen { .. })));
}

/// `lab_arm` belongs to a spread loop, and `r1` waits for it.
#[test]
fn roles_of_spread_loops_are_awarded_first_and_one_by_one() {
    let mut log = Log::new();
    let mut spread = submission("a");
    let arm = spread.mission.roles.get_mut(&role("lab_arm")).unwrap();
    arm.spread = true;
    let again = arm.clone();
    spread.mission.roles.insert(role("lab_arm_2"), again);
    spread.division.plans.insert(role("lab_arm_2"), LocalPlan::of(role("lab_arm_2"), vec![]));
    let CommandOutcome::Submitted { mission, .. } = log.apply(Command::Submit(spread)) else { panic!("submitted") };
    let to_auction = |log: &Log| log.0.mission(&mission).unwrap().roles_to_auction();
    let award = |log: &mut Log, who: &str, robot_name: &str| {
        let holders = BTreeMap::from([(role(who), robot(robot_name))]);
        log.apply(Command::Award { mission: mission.clone(), branch: Branch::Main, holders, auction: record() })
    };
    assert_eq!(to_auction(&log), [role("lab_arm"), role("lab_arm_2")].into(), "r1 waits for a signal");
    assert_eq!(award(&mut log, "lab_arm", "ada"), CommandOutcome::Awarded { epoch: epoch(2) });
    assert_eq!((log.state(&mission), to_auction(&log)), (&MissionState::Running, [role("lab_arm_2")].into()));
    assert!(matches!(award(&mut log, "lab_arm", "bob"), CommandOutcome::Refused(CommandError::NotOpen { .. })));
    assert_eq!(award(&mut log, "lab_arm_2", "bob"), CommandOutcome::Awarded { epoch: epoch(4) });
    assert_eq!(to_auction(&log), [role("r1")].into(), "no role of a loop is open");
    assert_eq!(log.state(&mission), &MissionState::Pending);
    assert_eq!(log.release(&mission, "lab_arm_2", epoch(4)), CommandOutcome::Done);
    assert_eq!((log.state(&mission), to_auction(&log)), (&MissionState::Running, [role("lab_arm_2")].into()));
    assert_eq!(log.release(&mission, "lab_arm", epoch(2)), CommandOutcome::Done);
    assert_eq!(log.state(&mission), &MissionState::Pending, "no robot works for the mission");
}

#[test]
fn reports_of_the_former_holder_of_a_released_role_are_rejected() {
    let mut log = Log::new();
    let mission = log.submit("a");
    log.award(&mission, "arm", "ada");
    log.ended(&mission, "lab_arm", epoch(2), &[0]);
    assert_eq!(log.release(&mission, "lab_arm", epoch(2)), CommandOutcome::Done);
    assert_eq!(log.state(&mission), &MissionState::Pending);
    assert_eq!(log.0.mission(&mission).unwrap().open_roles(), BTreeSet::from([role("lab_arm")]));

    let holders = BTreeMap::from([(role("lab_arm"), robot("bob"))]);
    let award = Command::Award { mission: mission.clone(), branch: Branch::Main, holders, auction: record() };
    assert_eq!(log.apply(award), CommandOutcome::Awarded { epoch: epoch(5) });
    let held = Some(epoch(5));
    let stale =
        CommandOutcome::Refused(CommandError::StaleEpoch { mission: mission.clone(), role: role("lab_arm"), held });
    assert_eq!(log.ended(&mission, "lab_arm", epoch(2), &[0, 1]), stale);
    assert_eq!(log.release(&mission, "lab_arm", epoch(2)), stale);
    assert!(log.0.mission(&mission).unwrap().roles[&role("lab_arm")].ended.is_empty());
}

#[test]
fn a_role_that_has_signalled_others_is_not_restarted() {
    let mut log = Log::new();
    let mission = log.submit("a");
    log.award(&mission, "arm", "ada");
    log.ended(&mission, "lab_arm", epoch(2), &[1]);
    log.release(&mission, "lab_arm", epoch(2));
    let cause = "arm was lost as lab_arm after others had acted on its work: silent for 7 s".to_owned();
    assert_eq!(log.state(&mission), &MissionState::Failed { cause, class: CauseClass::Robot });
}

#[test]
fn a_signal_counts_as_sent_when_its_receiver_reports_the_wait() {
    let mut log = Log::new();
    let mission = log.submit("a");
    log.award(&mission, "arm", "ada");
    log.ended(&mission, "r1", epoch(2), &[0]); // the wait for the arm
    log.release(&mission, "lab_arm", epoch(2));
    assert!(matches!(log.state(&mission), MissionState::Failed { .. }));
}

#[test]
fn a_restarted_robot_continues_only_from_a_checkpoint() {
    let mut log = Log::new();
    let mission = log.submit("a");
    log.award(&mission, "arm", "ada");
    let accept = |incarnation, resumes| {
        let (mission, role) = (mission.clone(), role("r1"));
        Command::Accept { mission, role, epoch: epoch(2), incarnation, from_checkpoint: resumes }
    };
    assert_eq!(log.apply(accept(1, false)), CommandOutcome::Done);
    assert_eq!(log.apply(accept(1, false)), CommandOutcome::Done);
    assert!(matches!(log.apply(accept(2, false)), CommandOutcome::Refused(CommandError::Restarted { .. })));
    assert_eq!(log.apply(accept(1, false)), CommandOutcome::Done);
    // A node that restored the plan continues, and reports of its earlier incarnation are rejected.
    assert_eq!(log.apply(accept(3, true)), CommandOutcome::Done);
    assert_eq!(log.apply(accept(3, true)), CommandOutcome::Done);
    assert!(matches!(log.apply(accept(1, false)), CommandOutcome::Refused(CommandError::StaleIncarnation { .. })));
    assert!(matches!(log.apply(accept(2, true)), CommandOutcome::Refused(CommandError::StaleIncarnation { .. })));
}

#[test]
fn a_canceled_mission_frees_its_robots_and_rejects_reports() {
    let mut log = Log::new();
    let mission = log.submit("a");
    log.award(&mission, "arm", "ada");
    assert_eq!(
        log.apply(Command::Cancel {
            mission: mission.clone(),
            by: "a clerk".to_owned(),
            places: BTreeMap::new(),
            at_ms: 7
        }),
        CommandOutcome::Done
    );
    assert!(log.0.held_by(&robot("ada")).is_none());
    assert!(matches!(
        log.ended(&mission, "r1", epoch(2), &[0]),
        CommandOutcome::Refused(CommandError::MissionEnded { .. })
    ));
    assert!(log.0.active_missions().is_empty());
}

#[test]
fn the_number_of_ended_missions_kept_is_bounded() {
    let mut log = Log::new();
    for number in 0..HISTORY_MAX + 3 {
        let mission = log.submit(&format!("request{number}"));
        let (cause, places, class) = ("test".to_owned(), BTreeMap::new(), CauseClass::Task);
        log.apply(Command::Fail { mission, cause, branch: None, places, class });
    }
    assert_eq!(log.0.missions().count(), HISTORY_MAX);
    assert!(log.0.mission_of_request(&RequestId::new("request0").unwrap()).is_none());
    assert!(log.0.mission_of_request(&RequestId::new("request3").unwrap()).is_some());
}

#[test]
fn a_slow_mission_is_kept_when_it_ends_after_many_others() {
    let mut log = Log::with_history();
    let slow = log.submit("first");
    log.fail_others(520);
    assert_eq!(log.cancel(&slow), CommandOutcome::Done);
    assert_eq!(log.0.mission(&slow).map(|entry| entry.state.as_str()), Some("canceled"));
    let again = CommandOutcome::Submitted { mission: slow, again: true };
    assert_eq!(log.apply(Command::Submit(submission("first"))), again);
}

#[test]
fn a_repeated_request_is_not_executed_again_after_many_others() {
    let mut log = Log::with_history();
    let early = log.submit("first");
    log.cancel(&early);
    log.fail_others(520);
    let again = CommandOutcome::Submitted { mission: early, again: true };
    assert_eq!(log.apply(Command::Submit(submission("first"))), again);
}

#[test]
fn an_outcome_is_known_for_a_day_after_the_end() {
    const HOUR_MS: u64 = 60 * 60 * 1000;
    let mut log = Log::with_history();
    let slow = log.submit_at("first", 0);
    // It ends after the last of many other missions, which are submitted at the same time.
    log.fail_others(1);
    log.cancel(&slow);
    log.submit_at("next", 30 * HOUR_MS);
    log.fail_others(HISTORY_MAX + 1);
    assert_eq!(log.0.mission(&slow), None);
    assert_eq!(log.0.mission_state(&slow), Some(&MissionState::Canceled { by: "Nia".to_owned() }));
    let ended =
        CommandError::MissionEnded { mission: slow.clone(), state: log.0.mission_state(&slow).unwrap().clone() };
    assert_eq!(log.ended(&slow, "r1", epoch(2), &[0]), CommandOutcome::Refused(ended));
    assert_eq!(log.cancel(&slow), CommandOutcome::Done, "a repeated request");
    log.submit_at("later", 54 * HOUR_MS - 1);
    assert!(log.0.remembers(&RequestId::new("first").unwrap()));
    log.submit_at("much-later", 54 * HOUR_MS);
    assert!(!log.0.remembers(&RequestId::new("first").unwrap()));
    assert!(log.0.missions().count() > HISTORY_MAX, "missions kept whole are remembered");
}

#[test]
fn the_limits_of_the_history_are_part_of_the_ledger() {
    let mut log = Log::with_history();
    assert_eq!(log.0.history_limits(), Some(HistoryLimits::default()));
    let limits = HistoryLimits { missions_max: 2, outcome_age_max_ms: 1_000, outcome_bytes_max: u64::MAX };
    log.apply(Command::SetHistoryLimits(limits));
    let in_force = HistoryLimits { outcome_bytes_max: HistoryLimits::LARGEST.outcome_bytes_max, ..limits };
    assert_eq!(log.0.history_limits(), Some(in_force), "the largest allowed size");
    let first = log.submit_at("first", 0);
    log.cancel(&first);
    log.fail_others(2);
    assert_eq!(log.0.missions().count(), 2);
    log.submit_at("later", 999);
    assert!(log.0.remembers(&RequestId::new("first").unwrap()));
    log.submit_at("much-later", 1_000);
    assert!(!log.0.remembers(&RequestId::new("first").unwrap()));
}

#[test]
fn lower_limits_of_the_history_hold_at_once() {
    let mut log = Log::with_history();
    log.fail_others(3);
    assert_eq!(log.0.missions().count(), 3);
    log.apply(Command::SetHistoryLimits(HistoryLimits { missions_max: 1, ..HistoryLimits::default() }));
    assert_eq!(log.0.missions().count(), 1);
}

/// Submits and cancels missions, one per millisecond after the first, until the first request is forgotten. Returns
/// the time of the last submission.
fn forget(log: &mut Log, first: &RequestId, at_ms: u64) -> u64 {
    for number in 0..100_000 {
        if number > 0 && !log.0.remembers(first) {
            return at_ms + number - 1;
        }
        let request = if number == 0 { first.clone() } else { RequestId::generate(at_ms - 1 + number, 1) };
        let mission = log.submit_at(request.as_str(), at_ms + number);
        log.cancel(&mission);
    }
    panic!("the tombstones are bounded");
}

#[test]
fn a_request_that_may_be_a_repetition_of_a_forgotten_request_is_rejected() {
    let mut log = Log::with_history();
    let name = |at_ms, random| RequestId::generate(at_ms, random);
    let now_ms = forget(&mut log, &name(1000, 1), 1001);
    let before = log.0.clone();
    for random in [1, 2] {
        let request = name(1000, random);
        let refused = CommandError::RequestForgotten { request: request.clone(), created_ms: 1000, since_ms: 1001 };
        let outcome = log.apply_submission(request.as_str(), now_ms);
        assert_eq!(outcome, CommandOutcome::Refused(refused));
    }
    assert!(log.0 == before);
    log.submit_at(name(1002, 9).as_str(), now_ms);
    log.submit_at("without-a-time", now_ms);
}

#[test]
fn a_repetition_is_rejected_although_the_clock_of_its_client_is_ahead() {
    for lead_ms in [1, 2000, REQUEST_SKEW_MAX_MS] {
        let mut log = Log::with_history();
        let first = RequestId::generate(1001 + lead_ms, 1);
        let now_ms = forget(&mut log, &first, 1001);
        let (created_ms, since_ms) = (1001 + lead_ms, 1001 + lead_ms);
        let refused = CommandError::RequestForgotten { request: first.clone(), created_ms, since_ms };
        assert_eq!(log.apply_submission(first.as_str(), now_ms), CommandOutcome::Refused(refused));
    }
}

#[test]
fn a_ledger_keeps_its_layout_until_the_wire_version_is_raised() {
    let mut log = Log::new();
    log.apply(Command::first_wire_version(2));
    let early = log.submit("first");
    log.cancel(&early);
    let former = (log.0.cluster, log.0.missions.clone(), log.0.requests.clone(), log.0.submitted, Some(2_u8));
    let bytes = codec::encode_record(&former).unwrap();
    assert_eq!(codec::encode_record(&log.0).unwrap(), bytes);
    log.0 = codec::decode_record(&bytes).unwrap();
    log.apply(Command::first_wire_version(3));
    assert_eq!(log.0.mission_state(&early).map(MissionState::as_str), Some("canceled"));
    log.fail_others(520);
    assert!(log.0.remembers(&RequestId::new("first").unwrap()));
    let again: Ledger = codec::decode_record(&codec::encode_record(&log.0).unwrap()).unwrap();
    assert!(again == log.0);
}

#[test]
fn a_full_ledger_accepts_missions_after_others_have_ended() {
    let mut log = Log::with_history();
    let first = log.submit("first");
    for number in 1..UNENDED_MAX {
        log.submit(&format!("other{number}"));
    }
    let full = CommandOutcome::Refused(CommandError::Full { missions: UNENDED_MAX as u64 });
    assert_eq!(log.apply_submission("one-more", 0), full);
    let again = CommandOutcome::Submitted { mission: first.clone(), again: true };
    assert_eq!(log.apply_submission("first", 0), again);
    log.cancel(&first);
    log.submit("one-more");
    assert_eq!(log.apply_submission("two-more", 0), full);
}

/// A snapshot copies the ledger while it is locked. The copy shares the entries, so it takes much less time than a
/// comparison, which reads them all.
#[test]
fn a_copy_of_a_full_ledger_copies_no_entries() {
    let mut log = Log::with_history();
    log.fail_others(20_000);
    for number in 0..1000 {
        log.submit(&format!("waiting{number}"));
    }
    assert_eq!((log.0.active_missions().len(), log.0.latest_ended().count()), (1000, 20_000));
    let times = (0..10).map(|_| {
        let began = Instant::now();
        let copy = log.0.clone();
        let copied = began.elapsed();
        assert!(copy == log.0);
        (copied, began.elapsed() - copied)
    });
    let (copies, comparisons): (Vec<Duration>, Vec<Duration>) = times.unzip();
    let [copied, compared] = [copies, comparisons].map(|times| times.into_iter().min().unwrap());
    assert!(copied * 10 < compared, "{copied:?} for a copy, {compared:?} for a comparison");
}

#[test]
fn the_cluster_of_a_ledger_is_set_once() {
    let mut log = Log::new();
    assert_eq!(log.0.cluster(), None);
    assert_eq!(log.apply(Command::Bootstrap { cluster: ClusterId(1) }), CommandOutcome::Done);
    assert_eq!(log.apply(Command::Bootstrap { cluster: ClusterId(2) }), CommandOutcome::Done);
    assert_eq!(log.0.cluster(), Some(ClusterId(1)));
    log.0.replace_cluster(ClusterId(3));
    assert_eq!(log.apply(Command::Bootstrap { cluster: ClusterId(1) }), CommandOutcome::Done);
    assert_eq!(log.0.cluster(), Some(ClusterId(3)));
}
