use super::super::state_order::StateStamp;
use super::*;
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, Seconds, WorldTime};
use consort_skills::actions::{Feedback, JsonObject, Wait};

fn executing() -> GoalStatus {
    let distance_remaining = consort_protocol::units::Metres::ZERO;
    GoalStatus::Executing(Feedback::remaining(distance_remaining, Seconds::ZERO))
}

/// Returns a goal that must not be repeated.
fn pick_up(from: &str) -> Goal {
    let parameters = JsonObject::from_iter([("from".to_owned(), from.into())]);
    Goal { action: "pick_up".parse().unwrap(), parameters, repeatable: false, hands_over: None, since: None }
}

fn stamp(sequence: u64) -> StateStamp {
    StateStamp { boot: 3, sequence }
}

fn state(number: u64, goals: &[(u64, GoalStatus)]) -> DriverState {
    let telemetry = Telemetry {
        time: WorldTime::ZERO,
        pose: Pose::default(),
        place: "Dock".parse().unwrap(),
        battery: BatteryShare::FULL,
        able: true,
        closed: vec![],
        readings: BTreeMap::new(),
    };
    let goals = goals.iter().map(|(id, status)| (GoalId(*id), status.clone())).collect();
    DriverState { robot: "ada".parse().unwrap(), stamp: stamp(number), telemetry, goals, completed: vec![] }
}

fn at(ms: u64) -> NodeTime {
    NodeTime::at(Duration::from_millis(ms))
}

#[test]
fn no_goal_starts_without_a_permission() {
    let mut tracker = GoalTracker::new(100);
    tracker.apply_state(state(1, &[]), at(500));
    tracker.start_goal(Goal::from(Wait { time: Seconds::ZERO }));
    let start = || tracker.pending.first().cloned();
    let heartbeat = DriverCommand { request: None, permit: Permit::default() };
    assert_eq!(tracker.command(start(), at(600)), heartbeat);
    assert_eq!(tracker.command(None, at(600)), heartbeat);
    let mut tracker = tracker;
    tracker.allow_until(Some(at(1_500)));
    let start = tracker.pending.first().cloned();
    let permit = Permit { goals: vec![GoalId(100)], state: stamp(1), keep_for_ms: 1_000 };
    let expected = DriverCommand { request: start.clone(), permit };
    assert_eq!(tracker.command(start.clone(), at(600)), expected);
    assert_eq!(tracker.command(start, at(1_500)), heartbeat, "the lease has run out");
    assert_eq!(tracker.command(None, at(1_500)), heartbeat);
}

#[test]
fn the_permission_of_a_goal_that_stops_slowly_ends_before_the_lease() {
    let seconds = Duration::from_secs;
    let times = BTreeMap::from([("pick_up".parse().unwrap(), seconds(3)), ("press".parse().unwrap(), seconds(4))]);
    let mut tracker = GoalTracker::new(100).with_cancel_times(&times);
    assert_eq!(tracker.stop_lead(), Duration::from_millis(3_500), "it is not known which goals are in progress");
    tracker.apply_state(state(1, &[]), at(500));
    tracker.allow_until(Some(at(4_500)));
    let id = tracker.start_goal(Goal::from(Wait { time: Seconds::ZERO }));
    assert_eq!(tracker.command(None, at(2_000)).permit.keep_for_ms, 4_000, "its action declares no time");
    tracker.apply_state(state(2, &[(id.0, GoalStatus::succeeded())]), at(600));
    let id = tracker.start_goal(pick_up("birch"));
    assert_eq!(tracker.command(None, at(1_000)).permit.keep_for_ms, 1_400, "2.5 s before the lease");
    assert_eq!(tracker.command(None, at(2_000)).permit, Permit::default());
    tracker.cancel(id);
    assert_eq!(tracker.stop_lead(), Duration::from_millis(2_500), "it comes to rest");
    tracker.apply_state(state(3, &[(id.0, GoalStatus::Canceled)]), at(700));
    assert_eq!(tracker.stop_lead(), Duration::ZERO);
    tracker.apply_state(state(4, &[(7, executing())]), at(800));
    assert_eq!(tracker.stop_lead(), Duration::from_millis(3_500), "a goal of a previous incarnation");
}

/// A role ended while the client waited for the reply to an earlier request, and the robot acts without a role now.
#[test]
fn a_canceled_goal_does_not_start_under_a_later_permission() {
    let mut tracker = GoalTracker::new(100);
    tracker.apply_state(state(1, &[]), at(500));
    tracker.start_goal(Goal::from(Wait { time: Seconds::ZERO }));
    let start = tracker.pending.first().cloned();
    tracker.cancel_all();
    tracker.allow_until(Some(at(1_500)));
    assert_eq!(tracker.command(start, at(600)).request, None);
    let cancel = GoalRequest::Cancel { id: GoalId(100) };
    assert_eq!(tracker.command(Some(cancel.clone()), at(600)).request, Some(cancel));
}

