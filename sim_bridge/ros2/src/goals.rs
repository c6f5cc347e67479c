//! The rules of a ROS 2 action server as a state machine: its goals, their states, and the replies
//! to requests to cancel a goal or to return its result. The rules follow `rcl_action`; time is
//! passed in.
//!
//! ```text
//!  accept ─▶ executing ──────────────▶ succeeded, aborted
//!                └─ cancel ─▶ canceling ─▶ canceled, succeeded, aborted ─▶ removed after a while
//! ```

use crate::messages::Time;
use std::collections::BTreeMap;
use std::time::Duration;

/// Identifies a goal among the goals of all clients.
pub type GoalUuid = [u8; 16];

/// Final state of a goal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EndState {
    /// Reached.
    Succeeded,
    /// Ended by a cancel request.
    Canceled,
    /// Ended otherwise.
    Aborted,
}

/// State of a goal: `action_msgs/GoalStatus`, with its number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(i8)]
pub enum Status {
    /// The goal does not exist, or was removed.
    Unknown = 0,
    /// The goal is in progress.
    Executing = 2,
    /// Being stopped.
    Canceling = 3,
    /// [`Ending::Succeeded`].
    Succeeded = 4,
    /// [`Ending::Canceled`].
    Canceled = 5,
    /// [`Ending::Aborted`].
    Aborted = 6,
}

/// Reply to a cancel request: `action_msgs/srv/CancelGoal`, with its number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(i8)]
pub enum CancelCode {
    /// The requested goals are being canceled; empty if none was in progress.
    Done = 0,
    /// The goal does not exist.
    UnknownGoal = 2,
    /// The goal has ended.
    Terminated = 3,
}

/// The goals of an action server, with results `R`.
#[derive(Debug)]
pub struct GoalTable<R> {
    entries: BTreeMap<GoalUuid, Entry<R>>,
    retention: Duration,
}

#[derive(Debug)]
struct Entry<R> {
    accepted: Time,
    state: State<R>,
}

#[derive(Debug)]
enum State<R> {
    Executing,
    Canceling,
    Ended { how: EndState, result: R, remove_at: Duration },
}

impl<R> Entry<R> {
    fn status(&self) -> Status {
        match &self.state {
            State::Executing => Status::Executing,
            State::Canceling => Status::Canceling,
            State::Ended { how: EndState::Succeeded, .. } => Status::Succeeded,
            State::Ended { how: EndState::Canceled, .. } => Status::Canceled,
            State::Ended { how: EndState::Aborted, .. } => Status::Aborted,
        }
    }
}

impl<R: Clone + Default> GoalTable<R> {
    /// Creates an empty table. Results remain available for `kept` after the end; a longer time
    /// costs memory.
    pub fn new(retention: Duration) -> GoalTable<R> {
        GoalTable { entries: BTreeMap::new(), retention }
    }

    /// Accepts a goal. Returns false for an existing goal: it is rejected, and nothing has changed.
    pub fn accept(&mut self, goal: GoalUuid, at: Time) -> bool {
        let fresh = !self.entries.contains_key(&goal);
        if fresh {
            self.entries.insert(goal, Entry { accepted: at, state: State::Executing });
        }
        fresh
    }

    /// Handles a cancel request: for the given goal, or for all goals if none is given. With a
    /// time, it applies to all goals accepted up to that time as well. Returns the reply and the
    /// goals that are now being canceled, with the time of their acceptance.
    pub fn cancel(&mut self, goal: GoalUuid, up_to: Time) -> (CancelCode, Vec<(GoalUuid, Time)>) {
        let named = goal != GoalUuid::default();
        let timed = up_to != Time::default();
        let code = match self.entries.get(&goal).map(|entry| &entry.state) {
            None if named => CancelCode::UnknownGoal,
            Some(State::Ended { .. }) => CancelCode::Terminated,
            Some(State::Executing | State::Canceling) | None => CancelCode::Done,
        };
        let mut stopping = Vec::new();
        for (id, entry) in &mut self.entries {
            let requested = if named { *id == goal } else { !timed };
            let requested = requested || timed && entry.accepted <= up_to;
            if requested && matches!(entry.state, State::Executing | State::Canceling) {
                entry.state = State::Canceling;
                stopping.push((*id, entry.accepted));
            }
        }
        (code, stopping)
    }

    /// Ends a goal. Returns false if it is not in progress: nothing has changed.
    pub fn end(&mut self, goal: GoalUuid, how: EndState, result: R, now: Duration) -> bool {
        let Some(entry) = self.entries.get_mut(&goal) else { return false };
        if matches!(entry.state, State::Ended { .. }) {
            return false;
        }
        entry.state = State::Ended { how, result, remove_at: now + self.retention };
        true
    }

