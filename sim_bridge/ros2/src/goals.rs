//! The rules of a ROS 2 action server, as a value: which goals there are, how they stand, and what is answered to whoever
//! asks to cancel them or for their results. What is decided follows `rcl_action`; time comes in from outside.
//!
//! ```text
//!  accept ─▶ executing ──────────────▶ succeeded, aborted
//!                └─ cancel ─▶ canceling ─▶ canceled, succeeded, aborted ─▶ forgotten after a while
//! ```

use crate::messages::Time;
use std::collections::BTreeMap;
use std::time::Duration;

/// Names a goal among all of all clients.
pub type Uuid = [u8; 16];

/// How a goal ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// As asked.
    Succeeded,
    /// Because somebody asked for that.
    Canceled,
    /// Otherwise.
    Aborted,
}

/// How a goal stands: `action_msgs/GoalStatus`, whose number it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(i8)]
pub enum Status {
    /// There is no such goal, or there was one long ago.
    Unknown = 0,
    /// Under way.
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

/// What is answered to a wish to cancel: `action_msgs/srv/CancelGoal`, whose number it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(i8)]
pub enum CancelCode {
    /// The goals named are being stopped; none, if none was under way.
    Done = 0,
    /// No such goal.
    UnknownGoal = 2,
    /// It has ended.
    Terminated = 3,
}

/// The goals of one action server, with results `R`.
#[derive(Debug)]
pub struct Goals<R> {
    entries: BTreeMap<Uuid, Entry<R>>,
    kept: Duration,
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
    Ended { how: Ending, result: R, forget_at: Duration },
}

impl<R> Entry<R> {
    fn status(&self) -> Status {
        match &self.state {
            State::Executing => Status::Executing,
            State::Canceling => Status::Canceling,
            State::Ended { how: Ending::Succeeded, .. } => Status::Succeeded,
            State::Ended { how: Ending::Canceled, .. } => Status::Canceled,
            State::Ended { how: Ending::Aborted, .. } => Status::Aborted,
        }
    }
}

impl<R: Clone + Default> Goals<R> {
    /// No goals yet. Results can be asked for during `kept` after the end; longer costs memory.
    pub fn new(kept: Duration) -> Goals<R> {
        Goals { entries: BTreeMap::new(), kept }
    }

    /// Takes a goal on. False for one that was here before: it is rejected, and nothing has changed.
    pub fn accept(&mut self, goal: Uuid, at: Time) -> bool {
        let fresh = !self.entries.contains_key(&goal);
        if fresh {
            self.entries.insert(goal, Entry { accepted: at, state: State::Executing });
        }
        fresh
    }

    /// A client wishes to cancel: the goal named, or all if none is; with a time, all that were accepted up to then, too.
    /// Returns the answer and the goals that are to be stopped by now, with when they were accepted.
    pub fn cancel(&mut self, goal: Uuid, up_to: Time) -> (CancelCode, Vec<(Uuid, Time)>) {
        let named = goal != Uuid::default();
        let timed = up_to != Time::default();
        let code = match self.entries.get(&goal).map(|entry| &entry.state) {
            None if named => CancelCode::UnknownGoal,
            Some(State::Ended { .. }) => CancelCode::Terminated,
            Some(State::Executing | State::Canceling) | None => CancelCode::Done,
        };
        let mut stopping = Vec::new();
        for (id, entry) in &mut self.entries {
            let meant = if named { *id == goal } else { !timed };
            let meant = meant || timed && entry.accepted <= up_to;
            if meant && matches!(entry.state, State::Executing | State::Canceling) {
                entry.state = State::Canceling;
                stopping.push((*id, entry.accepted));
            }
        }
        (code, stopping)
    }

    /// A goal has ended. False if it is not under way: nothing has changed.
    pub fn end(&mut self, goal: Uuid, how: Ending, result: R, now: Duration) -> bool {
        let Some(entry) = self.entries.get_mut(&goal) else { return false };
        if matches!(entry.state, State::Ended { .. }) {
            return false;
        }
        entry.state = State::Ended { how, result, forget_at: now + self.kept };
        true
    }

    /// How a goal ended and with what result; `None` while it is under way. Of a goal that is not known there is no result
    /// either, which is said at once.
    pub fn result(&self, goal: Uuid) -> Option<(Status, R)> {
        let Some(entry) = self.entries.get(&goal) else { return Some((Status::Unknown, R::default())) };
        match &entry.state {
            State::Ended { result, .. } => Some((entry.status(), result.clone())),
            State::Executing | State::Canceling => None,
        }
    }

