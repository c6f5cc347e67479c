//! The life of a goal: begun or refused, under way, ended, remembered for a while.

use super::event_log::WorldEvent;
use super::event_queue::TimerId;
use super::preconditions::{action_error, goal_name};
use super::sim_state::{ScheduledEvent, SimState};
use super::{SystemIndex, World};
use consort_protocol::ids::RobotId;
use consort_protocol::units::{Metres, Seconds};
use consort_skills::actions::{ActionError, BackendEvent, ErrorCode, Feedback, Goal, GoalId, GoalStatus};
use hecs::Entity;
use std::collections::VecDeque;

/// A robot's goals: the one under way, and those that lately ended.
#[derive(Default)]
pub(crate) struct GoalHistory {
    current: Option<Current>,
    ended: VecDeque<Ended>,
    /// The largest id no longer remembered: what is not larger is taken for a repetition.
    forgotten: Option<GoalId>,
}

struct Current {
    id: GoalId,
    goal: Goal,
    /// None for a goal that ends when who carries it out says so.
    ends: Option<TimerId>,
    /// Who carries it out.
    by: SystemIndex,
}

struct Ended {
    id: GoalId,
    goal: Goal,
    status: GoalStatus,
}

impl GoalHistory {
    /// Whether a goal is under way.
    pub(crate) fn is_busy(&self) -> bool {
        self.current.is_some()
    }

    fn knows(&self, id: GoalId) -> bool {
        self.current.as_ref().is_some_and(|current| current.id == id)
            || self.ended.iter().any(|ended| ended.id == id)
            || self.forgotten.is_some_and(|forgotten| id <= forgotten)
    }

    fn remember(&mut self, ended: Ended, kept: usize) {
        self.ended.push_back(ended);
        if self.ended.len() > kept {
            let gone = self.ended.pop_front().map(|ended| ended.id);
            self.forgotten = self.forgotten.max(gone);
        }
    }
}

impl World {
    /// Begins a goal, or refuses it; an id that was seen before changes nothing.
    pub(super) fn begin_goal(&mut self, robot: Entity, id: GoalId, goal: Goal) {
        if self.state.get::<GoalHistory>(robot).knows(id) {
            return;
        }
        match self.try_begin(robot, &goal) {
            Ok((by, ends)) => {
                let floor = &mut self.state;
                floor.log_event(WorldEvent::GoalStarted { robot: floor.robot_id(robot), id, goal: goal.clone() });
                let ends = ends.is_finite().then(|| floor.queue.schedule(ends, ScheduledEvent::GoalEnds(robot)));
                floor.get_mut::<GoalHistory>(robot).current = Some(Current { id, goal, ends, by });
            }
            Err(error) => {
                let event = self.state.record(robot, id, goal, GoalStatus::Aborted(error));
                self.state.emit(event);
            }
        }
    }

    /// Who carries the goal out and when it will end, if it may begin.
    fn try_begin(&mut self, robot: Entity, goal: &Goal) -> Result<(SystemIndex, f64), ActionError> {
        if let Some(current) = &self.state.get::<GoalHistory>(robot).current {
            let message =
                format!("{} is doing {} (goal {})", self.state.robot_id(robot), goal_name(&current.goal), current.id.0);
            return Err(action_error(ErrorCode::Busy, message));
        }
        for chosen in self.system_indices() {
            self.run_system(chosen, |system, floor| system.check_goal_allowed(floor, robot, goal))?;
        }
        for chosen in self.system_indices() {
            if let Some(begun) = self.run_system(chosen, |system, floor| system.begin_goal(floor, robot, goal)) {
                return begun.map(|ends| (chosen, ends));
            }
        }
        Err(action_error(ErrorCode::Unknown, format!("no system of this world can {}", goal_name(goal))))
    }