#[test]
fn the_feedback_is_that_of_the_goal_in_progress() {
    let values = BTreeMap::from([("soaked".to_owned(), Scalar::Number(0.5))]);
    let remaining = Feedback::remaining(consort_protocol::units::Metres::ZERO, Seconds::ZERO);
    let soaking = GoalStatus::Executing(Feedback { values: values.clone(), ..remaining });
    let mut tracker = GoalTracker::new(100);
    for _ in 0..2 {
        tracker.start_goal(Goal::from(Wait { time: Seconds::ZERO }));
    }
    assert_eq!(tracker.feedback(), BTreeMap::new(), "no goal has begun");
    let soaks = state(1, &[(100, GoalStatus::succeeded()), (101, soaking)]);
    assert_eq!(soaks.feedback(), values);
    tracker.apply_state(soaks, at(0));
    assert_eq!(tracker.feedback(), values);
    tracker.apply_state(state(2, &[(101, GoalStatus::succeeded())]), at(0));
    assert_eq!(tracker.feedback(), BTreeMap::new(), "the goal has ended");
}

#[test]
fn only_certain_goals_have_moved_nothing() {
    let error = |moved_nothing| {
        let error = ActionError::new(ErrorCode::Failed, "why");
        GoalStatus::Aborted(ActionError { moved_nothing, ..error })
    };
    let mut tracker = GoalTracker::new(100);
    assert!(tracker.moved_nothing(GoalId(100)), "no goal was sent");
    assert!(!tracker.moved_nothing(GoalId(99)), "a previous incarnation may have sent one");
    tracker.start_goal(Goal::from(Wait { time: Seconds::ZERO }));
    assert!(tracker.moved_nothing(GoalId(100)), "waiting moves nothing");
    let pick_up = pick_up("birch");
    for (number, (status, expected)) in (101..).zip([
        (executing(), false),
        (error(false), false),
        (error(true), true),
        (GoalStatus::succeeded(), false),
        (GoalStatus::Canceled, false),
    ]) {
        assert_eq!(tracker.start_goal(pick_up.clone()), GoalId(number));
        tracker.apply_state(state(number, &[(number, status.clone())]), at(number));
        assert_eq!(tracker.moved_nothing(GoalId(number)), expected, "{status:?}");
    }
    assert!(!tracker.moved_nothing(GoalId(103)), "a later goal of the task may have");
    tracker.begin_attempt(GoalId(106));
    assert!(tracker.moved_nothing(GoalId(106)));
    tracker.start_goal(Goal { hands_over: Some(false), ..pick_up.clone() });
    assert!(tracker.moved_nothing(GoalId(106)), "its action hands no item over");
    tracker.start_goal(Goal { hands_over: Some(true), ..Goal::from(Wait { time: Seconds::ZERO }) });
    assert!(!tracker.moved_nothing(GoalId(106)), "its action hands items over");
}

#[test]
fn a_canceled_goal_is_not_kept_alive() {
    let mut tracker = GoalTracker::new(100);
    tracker.allow_until(Some(at(60_000)));
    let id = tracker.start_goal(Goal::from(Wait { time: Seconds::ZERO }));
    tracker.pending.clear();
    tracker.apply_state(state(1, &[(100, executing()), (7, executing())]), at(500));
    let kept = |tracker: &GoalTracker| tracker.command(None, at(600)).permit.goals;
    assert_eq!(kept(&tracker), [id], "the goal of a previous incarnation is not listed");
    tracker.cancel(id);
    assert_eq!(kept(&tracker), []);
}

#[test]
fn each_completed_goal_of_an_earlier_attempt_is_claimed_once() {
    let mut tracker = GoalTracker::new(100);
    // Goal 5 belongs to a task that has ended; 6 and 7 belong to a previous incarnation, and
    // 101 to this one.
    let done = [(5, "amber"), (6, "birch"), (7, "amber"), (101, "amber")];
    let done = done.map(|(id, from)| (GoalId(id), pick_up(from), GoalResult::default()));
    tracker.apply_state(DriverState { completed: done.to_vec(), ..state(1, &[]) }, at(0));
    assert!(tracker.claim_completed(&pick_up("amber")).is_none(), "no attempt has started");
    let attempt = |next: u64| Attempt { earlier: 6..next, claimed: BTreeSet::new() };
    tracker.attempt = attempt(100);
    assert!(tracker.claim_completed(&pick_up("clove")).is_none());
    assert_eq!([(); 2].map(|()| tracker.claim_completed(&pick_up("amber")).is_some()), [true, false]);
    assert_eq!([(); 2].map(|()| tracker.claim_completed(&pick_up("birch")).is_some()), [true, false]);
    tracker.attempt = attempt(102);
    assert_eq!(
        [(); 3].map(|()| tracker.claim_completed(&pick_up("amber")).is_some()),
        [true, true, false],
        "the third attempt"
    );
}

