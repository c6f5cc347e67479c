//! The goal tracker: latest state of a driver and requests without a reply, as a value.

use super::CLIENT_TIMEOUT;
use super::messages::{DriverCommand, DriverState, GoalRequest, Permit};
use super::state_order::StateOrder;
use consort_protocol::lease::keep_for;
use consort_protocol::scalar::Scalar;
use consort_protocol::units::NodeTime;
use consort_skills::actions::{ActionError, ErrorCode, Goal, GoalId, GoalResult, GoalStatus, Telemetry};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;
use tracing::info;

/// Number of final goal states that are kept.
const GOALS_KEPT: usize = 32;

/// State of a driver as known to its client, and pending requests.
pub(super) struct GoalTracker {
    next: u64,
    latest: Option<LatestState>,
    order: StateOrder,
    /// Creation time of the tracker.
    since: Instant,
    /// Time until which the robot may act.
    allowed_until: Option<NodeTime>,
    goals: BTreeMap<GoalId, GoalStatus>,
    /// Canceled goals, until their end is reported.
    canceled: BTreeSet<GoalId>,
    /// Completed goals that must not be repeated, including those of previous incarnations of this
    /// node.
    done: BTreeMap<GoalId, (Goal, GoalResult)>,
    attempt: Attempt,
    /// Goals of this incarnation that may move items.
    moving: BTreeSet<GoalId>,
    /// First goal of this incarnation.
    first: GoalId,
    /// Requests without a reply, in the order of sending.
    pending: Vec<GoalRequest>,
    changed: watch::Sender<u64>,
}

/// Latest state of the server.
struct LatestState {
    telemetry: Telemetry,
    /// Arrival time.
    arrived: Instant,
    /// Arrival time by the node's clock.
    arrived_at: NodeTime,
}

/// Attempt at a task. Goals that earlier attempts have completed are not repeated.
#[derive(Default)]
struct Attempt {
    /// Goal ids of earlier attempts at the same task.
    earlier: std::ops::Range<u64>,
    /// Completed goals among them that this attempt has already used.
    claimed: BTreeSet<GoalId>,
}

impl GoalTracker {
    /// Creates a tracker without a state; goal ids start at `next`.
    pub(super) fn new(next: u64) -> GoalTracker {
        GoalTracker {
            next,
            latest: None,
            order: StateOrder::default(),
            since: Instant::now(),
            allowed_until: None,
            goals: BTreeMap::new(),
            canceled: BTreeSet::new(),
            done: BTreeMap::new(),
            attempt: Attempt::default(),
            moving: BTreeSet::new(),
            first: GoalId(next),
            pending: vec![],
            changed: watch::Sender::new(0),
        }
    }

    /// Returns a counter of received states, which notifies its receivers of each new state.
    pub(super) fn changes(&self) -> watch::Receiver<u64> {
        self.changed.subscribe()
    }

    /// Returns the latest telemetry.
    pub(super) fn telemetry(&self) -> Option<&Telemetry> {
        self.latest.as_ref().map(|latest| &latest.telemetry)
    }

    /// Returns the arrival time of the latest state.
    pub(super) fn last_report_at(&self) -> Option<Instant> {
        self.latest.as_ref().map(|latest| latest.arrived)
    }

    /// Returns the time since the latest state, or since creation.
    pub(super) fn silent_for(&self) -> Duration {
        self.last_report_at().unwrap_or(self.since).elapsed()
    }

    /// Checks whether a state has arrived and no goal is in progress, including goals of previous
    /// incarnations of the client.
    pub(super) fn is_idle(&self) -> bool {
        self.latest.is_some() && self.goals.values().all(GoalStatus::is_final)
    }

    /// Returns the status of a goal, if it is still kept.
    pub(super) fn status(&self, goal: GoalId) -> Option<&GoalStatus> {
        self.goals.get(&goal)
    }

