//! What a driver knows of its body without asking, and what it has ordered and was not answered, as a value.

use super::messages::{DriverState, GoalRequest};
use consort_skills::actions::{ActionError, ErrorCode, Goal, GoalId, GoalStatus, Telemetry};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;
use tracing::info;

/// Final states of goals that are remembered.
const REMEMBERED: usize = 32;

/// What a driver knows of its body, and has ordered.
pub(super) struct GoalTracker {
    next: u64,
    telemetry: Option<Telemetry>,
    /// When it was heard.
    heard_at: Option<Instant>,
    /// Since when there is a mirror.
    since: Instant,
    number: u64,
    goals: BTreeMap<GoalId, GoalStatus>,
    /// Goals that were done and must not be done again, those of former lives of this node included.
    done: BTreeMap<GoalId, Goal>,
    attempt: Attempt,
    /// Orders that the host has not answered, in the order given.
    unanswered: Vec<GoalRequest>,
    changed: watch::Sender<u64>,
}

/// An attempt at a task: what earlier attempts at it have done is not done again.
#[derive(Default)]
struct Attempt {
    /// The goals of earlier attempts, and of none but them, lie in between.
    earlier: std::ops::Range<u64>,
    /// Those of them that this attempt has come upon.
    claimed: BTreeSet<GoalId>,
}

impl GoalTracker {
    /// Nothing was heard yet; ids of goals begin with `next`.
    pub(super) fn new(next: u64) -> GoalTracker {
        GoalTracker {
            next,
            telemetry: None,
            heard_at: None,
            since: Instant::now(),
            number: 0,
            goals: BTreeMap::new(),
            done: BTreeMap::new(),
            attempt: Attempt::default(),
            unanswered: vec![],
            changed: watch::Sender::new(0),
        }
    }

    /// Counts the states heard; wakes whoever waits for the next.
    pub(super) fn changes(&self) -> watch::Receiver<u64> {
        self.changed.subscribe()
    }

    /// The latest report of the body.
    pub(super) fn telemetry(&self) -> Option<&Telemetry> {
        self.telemetry.as_ref()
    }

    /// When it was heard.
    pub(super) fn last_report_at(&self) -> Option<Instant> {
        self.heard_at
    }

    /// How long the body has reported nothing.
    pub(super) fn silent_for(&self) -> Duration {
        self.heard_at.unwrap_or(self.since).elapsed()
    }

    /// Whether the body has been heard of and has nothing under way, neither of this life of its driver nor of a former one.
    pub(super) fn is_idle(&self) -> bool {
        self.telemetry.is_some() && self.goals.values().all(GoalStatus::is_final)
    }

    /// What has become of a goal, if it is remembered.
    pub(super) fn status(&self, goal: GoalId) -> Option<&GoalStatus> {
        self.goals.get(&goal)
    }

    /// The goal that is begun next.
    pub(super) fn next_goal(&self) -> GoalId {
        GoalId(self.next)
    }

    /// Orders a goal.
    pub(super) fn start_goal(&mut self, goal: Goal) -> GoalId {
        let id = GoalId(self.next);
        self.next += 1;
        self.goals.insert(id, GoalStatus::Sent);
        while self.goals.len() > REMEMBERED {
            self.goals.pop_first();
        }
        self.unanswered.push(GoalRequest::Start { id, goal });
        id
    }

    /// An attempt begins at a task whose first goal was this one, perhaps in a former life of this node.
    pub(super) fn begin_attempt(&mut self, first: GoalId) {
        self.attempt = Attempt { earlier: first.0..self.next, claimed: BTreeSet::new() };
    }

    /// Orders a goal under way to end. False if it is not.
    pub(super) fn cancel(&mut self, goal: GoalId) -> bool {
        let under_way = self.goals.get(&goal).is_some_and(|status| !status.is_final());
        if under_way {
            self.call_off(goal);
        }
        under_way
    }

    /// Orders all goals under way to end.
    pub(super) fn cancel_all(&mut self) {
        let running: Vec<GoalId> = self.goals.iter().filter(|(_, s)| !s.is_final()).map(|(id, _)| *id).collect();
        for id in running {
            self.call_off(id);
        }
    }

    /// Orders that the host has not answered, in the order given.
    pub(super) fn pending_requests(&self) -> &[GoalRequest] {
        &self.unanswered
    }

    /// The host has answered an order.
    pub(super) fn confirm(&mut self, order: &GoalRequest) {
        self.unanswered.retain(|waiting| waiting != order);
    }

    /// Orders a goal to end. If the order to begin it was not answered, it is not repeated: the host may hear of the goal
    /// only now, long after it ceased to be wanted.
    fn call_off(&mut self, goal: GoalId) {
        self.unanswered.retain(|order| !matches!(order, GoalRequest::Start { id, .. } if *id == goal));
        let cancel = GoalRequest::Cancel { id: goal };
        if !self.unanswered.contains(&cancel) {
            self.unanswered.push(cancel);
        }
    }

    /// Whether an earlier attempt has done this goal and the present one has not come upon that yet.
    pub(super) fn claim_completed(&mut self, goal: &Goal) -> bool {
        let Attempt { earlier, claimed } = &mut self.attempt;
        let mut done = self.done.iter().filter(|(id, done)| earlier.contains(&id.0) && *done == goal);
        let found = done.find(|(id, _)| !claimed.contains(id)).map(|(id, _)| *id);
        if let Some(id) = found {
            info!(?goal, "was done already by an earlier attempt");
            claimed.insert(id);
        }
        found.is_some()
    }

