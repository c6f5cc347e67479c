//! The goal tracker: latest state of a driver and requests without a reply, as a value.

use super::CLIENT_TIMEOUT;
use super::messages::{DriverCommand, DriverState, GoalRequest, Permit, feedback_of};
use super::state_order::StateOrder;
use consort_protocol::ids::ActionName;
use consort_protocol::lease::{keep_for, stop_lead};
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

/// Number of restarts of the server during a goal after each of which the goal is started again; after another it fails, since
/// it may be the cause.
const RESUMPTIONS_MAX: u32 = 3;

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
    /// Contents of the goals of this incarnation in progress, and how often each was started again.
    contents: BTreeMap<GoalId, (Goal, u32)>,
    /// Canceled goals, until their end is reported.
    canceled: BTreeSet<GoalId>,
    /// Completed goals that must not be repeated, including those of previous incarnations of this
    /// node.
    done: BTreeMap<GoalId, (Goal, GoalResult)>,
    attempt: Attempt,
    /// Goals of this incarnation that may move items.
    moving: BTreeSet<GoalId>,
    /// Time by which the permission of a goal ends before the lease, by action, where it is not zero.
    stop_leads: BTreeMap<ActionName, Duration>,
    /// Time by which the permission ends before the lease, for goals of this incarnation with such an action.
    slow: BTreeMap<GoalId, Duration>,
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