#[test]
fn a_goal_that_a_previous_incarnation_may_have_begun_names_the_first_goal_of_its_task() {
    let since = |first: Option<u64>, goal: Goal| {
        let mut tracker = GoalTracker::new(100);
        tracker.start_goal(Goal::from(Wait { time: Seconds::ZERO }));
        first.into_iter().for_each(|first| tracker.begin_attempt(GoalId(first)));
        tracker.start_goal(goal);
        match tracker.pending.last() {
            Some(GoalRequest::Start { goal, .. }) => goal.since,
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(since(Some(6), pick_up("birch")), Some(GoalId(6)));
    assert_eq!(since(Some(6), Goal::from(Wait { time: Seconds::ZERO })), None, "it is repeatable");
    for first in [None, Some(100), Some(101)] {
        assert_eq!(since(first, pick_up("birch")), None, "the task began in this incarnation: {first:?}");
    }
    // A third incarnation asks for the goal without it.
    let mut tracker = GoalTracker::new(200);
    let done = Goal { since: Some(GoalId(6)), ..pick_up("birch") };
    let completed = vec![(GoalId(101), done, GoalResult::default())];
    tracker.apply_state(DriverState { completed, ..state(1, &[]) }, at(0));
    tracker.begin_attempt(GoalId(6));
    assert!(tracker.claim_completed(&pick_up("birch")).is_some());
}

#[test]
fn a_goal_of_a_previous_incarnation_is_canceled() {
    let mut tracker = GoalTracker::new(100);
    assert!(tracker.apply_state(state(1, &[(6, GoalStatus::succeeded()), (7, executing())]), at(0)));
    assert_eq!(tracker.pending, [GoalRequest::Cancel { id: GoalId(7) }]);
    assert!(!tracker.goals[&GoalId(7)].is_final());
    tracker.pending.clear();
    assert!(!tracker.apply_state(state(2, &[(6, GoalStatus::succeeded()), (7, GoalStatus::Canceled)]), at(0)));
    assert!(tracker.goals.values().all(GoalStatus::is_final));
}

#[test]
fn a_restarted_server_loses_started_goals_but_not_pending_requests() {
    let mut tracker = GoalTracker::new(100);
    tracker.goals = BTreeMap::from([(GoalId(100), executing()), (GoalId(101), GoalStatus::Sent)]);
    tracker.pending = vec![GoalRequest::Start { id: GoalId(101), goal: Goal::from(Wait { time: Seconds::ZERO }) }];
    assert!(!tracker.apply_state(state(1, &[(100, executing())]), at(0)));
    assert_eq!(tracker.goals[&GoalId(100)], executing());
    assert!(!tracker.apply_state(state(2, &[]), at(0)));
    assert!(matches!(&tracker.goals[&GoalId(100)], GoalStatus::Aborted(error) if error.code == ErrorCode::Unknown));
    assert_eq!(tracker.goals[&GoalId(101)], GoalStatus::Sent);
}

#[test]
fn a_goal_continues_with_its_id_after_a_restart_of_the_server() {
    let restarted = |boot: u64| DriverState { stamp: StateStamp { boot, sequence: 1 }, ..state(1, &[]) };
    let wait = Goal::from(Wait { time: Seconds::ZERO });
    for (goal, since) in [(wait, None), (pick_up("birch"), Some(GoalId(100)))] {
        let mut tracker = GoalTracker::new(100);
        let id = tracker.start_goal(goal.clone());
        tracker.pending.clear();
        tracker.apply_state(state(1, &[(100, executing())]), at(0));
        for boot in 4..7 {
            assert!(tracker.apply_state(restarted(boot), at(boot)), "the request is due");
            let again = GoalRequest::Start { id, goal: Goal { since, ..goal.clone() } };
            assert_eq!(tracker.pending, [again]);
            assert_eq!(tracker.goals[&id], GoalStatus::Sent);
            tracker.pending.clear();
        }
        tracker.apply_state(restarted(7), at(7));
        assert!(matches!(tracker.goals[&id], GoalStatus::Aborted(_)), "it may be the cause of the restarts");
        assert!(tracker.contents.is_empty());
    }
    // A canceled goal is not started again.
    let mut tracker = GoalTracker::new(100);
    let id = tracker.start_goal(pick_up("birch"));
    tracker.apply_state(state(1, &[(100, executing())]), at(0));
    tracker.cancel(id);
    tracker.pending.clear();
    tracker.apply_state(restarted(4), at(1));
    assert!(tracker.goals[&id].is_final() && tracker.pending.is_empty());
}
