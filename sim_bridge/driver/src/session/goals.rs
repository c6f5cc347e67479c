//! The goals of a session: at most one in progress, and the latest that have ended.

use consort_protocol::units::{Metres, Seconds};
use consort_skills::actions::{Feedback, Goal, GoalId, GoalStatus};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// Number of ended goals with a known status.
const ENDED_GOALS_KEPT: usize = 32;

/// Number of permissions that are kept: those of goals that have not started yet.
const PERMITS_KEPT: usize = 8;

/// A goal that has ended.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct GoalOutcome {
    /// The goal.
    pub(crate) id: GoalId,
    /// Its final status.
    pub(crate) status: GoalStatus,
}

/// Progress of the goal that has not ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Progress {
    /// Waits for a process, since this time.
    Waiting {
        /// Time of the start, or of the interruption.
        since: Duration,
    },
    /// Sent to the process.
    Active,
    /// A cancel message was sent.
    Stopping {
        /// Time of the message.
        since: Duration,
    },
}

/// The goals.
#[derive(Debug, Clone, Default)]
pub(super) struct Goals {
    current: Option<CurrentGoal>,
    ended: VecDeque<(GoalId, Goal, GoalStatus)>,
    /// Ended goals that were not taken yet.
    outcomes: Vec<GoalOutcome>,
    /// Ends of permissions.
    permits: BTreeMap<GoalId, Duration>,
}

#[derive(Debug, Clone)]
struct CurrentGoal {
    id: GoalId,
    goal: Goal,
    progress: Progress,
    feedback: Feedback,
    interruptions: u32,
}

fn no_feedback() -> Feedback {
    Feedback::remaining(Metres::ZERO, Seconds::ZERO)
}

impl Goals {
    pub(super) fn contains(&self, id: GoalId) -> bool {
        self.is_current(id) || self.ended.iter().any(|(ended, ..)| *ended == id)
    }

    pub(super) fn is_current(&self, id: GoalId) -> bool {
        self.current.as_ref().is_some_and(|current| current.id == id)
    }

    /// Returns the goal that has not ended.
    pub(super) fn current(&self) -> Option<(GoalId, Progress)> {
        self.current.as_ref().map(|current| (current.id, current.progress))
    }

    /// Returns the goal that was canceled, and since when.
    pub(super) fn stopping(&self) -> Option<(GoalId, &Goal, Duration)> {
        let current = self.current.as_ref()?;
        match current.progress {
            Progress::Stopping { since } => Some((current.id, &current.goal, since)),
            Progress::Waiting { .. } | Progress::Active => None,
        }
    }

    /// Adds a goal. While another is in progress, the caller ends it at once.
    pub(super) fn add(&mut self, id: GoalId, goal: Goal, now: Duration) {
        match &self.current {
            None => {
                let progress = Progress::Waiting { since: now };
                self.current = Some(CurrentGoal { id, goal, progress, feedback: no_feedback(), interruptions: 0 });
            }
            Some(_) => self.push_ended(id, goal, GoalStatus::Sent),
        }
    }

    fn current_mut(&mut self, id: GoalId) -> Option<&mut CurrentGoal> {
        self.current.as_mut().filter(|current| current.id == id)
    }

    pub(super) fn begin(&mut self, id: GoalId) {
        if let Some(current) = self.current_mut(id) {
            current.progress = Progress::Active;
        }
    }

    pub(super) fn stop(&mut self, id: GoalId, now: Duration) {
        if let Some(current) = self.current_mut(id) {
            current.progress = Progress::Stopping { since: now };
        }
    }

    /// Lets the goal wait for the next process. Returns the number of its interruptions.
    pub(super) fn interrupt(&mut self, id: GoalId, now: Duration) -> u32 {
        self.current_mut(id).map_or(0, |current| {
            current.progress = Progress::Waiting { since: now };
            current.feedback = no_feedback();
            current.interruptions += 1;
            current.interruptions
        })
    }

    pub(super) fn interruptions(&self, id: GoalId) -> u32 {
        self.current.as_ref().filter(|current| current.id == id).map_or(0, |current| current.interruptions)
    }

    pub(super) fn report(&mut self, id: GoalId, feedback: Feedback) {
        if let Some(current) = self.current_mut(id) {
            current.feedback = feedback;
        }
    }

    /// Ends a goal.
    pub(super) fn end(&mut self, id: GoalId, status: GoalStatus) {
        self.permits.remove(&id);
        if let Some(current) = self.current.take_if(|current| current.id == id) {
            self.push_ended(id, current.goal, status.clone());
        } else if let Some((.., old)) = self.ended.iter_mut().find(|(ended, ..)| *ended == id) {
            *old = status.clone();
        }
        self.outcomes.push(GoalOutcome { id, status });
    }

    fn push_ended(&mut self, id: GoalId, goal: Goal, status: GoalStatus) {
        self.ended.push_back((id, goal, status));
        if self.ended.len() > ENDED_GOALS_KEPT {
            self.ended.pop_front();
        }
    }

    /// Sets the end of a goal's permission.
    pub(super) fn permit(&mut self, id: GoalId, until: Duration) {
        self.permits.insert(id, until);
        while self.permits.len() > PERMITS_KEPT {
            self.permits.pop_first();
        }
    }

    /// Returns the remaining permission of a goal.
    pub(super) fn permission(&self, id: GoalId, now: Duration) -> Duration {
        self.permits.get(&id).map_or(Duration::ZERO, |until| until.saturating_sub(now))
    }

    pub(super) fn status(&self, id: GoalId) -> Option<GoalStatus> {
        if let Some(current) = self.current.as_ref().filter(|current| current.id == id) {
            return Some(GoalStatus::Executing(current.feedback.clone()));
        }
        self.ended.iter().find(|(ended, ..)| *ended == id).map(|(.., status)| status.clone())
    }

    pub(super) fn content(&self, id: GoalId) -> Option<Goal> {
        let current = self.current.as_ref().filter(|current| current.id == id).map(|current| &current.goal);
        let ended = || self.ended.iter().find(|(ended, ..)| *ended == id).map(|(_, goal, _)| goal);
        current.or_else(ended).cloned()
    }

    pub(super) fn ids(&self) -> Vec<GoalId> {
        let current = self.current.as_ref().map(|current| current.id);
        let mut ids: Vec<GoalId> = self.ended.iter().map(|(id, ..)| *id).chain(current).collect();
        ids.sort();
        ids
    }

    pub(super) fn take_ended(&mut self) -> Vec<GoalOutcome> {
        std::mem::take(&mut self.outcomes)
    }

    pub(super) fn has_ended_goals(&self) -> bool {
        !self.outcomes.is_empty()
    }
}
