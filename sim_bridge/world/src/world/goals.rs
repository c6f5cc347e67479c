//! Life cycle of a goal: started or rejected, active, ended, kept for a while.

use super::event::WorldEvent;
use super::goal_history::{ActiveGoal, EndedGoal, GoalHistory};
use super::preconditions::action_error;
use super::sim_state::{ScheduledEvent, SimState};
use super::simulation::World;
use super::system_access::SystemIndex;
use consort_protocol::ids::RobotId;
use consort_protocol::units::{Metres, Seconds};
use consort_skills::actions::{ActionError, BackendEvent, ErrorCode, Feedback, Goal, GoalId, GoalResult, GoalStatus};
use hecs::Entity;

/// A goal that may start.
struct Started {
    system: SystemIndex,
    executed: Goal,
    ends: f64,
}

impl World {
    /// Starts a goal, or rejects it. An id seen before changes nothing.
    pub(super) fn begin_goal(&mut self, robot: Entity, id: GoalId, goal: Goal) {
        if self.state.get::<GoalHistory>(robot).is_known(id) {
            return;
        }
        match self.try_begin(robot, &goal) {
            Ok(Started { system, executed, ends }) => {
                let state = &mut self.state;
                state.log_event(WorldEvent::GoalStarted { robot: state.robot_id(robot), id, goal: goal.clone() });
                let planned = (state.now, ends);
                let ends = ends.is_finite().then(|| state.queue.schedule(ends, ScheduledEvent::GoalEnds(robot)));
                state.get_mut::<GoalHistory>(robot).active =
                    Some(ActiveGoal { id, goal, executed, ends, planned, system, is_canceled: false });
            }
            Err(error) => {
                let event = self.state.record(robot, id, goal, GoalStatus::Aborted(error));
                self.state.emit(event);
            }
        }
    }

    fn try_begin(&mut self, robot: Entity, goal: &Goal) -> Result<Started, ActionError> {
        if let Some(active) = &self.state.get::<GoalHistory>(robot).active {
            let message =
                format!("{} is executing {} (goal {})", self.state.robot_id(robot), active.goal.action, active.id.0);
            return Err(action_error(ErrorCode::Busy, message));
        }
        for index in self.system_indices() {
            self.run_system(index, |system, state| system.check_goal_allowed(state, robot, goal))?;
        }
        let begun = self.actions.of(goal).and_then(|(system, executed)| {
            let ends = self.run_system(system, |system, state| system.begin_goal(state, robot, &executed))?;
            Some(ends.map(|ends| Started { system, executed, ends }))
        });
        let unknown = || format!("no system of this world executes {}", goal.action);
        begun.unwrap_or_else(|| Err(action_error(ErrorCode::Unknown, unknown())))
    }

    /// Ends the active goal and applies its effect, if that is still possible.
    pub(super) fn complete_goal(&mut self, robot: Entity) -> Option<BackendEvent> {
        if self.state.get::<GoalHistory>(robot).active.as_ref().is_some_and(|active| active.is_canceled) {
            return self.interrupt_goal(robot, GoalStatus::Canceled);
        }
        let active = self.state.get_mut::<GoalHistory>(robot).active.take()?;
        let ActiveGoal { id, goal, executed, ends, system, .. } = active;
        ends.into_iter().for_each(|ends| self.state.queue.cancel(ends));
        let status = match self.run_system(system, |system, state| system.finish_goal(state, robot, &executed)) {
            Ok(GoalResult(result)) => GoalStatus::with_result(result),
            Err(error) => GoalStatus::Aborted(error),
        };
        Some(self.state.record(robot, id, goal, status))
    }

    /// Cancels a goal, if it is the active goal. It ends after the declared time for its cancel, or at its end if that
    /// is earlier.
    pub(super) fn cancel_goal(&mut self, robot: Entity, id: GoalId) {
        let cancel_s = match &self.state.get::<GoalHistory>(robot).active {
            Some(active) if active.id == id && !active.is_canceled => self.actions.cancel_s(&active.goal),
            _ => return,
        };
        if cancel_s > 0.0 {
            self.end_canceled_goal_at(robot, self.state.now + cancel_s);
        } else if let Some(event) = self.interrupt_goal(robot, GoalStatus::Canceled) {
            self.state.emit(event);
        }
    }