    /// The goal under way has come to its end: its effect is carried out if it still can be.
    pub(super) fn complete_goal(&mut self, robot: Entity) -> Option<BackendEvent> {
        let Current { id, goal, ends, by } = self.state.get_mut::<GoalHistory>(robot).current.take()?;
        ends.into_iter().for_each(|ends| self.state.queue.cancel(ends));
        let status = match self.run_system(by, |system, floor| system.finish_goal(floor, robot, &goal)) {
            Ok(()) => GoalStatus::Succeeded,
            Err(error) => GoalStatus::Aborted(error),
        };
        Some(self.state.record(robot, id, goal, status))
    }

    /// Ends a goal early, if it is the one under way.
    pub(super) fn cancel_goal(&mut self, robot: Entity, id: GoalId) {
        let is_current = self.state.get::<GoalHistory>(robot).current.as_ref().is_some_and(|current| current.id == id);
        if is_current && let Some(event) = self.interrupt_goal(robot, GoalStatus::Canceled) {
            self.state.emit(event);
        }
    }

    /// Ends the goal under way, if there is one, with everything as it is now.
    pub(super) fn interrupt_goal(&mut self, robot: Entity, status: GoalStatus) -> Option<BackendEvent> {
        let Current { id, goal, ends, by } = self.state.get_mut::<GoalHistory>(robot).current.take()?;
        ends.into_iter().for_each(|ends| self.state.queue.cancel(ends));
        self.run_system(by, |system, floor| system.halt_goal(floor, robot, &goal));
        Some(self.state.record(robot, id, goal, status))
    }

    /// Refuses a goal for a robot that is not here; nothing is remembered of it.
    pub(super) fn reject_unknown_robot(&mut self, robot: &RobotId, id: GoalId) {
        let status = GoalStatus::Aborted(self.state.unknown_robot_error(robot));
        self.state.emit(BackendEvent::GoalEnded { robot: robot.clone(), goal: id, status });
    }

    pub(super) fn goals_of(&self, robot: Entity) -> Vec<GoalId> {
        let book = self.state.get::<GoalHistory>(robot);
        let ended = book.ended.iter().map(|ended| ended.id);
        let mut goals: Vec<GoalId> = ended.chain(book.current.as_ref().map(|current| current.id)).collect();
        goals.sort();
        goals
    }

    pub(super) fn goal_of(&self, robot: Entity, id: GoalId) -> Option<Goal> {
        let book = self.state.get::<GoalHistory>(robot);
        let current = book.current.as_ref().filter(|current| current.id == id).map(|current| &current.goal);
        let ended = || book.ended.iter().find(|ended| ended.id == id).map(|ended| &ended.goal);
        current.or_else(ended).cloned()
    }

    pub(super) fn goal_status(&self, robot: Entity, id: GoalId) -> Option<GoalStatus> {
        let book = self.state.get::<GoalHistory>(robot);
        match &book.current {
            Some(current) if current.id == id => {
                let left = current.ends.map_or(0.0, |ends| ends.time - self.state.now);
                let time_remaining = Seconds::new(left.max(0.0)).unwrap_or(Seconds::ZERO);
                let usual = Feedback::remaining(Metres::ZERO, time_remaining);
                let system = self.systems[current.by.0];
                Some(GoalStatus::Executing(system.feedback(&self.state, robot, &current.goal, usual)))
            }
            _ => book.ended.iter().find(|ended| ended.id == id).map(|ended| ended.status.clone()),
        }
    }
}

impl SimState {
    /// Remembers how a goal ended: what the outside is to be told.
    fn record(&mut self, robot: Entity, id: GoalId, goal: Goal, status: GoalStatus) -> BackendEvent {
        let kept = self.limits.ended_kept;
        self.get_mut::<GoalHistory>(robot).remember(Ended { id, goal, status: status.clone() }, kept);
        let robot = self.robot_id(robot);
        self.log_event(WorldEvent::GoalEnded { robot: robot.clone(), id, status: status.clone() });
        BackendEvent::GoalEnded { robot, goal: id, status }
    }
}