    /// Returns the latest values of the feedback of the goal in progress; empty without such a goal.
    pub(super) fn feedback(&self) -> BTreeMap<String, Scalar> {
        let values = self.goals.values().rev().find_map(|status| match status {
            GoalStatus::Executing(feedback) => Some(feedback.values.clone()),
            _ => None,
        });
        values.unwrap_or_default()
    }

    /// Returns the id of the next goal.
    pub(super) fn next_goal(&self) -> GoalId {
        GoalId(self.next)
    }

    /// Starts a goal.
    pub(super) fn start_goal(&mut self, goal: Goal) -> GoalId {
        let id = GoalId(self.next);
        self.next += 1;
        self.goals.insert(id, GoalStatus::Sent);
        while self.goals.len() > GOALS_KEPT {
            self.goals.pop_first();
        }
        if goal.may_move_items() {
            self.moving.insert(id);
        }
        self.pending.push(GoalRequest::Start { id, goal });
        id
    }

    /// Checks whether no goal of the task with this first goal has moved an item. A goal that is in progress,
    /// and a goal of a previous incarnation, may have.
    pub(super) fn moved_nothing(&self, first: GoalId) -> bool {
        let unmoved = |id: &GoalId| match self.goals.get(id) {
            Some(GoalStatus::Aborted(error)) => error.moved_nothing,
            _ => false,
        };
        first >= self.first && self.moving.range(first..).all(unmoved)
    }

    /// Begins an attempt at a task. `first` is the first goal of the task, perhaps of a previous
    /// incarnation of this node.
    pub(super) fn begin_attempt(&mut self, first: GoalId) {
        self.attempt = Attempt { earlier: first.0..self.next, claimed: BTreeSet::new() };
        self.moving = self.moving.split_off(&first);
    }

    /// Cancels a goal in progress. Returns false if it is not in progress.
    pub(super) fn cancel(&mut self, goal: GoalId) -> bool {
        let in_progress = self.goals.get(&goal).is_some_and(|status| !status.is_final());
        if in_progress {
            self.request_cancel(goal);
        }
        in_progress
    }

    /// Cancels all goals in progress.
    pub(super) fn cancel_all(&mut self) {
        let running: Vec<GoalId> = self.goals.iter().filter(|(_, s)| !s.is_final()).map(|(id, _)| *id).collect();
        for id in running {
            self.request_cancel(id);
        }
    }

    /// Lets the robot act until this time; `None` forbids it. Goals that were not started yet wait.
    pub(super) fn allow_until(&mut self, until: Option<NodeTime>) {
        self.allowed_until = until;
    }

    /// Returns the command for a request, with the permission at this instant. While the robot may not
    /// act, it is a heartbeat instead of the start of a goal.
    pub(super) fn command(&self, request: Option<GoalRequest>, now: NodeTime) -> DriverCommand {
        let permit = self.permit(now);
        let is_start = |request: &GoalRequest| matches!(request, GoalRequest::Start { .. });
        let request = request.filter(|request| permit.is_some() || !is_start(request));
        DriverCommand { request, permit: permit.unwrap_or_default() }
    }

    fn permit(&self, now: NodeTime) -> Option<Permit> {
        let (until, latest) = (self.allowed_until?, self.latest.as_ref()?);
        let keep_for = keep_for(until, CLIENT_TIMEOUT, latest.arrived_at, now)?;
        let in_progress = self.goals.iter().filter(|(id, status)| !status.is_final() && !self.canceled.contains(id));
        Some(Permit {
            goals: in_progress.map(|(id, _)| *id).collect(),
            state: self.order.newest(),
            keep_for_ms: u64::try_from(keep_for.as_millis()).unwrap_or(u64::MAX),
        })
    }

    /// Returns the requests without a reply, in the order of sending.
    pub(super) fn pending_requests(&self) -> &[GoalRequest] {
        &self.pending
    }