    /// Ends the active goal as canceled at this time, unless it reaches its end before.
    fn end_canceled_goal_at(&mut self, robot: Entity, time: f64) {
        let ends = self.state.get::<GoalHistory>(robot).active.as_ref().and_then(|active| active.ends);
        if ends.is_some_and(|ends| ends.time <= time) {
            return;
        }
        ends.into_iter().for_each(|ends| self.state.queue.cancel(ends));
        let ends = self.state.queue.schedule(time, ScheduledEvent::GoalEnds(robot));
        if let Some(active) = &mut self.state.get_mut::<GoalHistory>(robot).active {
            (active.ends, active.is_canceled) = (Some(ends), true);
        }
    }

    /// Ends the active goal, if any, and leaves everything as it is now.
    pub(super) fn interrupt_goal(&mut self, robot: Entity, status: GoalStatus) -> Option<BackendEvent> {
        let active = self.state.get_mut::<GoalHistory>(robot).active.take()?;
        let ActiveGoal { id, goal, executed, ends, system, .. } = active;
        ends.into_iter().for_each(|ends| self.state.queue.cancel(ends));
        self.run_system(system, |system, state| system.halt_goal(state, robot, &executed));
        Some(self.state.record(robot, id, goal, status))
    }

    /// Rejects a goal for an unknown robot. Nothing is stored.
    pub(super) fn reject_unknown_robot(&mut self, robot: &RobotId, id: GoalId) {
        let status = GoalStatus::Aborted(self.state.unknown_robot_error(robot));
        self.state.emit(BackendEvent::GoalEnded { robot: robot.clone(), goal: id, status });
    }

    pub(super) fn goals_of(&self, robot: Entity) -> Vec<GoalId> {
        let history = self.state.get::<GoalHistory>(robot);
        let ended = history.ended.iter().map(|ended| ended.id);
        let mut goals: Vec<GoalId> = ended.chain(history.active.as_ref().map(|active| active.id)).collect();
        goals.sort();
        goals
    }

    pub(super) fn goal_of(&self, robot: Entity, id: GoalId) -> Option<Goal> {
        let history = self.state.get::<GoalHistory>(robot);
        let active = history.active.as_ref().filter(|active| active.id == id).map(|active| &active.goal);
        let ended = || history.ended.iter().find(|ended| ended.id == id).map(|ended| &ended.goal);
        active.or_else(ended).cloned()
    }

    pub(super) fn goal_status(&self, robot: Entity, id: GoalId) -> Option<GoalStatus> {
        let history = self.state.get::<GoalHistory>(robot);
        match &history.active {
            Some(active) if active.id == id => {
                let left = active.ends.map_or(0.0, |ends| ends.time - self.state.now);
                let time_remaining = Seconds::new(left.max(0.0)).unwrap_or(Seconds::ZERO);
                let usual = Feedback::remaining(Metres::ZERO, time_remaining);
                let system = self.system(active.system);
                Some(GoalStatus::Executing(system.feedback(&self.state, robot, &active.executed, usual)))
            }
            _ => history.ended.iter().find(|ended| ended.id == id).map(|ended| ended.status.clone()),
        }
    }
}

impl SimState {
    /// Stores the result of a goal and returns the event to emit.
    fn record(&mut self, robot: Entity, id: GoalId, goal: Goal, status: GoalStatus) -> BackendEvent {
        let kept = self.limits.ended_goals_kept;
        self.get_mut::<GoalHistory>(robot).store(EndedGoal { id, goal, status: status.clone() }, kept);
        let robot = self.robot_id(robot);
        self.log_event(WorldEvent::GoalEnded { robot: robot.clone(), id, status: status.clone() });
        BackendEvent::GoalEnded { robot, goal: id, status }
    }
}