    /// Takes in what the host reports. True if there is something to order at once.
    pub(super) fn apply_state(&mut self, state: DriverState) -> bool {
        if state.sequence <= self.number && self.number - state.sequence < 1 << 32 {
            return false; // overtaken by a later one; a number far below is a host that started anew
        }
        self.number = state.sequence;
        self.telemetry = Some(state.telemetry);
        self.heard_at = Some(Instant::now());
        self.done.extend(state.completed);
        while self.done.len() > REMEMBERED {
            self.done.pop_first();
        }
        let told: BTreeSet<GoalId> = state.goals.iter().map(|(id, _)| *id).collect();
        let mut strangers = false;
        for (id, status) in state.goals {
            match self.goals.get_mut(&id) {
                Some(known) if known.is_final() => {}
                Some(known) => *known = status,
                // A former life of this node set it going, and nobody watches over it any more.
                None if !status.is_final() => {
                    self.goals.insert(id, status);
                    self.call_off(id);
                    strangers = true;
                }
                None => {}
            }
        }
        // A host tells of what is under way: one that has started anew knows nothing of it.
        let unanswered: BTreeSet<GoalId> = self.unanswered.iter().map(GoalRequest::goal).collect();
        let known = |id: &GoalId| told.contains(id) || unanswered.contains(id);
        for (id, status) in self.goals.iter_mut().filter(|(id, status)| !status.is_final() && !known(id)) {
            let message = format!("the host of the body no longer knows of goal {}", id.0);
            *status = GoalStatus::Aborted(ActionError { code: ErrorCode::Unknown, message });
        }
        self.changed.send_modify(|count| *count += 1);
        strangers
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::pose::Pose;
    use consort_protocol::units::{BatteryShare, Seconds, WorldTime};
    use consort_skills::actions::Feedback;

    fn executing() -> GoalStatus {
        let distance_remaining = consort_protocol::units::Metres::ZERO;
        GoalStatus::Executing(Feedback::remaining(distance_remaining, Seconds::ZERO))
    }

    fn state(number: u64, goals: &[(u64, GoalStatus)]) -> DriverState {
        let telemetry = Telemetry {
            time: WorldTime::ZERO,
            pose: Pose::default(),
            place: "Dock".parse().unwrap(),
            battery: BatteryShare::FULL,
            able: true,
            closed: vec![],
        };
        let goals = goals.iter().map(|(id, status)| (GoalId(*id), status.clone())).collect();
        DriverState { robot: "ada".parse().unwrap(), sequence: number, telemetry, goals, completed: vec![] }
    }

    #[test]
    fn what_an_earlier_attempt_at_the_task_has_done_is_done_once_for_each_time() {
        let mut mirror = GoalTracker::new(100);
        let pick_up = |from: &str| Goal::PickUp { from: from.parse().unwrap() };
        // Goal 5 is of a task that has ended; 6 and 7 are of a former life, and 101 of this one.
        let done = [(5, "amber"), (6, "birch"), (7, "amber"), (101, "amber")];
        let done = done.map(|(id, from)| (GoalId(id), pick_up(from)));
        mirror.apply_state(DriverState { completed: done.to_vec(), ..state(1, &[]) });
        assert!(!mirror.claim_completed(&pick_up("amber")), "nothing was begun");
        let attempt = |next: u64| Attempt { earlier: 6..next, claimed: BTreeSet::new() };
        mirror.attempt = attempt(100);
        assert!(!mirror.claim_completed(&pick_up("clove")));
        assert_eq!([(); 2].map(|()| mirror.claim_completed(&pick_up("amber"))), [true, false]);
        assert_eq!([(); 2].map(|()| mirror.claim_completed(&pick_up("birch"))), [true, false]);
        mirror.attempt = attempt(102);
        assert_eq!(
            [(); 3].map(|()| mirror.claim_completed(&pick_up("amber"))),
            [true, true, false],
            "the third attempt"
        );
    }

    #[test]
    fn what_a_former_life_set_going_is_called_off() {
        let mut mirror = GoalTracker::new(100);
        assert!(mirror.apply_state(state(1, &[(6, GoalStatus::Succeeded), (7, executing())])));
        assert_eq!(mirror.unanswered, [GoalRequest::Cancel { id: GoalId(7) }]);
        assert!(!mirror.goals[&GoalId(7)].is_final());
        mirror.unanswered.clear();
        assert!(!mirror.apply_state(state(2, &[(6, GoalStatus::Succeeded), (7, GoalStatus::Canceled)])));
        assert!(mirror.goals.values().all(GoalStatus::is_final));
    }

    #[test]
    fn a_host_that_started_anew_has_lost_what_was_under_way_and_not_what_it_has_yet_to_hear_of() {
        let mut mirror = GoalTracker::new(100);
        mirror.goals = BTreeMap::from([(GoalId(100), executing()), (GoalId(101), GoalStatus::Sent)]);
        mirror.unanswered = vec![GoalRequest::Start { id: GoalId(101), goal: Goal::Wait { time: Seconds::ZERO } }];
        assert!(!mirror.apply_state(state(1, &[(100, executing())])));
        assert_eq!(mirror.goals[&GoalId(100)], executing());
        assert!(!mirror.apply_state(state(2, &[])));
        assert!(matches!(&mirror.goals[&GoalId(100)], GoalStatus::Aborted(error) if error.code == ErrorCode::Unknown));
        assert_eq!(mirror.goals[&GoalId(101)], GoalStatus::Sent);
    }
}