    /// Removes a request that got a reply.
    pub(super) fn confirm(&mut self, request: &GoalRequest) {
        self.pending.retain(|pending_request| pending_request != request);
    }

    /// Requests the end of a goal. A start request without a reply is no longer repeated: the
    /// server could receive it long after the goal has become obsolete.
    fn request_cancel(&mut self, goal: GoalId) {
        self.canceled.insert(goal);
        self.pending.retain(|request| !matches!(request, GoalRequest::Start { id, .. } if *id == goal));
        let cancel = GoalRequest::Cancel { id: goal };
        if !self.pending.contains(&cancel) {
            self.pending.push(cancel);
        }
    }

    /// Returns the result if an earlier attempt has completed this goal and the current attempt has not
    /// used that yet.
    pub(super) fn claim_completed(&mut self, goal: &Goal) -> Option<GoalResult> {
        let Attempt { earlier, claimed } = &mut self.attempt;
        let mut done = self.done.iter().filter(|(id, (done, _))| earlier.contains(&id.0) && done == goal);
        let (id, (_, result)) = done.find(|(id, _)| !claimed.contains(id))?;
        info!(?goal, "completed by an earlier attempt");
        claimed.insert(*id);
        Some(result.clone())
    }

    /// Applies a state of the server, which has arrived now. Returns true if requests should be sent
    /// at once.
    pub(super) fn apply_state(&mut self, state: DriverState, now: NodeTime) -> bool {
        if !self.order.accept(state.stamp) {
            return false;
        }
        let (telemetry, arrived) = (state.telemetry, Instant::now());
        self.latest = Some(LatestState { telemetry, arrived, arrived_at: now });
        self.done.extend(state.completed.into_iter().map(|(id, goal, result)| (id, (goal, result))));
        while self.done.len() > GOALS_KEPT {
            self.done.pop_first();
        }
        self.canceled.retain(|id| self.goals.contains_key(id));
        let reported: BTreeSet<GoalId> = state.goals.iter().map(|(id, _)| *id).collect();
        let mut has_unknown = false;
        for (id, status) in state.goals {
            match self.goals.get_mut(&id) {
                Some(known) if known.is_final() => {}
                Some(known) => *known = status,
                // A previous incarnation of this node started the goal, and no skill supervises it
                // any more.
                None if !status.is_final() => {
                    self.goals.insert(id, status);
                    self.request_cancel(id);
                    has_unknown = true;
                }
                None => {}
            }
        }
        // A server reports all goals in progress. A restarted server has lost them.
        let pending: BTreeSet<GoalId> = self.pending.iter().map(GoalRequest::goal).collect();
        let known = |id: &GoalId| reported.contains(id) || pending.contains(id);
        for (id, status) in self.goals.iter_mut().filter(|(id, status)| !status.is_final() && !known(id)) {
            let message = format!("the driver server has lost goal {}", id.0);
            *status = GoalStatus::Aborted(ActionError::new(ErrorCode::Unknown, message));
        }
        self.changed.send_modify(|count| *count += 1);
        has_unknown
    }
}

#[cfg(test)]
mod tests {
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
        Goal { action: "pick_up".parse().unwrap(), parameters, repeatable: false, hands_over: None }
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
    fn the_feedback_is_that_of_the_goal_in_progress() {
        let values = BTreeMap::from([("soaked".to_owned(), Scalar::Number(0.5))]);
        let remaining = Feedback::remaining(consort_protocol::units::Metres::ZERO, Seconds::ZERO);
        let soaking = GoalStatus::Executing(Feedback { values: values.clone(), ..remaining });
        let mut tracker = GoalTracker::new(100);
        for _ in 0..2 {
            tracker.start_goal(Goal::from(Wait { time: Seconds::ZERO }));
        }
        assert_eq!(tracker.feedback(), BTreeMap::new(), "no goal has begun");
        tracker.apply_state(state(1, &[(100, GoalStatus::succeeded()), (101, soaking)]), at(0));
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
}