impl Attempt {
    /// Returns the first goal of the task, if there are earlier attempts.
    fn since(&self) -> Option<GoalId> {
        (!self.earlier.is_empty()).then_some(GoalId(self.earlier.start))
    }
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
            contents: BTreeMap::new(),
            canceled: BTreeSet::new(),
            done: BTreeMap::new(),
            attempt: Attempt::default(),
            moving: BTreeSet::new(),
            stop_leads: BTreeMap::new(),
            slow: BTreeMap::new(),
            first: GoalId(next),
            pending: vec![],
            changed: watch::Sender::new(0),
        }
    }

    /// Stops goals of these actions before the end of the lease. The times are those from the cancel of a goal to
    /// its end.
    pub(super) fn with_cancel_times(self, times: &BTreeMap<ActionName, Duration>) -> GoalTracker {
        let leads = times.iter().map(|(action, time)| (action.clone(), stop_lead(*time)));
        GoalTracker { stop_leads: leads.filter(|(_, lead)| !lead.is_zero()).collect(), ..self }
    }

    /// Returns the time by which the permission of the goals in progress ends before the lease. A goal of a
    /// previous incarnation may be of any action, and may be in progress before the first state.
    pub(super) fn stop_lead(&self) -> Duration {
        let longest = || self.stop_leads.values().max().copied().unwrap_or_default();
        if self.latest.is_none() {
            return longest();
        }
        let lead = |id: &GoalId| match self.slow.get(id) {
            Some(lead) => *lead,
            None if *id < self.first => longest(),
            None => Duration::ZERO,
        };
        let in_progress = self.goals.iter().filter(|(_, status)| !status.is_final());
        in_progress.map(|(id, _)| lead(id)).max().unwrap_or_default()
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
        feedback_of(self.goals.values())
    }

    /// Returns the id of the next goal.
    pub(super) fn next_goal(&self) -> GoalId {
        GoalId(self.next)
    }

    /// Starts a goal. A previous incarnation may have begun it, if it belongs to the task of the attempt.
    pub(super) fn start_goal(&mut self, mut goal: Goal) -> GoalId {
        let id = GoalId(self.next);
        self.next += 1;
        self.goals.insert(id, GoalStatus::Sent);
        while self.goals.len() > GOALS_KEPT {
            self.goals.pop_first();
        }
        self.slow.retain(|id, _| self.goals.contains_key(id));
        self.slow.extend(self.stop_leads.get(&goal.action).map(|lead| (id, *lead)));
        if goal.may_move_items() {
            self.moving.insert(id);
        }
        goal.since = self.attempt.since().filter(|since| *since < self.first && !goal.repeatable);
        self.contents.insert(id, (goal.clone(), 0));
        self.pending.push(GoalRequest::Start { id, goal });
        id
    }

    /// Starts a goal again that the server has lost in a restart. The driver may have begun it. Returns false if it has failed.
    fn resume(&mut self, id: GoalId) -> bool {
        let content = self.contents.get_mut(&id).filter(|(_, resumptions)| *resumptions < RESUMPTIONS_MAX);
        let Some((goal, resumptions)) = content else { return false };
        *resumptions += 1;
        goal.since = goal.since.or(Some(id)).filter(|_| !goal.repeatable);
        info!(goal = id.0, "started again after a restart of the driver server");
        self.pending.push(GoalRequest::Start { id, goal: goal.clone() });
        self.goals.insert(id, GoalStatus::Sent);
        true
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
    /// act, it is a heartbeat instead of the start of a goal. The same holds for a goal that was canceled while its request
    /// waited: the permission may be that of the next activity.
    pub(super) fn command(&self, request: Option<GoalRequest>, now: NodeTime) -> DriverCommand {
        let permit = self.permit(now);
        let may_send = |request: &GoalRequest| match request {
            GoalRequest::Start { id, .. } => permit.is_some() && !self.canceled.contains(id),
            GoalRequest::Cancel { .. } => true,
        };
        let request = request.filter(may_send);
        DriverCommand { request, permit: permit.unwrap_or_default() }
    }

    fn permit(&self, now: NodeTime) -> Option<Permit> {
        let (until, latest) = (self.allowed_until?, self.latest.as_ref()?);
        let until = until.earlier_by(self.stop_lead());
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
        let boot = self.latest.as_ref().map(|_| self.order.newest().boot);
        if !self.order.accept(state.stamp) {
            return false;
        }
        let has_restarted = boot.is_some_and(|boot| boot != state.stamp.boot);
        let (telemetry, arrived) = (state.telemetry, Instant::now());
        self.latest = Some(LatestState { telemetry, arrived, arrived_at: now });
        let done = |(id, goal, result)| (id, (Goal { since: None, ..goal }, result));
        self.done.extend(state.completed.into_iter().map(done));
        while self.done.len() > GOALS_KEPT {
            self.done.pop_first();
        }
        self.canceled.retain(|id| self.goals.contains_key(id));
        let reported: BTreeSet<GoalId> = state.goals.iter().map(|(id, _)| *id).collect();
        let mut must_send = false;
        for (id, status) in state.goals {
            match self.goals.get_mut(&id) {
                Some(known) if known.is_final() => {}
                Some(known) => *known = status,
                // A previous incarnation of this node started the goal, and no skill supervises it
                // any more.
                None if !status.is_final() => {
                    self.goals.insert(id, status);
                    self.request_cancel(id);
                    must_send = true;
                }
                None => {}
            }
        }
        // A server reports all goals in progress. A restarted server may have lost them.
        let pending: BTreeSet<GoalId> = self.pending.iter().map(GoalRequest::goal).collect();
        let is_lost = |(id, status): &(&GoalId, &GoalStatus)| {
            !status.is_final() && !reported.contains(*id) && !pending.contains(*id)
        };
        let lost: Vec<GoalId> = self.goals.iter().filter(is_lost).map(|(id, _)| *id).collect();
        for id in lost {
            if has_restarted && !self.canceled.contains(&id) && self.resume(id) {
                must_send = true;
                continue;
            }
            let message = format!("the driver server has lost goal {}", id.0);
            self.goals.insert(id, GoalStatus::Aborted(ActionError::new(ErrorCode::Unknown, message)));
        }
        self.contents.retain(|id, _| self.goals.get(id).is_some_and(|status| !status.is_final()));
        self.changed.send_modify(|count| *count += 1);
        must_send
    }
}

#[cfg(test)]
mod tests;