    /// Whether a goal is under way.
    pub fn is_under_way(&self, goal: Uuid) -> bool {
        self.entries.get(&goal).is_some_and(|entry| !matches!(entry.state, State::Ended { .. }))
    }

    /// Forgets what has ended long ago. True if there was any.
    pub fn forget(&mut self, now: Duration) -> bool {
        let before = self.entries.len();
        self.entries.retain(|_, entry| !matches!(entry.state, State::Ended { forget_at, .. } if forget_at <= now));
        self.entries.len() < before
    }

    /// How all of them stand, with when they were accepted.
    pub fn statuses(&self) -> impl Iterator<Item = (Uuid, Time, Status)> {
        self.entries.iter().map(|(id, entry)| (*id, entry.accepted, entry.status()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEPT: Duration = Duration::from_secs(10);

    fn at(sec: i32) -> Time {
        Time { sec, nanosec: 0 }
    }

    fn id(number: u8) -> Uuid {
        [number; 16]
    }

    /// Goals 1, 2 and 3, accepted at 10, 20 and 30 s, of which 2 has succeeded.
    fn three() -> Goals<&'static str> {
        let mut goals = Goals::new(KEPT);
        for number in 1..=3 {
            assert!(goals.accept(id(number), at(i32::from(number) * 10)));
        }
        assert!(goals.end(id(2), Ending::Succeeded, "there", Duration::ZERO));
        goals
    }

    fn statuses(goals: &Goals<&'static str>) -> Vec<(u8, Status)> {
        goals.statuses().map(|(id, _, status)| (id[0], status)).collect()
    }

    #[test]
    fn a_goal_is_taken_on_once() {
        let mut goals = three();
        assert!(!goals.accept(id(1), at(40)) && !goals.accept(id(2), at(40)));
        let expected = [(1, Status::Executing), (2, Status::Succeeded), (3, Status::Executing)];
        assert_eq!(statuses(&goals), expected);
    }

    #[test]
    fn one_goal_is_canceled_by_name() {
        let mut goals = three();
        assert_eq!(goals.cancel(id(3), at(0)), (CancelCode::Done, vec![(id(3), at(30))]));
        assert_eq!(goals.cancel(id(3), at(0)).0, CancelCode::Done, "asked for again");
        assert_eq!(goals.cancel(id(2), at(0)), (CancelCode::Terminated, vec![]));
        assert_eq!(goals.cancel(id(9), at(0)), (CancelCode::UnknownGoal, vec![]));
        let expected = [(1, Status::Executing), (2, Status::Succeeded), (3, Status::Canceling)];
        assert_eq!(statuses(&goals), expected);
    }

    #[test]
    fn no_name_means_all_and_a_time_those_up_to_then() {
        let all = vec![(id(1), at(10)), (id(3), at(30))];
        assert_eq!(three().cancel(id(0), at(0)), (CancelCode::Done, all));
        assert_eq!(three().cancel(id(0), at(20)), (CancelCode::Done, vec![(id(1), at(10))]));
        assert_eq!(three().cancel(id(0), at(5)), (CancelCode::Done, vec![]));
        let both = vec![(id(1), at(10)), (id(3), at(30))];
        assert_eq!(three().cancel(id(3), at(10)), (CancelCode::Done, both), "one by name, one by time");
    }

    #[test]
    fn a_result_is_there_once_the_goal_has_ended_and_the_first_end_counts() {
        let mut goals = three();
        assert_eq!(goals.result(id(1)), None);
        assert_eq!(goals.result(id(2)), Some((Status::Succeeded, "there")));
        assert_eq!(goals.result(id(9)), Some((Status::Unknown, "")));
        assert!(!goals.end(id(2), Ending::Aborted, "late", Duration::ZERO));
        assert!(!goals.end(id(9), Ending::Aborted, "never", Duration::ZERO));
        goals.cancel(id(1), at(0));
        assert!(goals.is_under_way(id(1)));
        assert!(goals.end(id(1), Ending::Canceled, "stopped", Duration::ZERO));
        assert_eq!(goals.result(id(1)), Some((Status::Canceled, "stopped")));
        assert!(!goals.is_under_way(id(1)));
    }

    #[test]
    fn what_has_ended_is_forgotten_after_a_while_and_what_has_not_is_not() {
        let mut goals = three();
        assert!(!goals.forget(KEPT - Duration::from_millis(1)));
        assert!(goals.forget(KEPT));
        assert_eq!(statuses(&goals), [(1, Status::Executing), (3, Status::Executing)]);
        assert_eq!(goals.result(id(2)), Some((Status::Unknown, "")));
    }
}
