//! Goals of a robot, as a component.

use super::event_queue::TimerId;
use super::system_access::SystemIndex;
use consort_protocol::ids::ActionName;
use consort_skills::actions::{Goal, GoalId, GoalStatus};
use std::collections::VecDeque;

/// Goals of a robot: the active goal, and those that ended lately.
#[derive(Default)]
pub(crate) struct GoalHistory {
    pub(super) active: Option<ActiveGoal>,
    pub(super) ended: VecDeque<EndedGoal>,
    /// Largest id no longer stored. An id that is not larger counts as a repetition.
    dropped_up_to: Option<GoalId>,
}

/// The active goal.
pub(super) struct ActiveGoal {
    pub(super) id: GoalId,
    pub(super) goal: Goal,
    /// The goal with the system's name for its action.
    pub(super) executed: Goal,
    /// `None` for a goal that its system ends.
    pub(super) ends: Option<TimerId>,
    /// Times of the beginning, and of the end without a cancel, in seconds of world time.
    pub(super) planned: (f64, f64),
    /// The system that executes the goal.
    pub(super) system: SystemIndex,
    /// The goal was canceled and ends at `ends`.
    pub(super) is_canceled: bool,
}

/// An ended goal.
pub(super) struct EndedGoal {
    pub(super) id: GoalId,
    pub(super) goal: Goal,
    pub(super) status: GoalStatus,
}

impl GoalHistory {
    /// Checks whether a goal is active.
    pub(crate) fn is_busy(&self) -> bool {
        self.active.is_some()
    }

    /// Returns the action of the active goal.
    pub(crate) fn action(&self) -> Option<&ActionName> {
        self.active.as_ref().map(|active| &active.goal.action)
    }

    /// Returns the action of an ended goal that is still stored.
    pub(crate) fn ended_action(&self, id: GoalId) -> Option<&ActionName> {
        self.ended.iter().rev().find(|ended| ended.id == id).map(|ended| &ended.goal.action)
    }

    /// Checks whether the active goal makes the robot leave its place or turn.
    pub(crate) fn moves_robot(&self) -> bool {
        self.active.as_ref().is_some_and(|active| active.executed.moves_robot())
    }

    /// Returns the elapsed share of the planned time of the active goal, from 0 to 1; 0 without a planned end.
    pub(crate) fn elapsed_share(&self, now: f64) -> f64 {
        self.active.as_ref().map_or(0.0, |ActiveGoal { planned: (began, ends), .. }| {
            if ends > began { ((now - began) / (ends - began)).clamp(0.0, 1.0) } else { 1.0 }
        })
    }

    pub(super) fn is_known(&self, id: GoalId) -> bool {
        self.active.as_ref().is_some_and(|active| active.id == id)
            || self.ended.iter().any(|ended| ended.id == id)
            || self.dropped_up_to.is_some_and(|dropped_up_to| id <= dropped_up_to)
    }

    pub(super) fn store(&mut self, ended: EndedGoal, kept: usize) {
        self.ended.push_back(ended);
        if self.ended.len() > kept {
            let gone = self.ended.pop_front().map(|ended| ended.id);
            self.dropped_up_to = self.dropped_up_to.max(gone);
        }
    }
}