    /// Returns the final state and the result of a goal; `None` while it is in progress. For an
    /// unknown goal it returns a default result at once.
    pub fn result(&self, goal: GoalUuid) -> Option<(Status, R)> {
        let Some(entry) = self.entries.get(&goal) else { return Some((Status::Unknown, R::default())) };
        match &entry.state {
            State::Ended { result, .. } => Some((entry.status(), result.clone())),
            State::Executing | State::Canceling => None,
        }
    }

    /// Checks whether a goal is in progress.
    pub fn is_in_progress(&self, goal: GoalUuid) -> bool {
        self.entries.get(&goal).is_some_and(|entry| !matches!(entry.state, State::Ended { .. }))
    }

    /// Removes goals that ended long ago. Returns true if there were any.
    pub fn remove_expired(&mut self, now: Duration) -> bool {
        let before = self.entries.len();
        self.entries.retain(|_, entry| !matches!(entry.state, State::Ended { remove_at, .. } if remove_at <= now));
        self.entries.len() < before
    }

    /// Returns the state of every goal, with the time of its acceptance.
    pub fn statuses(&self) -> impl Iterator<Item = (GoalUuid, Time, Status)> {
        self.entries.iter().map(|(id, entry)| (*id, entry.accepted, entry.status()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RETENTION: Duration = Duration::from_secs(10);

    fn at(sec: i32) -> Time {
        Time { sec, nanosec: 0 }
    }

    fn id(number: u8) -> GoalUuid {
        [number; 16]
    }

    /// Returns goals 1, 2 and 3, accepted at 10, 20 and 30 s; goal 2 has succeeded.
    fn three() -> GoalTable<&'static str> {
        let mut goals = GoalTable::new(RETENTION);
        for number in 1..=3 {
            assert!(goals.accept(id(number), at(i32::from(number) * 10)));
        }
        assert!(goals.end(id(2), EndState::Succeeded, "there", Duration::ZERO));
        goals
    }

    fn statuses(goals: &GoalTable<&'static str>) -> Vec<(u8, Status)> {
        goals.statuses().map(|(id, _, status)| (id[0], status)).collect()
    }

    #[test]
    fn a_goal_is_accepted_once() {
        let mut goals = three();
        assert!(!goals.accept(id(1), at(40)) && !goals.accept(id(2), at(40)));
        let expected = [(1, Status::Executing), (2, Status::Succeeded), (3, Status::Executing)];
        assert_eq!(statuses(&goals), expected);
    }

    #[test]
    fn a_goal_is_canceled_by_name() {
        let mut goals = three();
        assert_eq!(goals.cancel(id(3), at(0)), (CancelCode::Done, vec![(id(3), at(30))]));
        assert_eq!(goals.cancel(id(3), at(0)).0, CancelCode::Done, "a repeated request");
        assert_eq!(goals.cancel(id(2), at(0)), (CancelCode::Terminated, vec![]));
        assert_eq!(goals.cancel(id(9), at(0)), (CancelCode::UnknownGoal, vec![]));
        let expected = [(1, Status::Executing), (2, Status::Succeeded), (3, Status::Canceling)];
        assert_eq!(statuses(&goals), expected);
    }

    #[test]
    fn a_cancel_without_id_applies_to_all_or_to_earlier_goals() {
        let all = vec![(id(1), at(10)), (id(3), at(30))];
        assert_eq!(three().cancel(id(0), at(0)), (CancelCode::Done, all));
        assert_eq!(three().cancel(id(0), at(20)), (CancelCode::Done, vec![(id(1), at(10))]));
        assert_eq!(three().cancel(id(0), at(5)), (CancelCode::Done, vec![]));
        let both = vec![(id(1), at(10)), (id(3), at(30))];
        assert_eq!(three().cancel(id(3), at(10)), (CancelCode::Done, both), "the first by name, the other by time");
    }

    #[test]
    fn a_result_exists_after_the_end_and_never_changes() {
        let mut goals = three();
        assert_eq!(goals.result(id(1)), None);
        assert_eq!(goals.result(id(2)), Some((Status::Succeeded, "there")));
        assert_eq!(goals.result(id(9)), Some((Status::Unknown, "")));
        assert!(!goals.end(id(2), EndState::Aborted, "late", Duration::ZERO));
        assert!(!goals.end(id(9), EndState::Aborted, "never", Duration::ZERO));
        goals.cancel(id(1), at(0));
        assert!(goals.is_in_progress(id(1)));
        assert!(goals.end(id(1), EndState::Canceled, "stopped", Duration::ZERO));
        assert_eq!(goals.result(id(1)), Some((Status::Canceled, "stopped")));
        assert!(!goals.is_in_progress(id(1)));
    }

    #[test]
    fn ended_goals_are_removed_after_the_retention_time() {
        let mut goals = three();
        assert!(!goals.remove_expired(RETENTION - Duration::from_millis(1)));
        assert!(goals.remove_expired(RETENTION));
        assert_eq!(statuses(&goals), [(1, Status::Executing), (3, Status::Executing)]);
        assert_eq!(goals.result(id(2)), Some((Status::Unknown, "")));
    }
}
