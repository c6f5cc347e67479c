//! Teams that follow advice, with checks of guards, and their state.

use crate::team::{Event, Team};
use consort_protocol::ids::TaskId;
use consort_protocol::plan::{ItemMove, PlanProgress, StepAction, StepIndex};
use std::collections::BTreeSet;

impl<'d> Team<'d> {
    /// Returns the same team, which reports an error as soon as an item moves before its guards are
    /// met.
    pub(crate) fn checking_guards(self, moves: &'d [ItemMove]) -> Self {
        Team { moves, ..self }
    }

    /// Returns the events if every robot follows `next`.
    pub(crate) fn advised(&self) -> Vec<Event<'d>> {
        let next = |robot: &usize| self.robots[*robot].next_guarded(&self.known[*robot]).map(|(step, _)| step);
        let advised = |event: &Event<'d>| match event {
            Event::Perform(robot, step) => next(robot) == Some(*step),
            Event::Finish(_) | Event::Receive(..) | Event::Replace(..) | Event::Report(_) => true,
        };
        self.events().into_iter().filter(advised).collect()
    }

    /// Returns the steps of a robot that the ledger contains.
    pub(crate) fn known(&self, robot: usize) -> &BTreeSet<StepIndex> {
        &self.known[robot]
    }

    /// Returns whether any robot has begun the task, and whether all have ended it.
    pub(crate) fn begun_and_ended(&self, task: &TaskId) -> (bool, bool) {
        let (mut begun, mut all) = (false, true);
        for (progress, current) in self.robots.iter().zip(&self.current) {
            for (index, step) in (0..).zip(&progress.plan().steps) {
                if matches!(&step.action, StepAction::Task { id, .. } if id == task) {
                    let ended = progress.ended().contains(&index);
                    begun |= ended || *current == Some(index);
                    all &= ended;
                }
            }
        }
        (begun, all)
    }

    pub(crate) fn robots_mut(&mut self) -> &mut Vec<PlanProgress> {
        &mut self.robots
    }
}
