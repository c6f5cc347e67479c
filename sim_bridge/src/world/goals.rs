//! The life of a goal: begun or refused, under way, ended, remembered for a while.

use super::actions::{refused, verb};
use super::battery::Battery;
use super::journal::Happening;
use super::motion::Whereabouts;
use super::queue::Ticket;
use super::{Due, World};
use consort_protocol::ids::RobotId;
use consort_protocol::units::{Metres, Seconds};
use consort_skills::actions::{ActionError, BodyEvent, ErrorCode, Feedback, Goal, GoalId, GoalStatus};
use hecs::Entity;
use std::collections::VecDeque;

/// A robot's goals: the one under way, and those that lately ended.
#[derive(Default)]
pub(super) struct GoalBook {
    current: Option<Current>,
    ended: VecDeque<Ended>,
    /// The largest id no longer remembered: what is not larger is taken for a repetition.
    forgotten: Option<GoalId>,
}

struct Current {
    id: GoalId,
    goal: Goal,
    ends: Ticket,
}

struct Ended {
    id: GoalId,
    goal: Goal,
    status: GoalStatus,
}

impl GoalBook {
    /// Whether a goal is under way.
    pub(super) fn is_busy(&self) -> bool {
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
    pub(super) fn begin(&mut self, robot: Entity, id: GoalId, goal: Goal) {
        if self.get::<GoalBook>(robot).knows(id) {
            return;
        }
        match self.try_begin(robot, &goal) {
            Ok(ends) => {
                self.note(Happening::GoalBegan { robot: self.name(robot), id, goal: goal.clone() });
                let ends = self.queue.arrange(ends, Due::GoalEnds(robot));
                self.get_mut::<GoalBook>(robot).current = Some(Current { id, goal, ends });
                self.set_working(robot, true);
            }
            Err(error) => {
                let event = self.record(robot, id, goal, GoalStatus::Aborted(error));
                self.say(event);
            }
        }
    }

    /// When the goal will end, if it may begin.
    fn try_begin(&mut self, robot: Entity, goal: &Goal) -> Result<f64, ActionError> {
        if let Some(current) = &self.get::<GoalBook>(robot).current {
            let message = format!("{} is doing {} (goal {})", self.name(robot), verb(&current.goal), current.id.0);
            return Err(refused(ErrorCode::Busy, message));
        }
        if !self.get::<Battery>(robot).able {
            return Err(self.too_low(robot));
        }
        if let Goal::NavigateToPose { pose, place } = goal {
            let drive = self.drive(robot, *pose, place.as_ref())?;
            self.set_off(robot, drive);
            return Ok(drive.ends);
        }
        self.effect(robot, goal)?;
        Ok(self.now + self.duration(goal))
    }

    fn too_low(&self, robot: Entity) -> ActionError {
        let left = self.get::<Battery>(robot).at(self.now);
        refused(ErrorCode::BatteryLow, format!("the battery of {} is down to {left:e}", self.name(robot)))
    }

    /// The goal under way has come to its end: its effect is carried out if it still can be.
    pub(super) fn complete(&mut self, robot: Entity) -> Option<BodyEvent> {
        let current = self.get_mut::<GoalBook>(robot).current.take()?;
        self.come_to_rest(robot);
        let status = match self.effect(robot, &current.goal) {
            Ok(effect) => {
                self.carry_out(robot, effect);
                GoalStatus::Succeeded
            }
            Err(error) => GoalStatus::Aborted(error),
        };
        Some(self.record(robot, current.id, current.goal, status))
    }

    /// Ends a goal early, if it is the one under way.
    pub(super) fn cancel_goal(&mut self, robot: Entity, id: GoalId) {
        if self.get::<GoalBook>(robot).current.as_ref().is_none_or(|current| current.id != id) {
            return;
        }
        if let Some(event) = self.interrupt(robot, GoalStatus::Canceled) {
            self.say(event);
        }
    }

    /// The battery has come down to the stopping share: what is under way is aborted where it stands.
    pub(super) fn strand(&mut self, robot: Entity) -> Vec<BodyEvent> {
        self.run_down(robot);
        let error = self.too_low(robot);
        let mut events: Vec<_> = self.interrupt(robot, GoalStatus::Aborted(error)).into_iter().collect();
        let robot = self.name(robot);
        self.note(Happening::Stranded { robot: robot.clone() });
        events.push(BodyEvent::Stranded { robot });
        events
    }

    fn interrupt(&mut self, robot: Entity, status: GoalStatus) -> Option<BodyEvent> {
        let current = self.get_mut::<GoalBook>(robot).current.take()?;
        self.queue.take_back(current.ends);
        self.come_to_rest(robot);
        Some(self.record(robot, current.id, current.goal, status))
    }

    fn come_to_rest(&mut self, robot: Entity) {
        self.stand_still(robot);
        self.set_working(robot, false);
    }

    fn record(&mut self, robot: Entity, id: GoalId, goal: Goal, status: GoalStatus) -> BodyEvent {
        let kept = self.limits.ended_kept;
        self.get_mut::<GoalBook>(robot).remember(Ended { id, goal, status: status.clone() }, kept);
        let robot = self.name(robot);
        self.note(Happening::GoalEnded { robot: robot.clone(), id, status: status.clone() });
        BodyEvent::GoalEnded { robot, goal: id, status }
    }

    /// Has the next `advance` say it.
    pub(super) fn say(&mut self, event: BodyEvent) {
        self.queue.arrange(self.now, Due::Say(Box::new(event)));
    }

    /// Refuses a goal for a robot that is not here; nothing is remembered of it.
    pub(super) fn refuse_stranger(&mut self, robot: &RobotId, id: GoalId) {
        let status = GoalStatus::Aborted(self.no_robot(robot));
        self.say(BodyEvent::GoalEnded { robot: robot.clone(), goal: id, status });
    }

    pub(super) fn goals_of(&self, robot: Entity) -> Vec<GoalId> {
        let book = self.get::<GoalBook>(robot);
        let ended = book.ended.iter().map(|ended| ended.id);
        let mut goals: Vec<GoalId> = ended.chain(book.current.as_ref().map(|current| current.id)).collect();
        goals.sort();
        goals
    }

    pub(super) fn goal_of(&self, robot: Entity, id: GoalId) -> Option<Goal> {
        let book = self.get::<GoalBook>(robot);
        let current = book.current.as_ref().filter(|current| current.id == id).map(|current| &current.goal);
        let ended = || book.ended.iter().find(|ended| ended.id == id).map(|ended| &ended.goal);
        current.or_else(ended).cloned()
    }

    pub(super) fn goal_status(&self, robot: Entity, id: GoalId) -> Option<GoalStatus> {
        let book = self.get::<GoalBook>(robot);
        match &book.current {
            Some(current) if current.id == id => {
                let left = (current.ends.time - self.now).max(0.0);
                let distance_remaining = match &*self.get::<Whereabouts>(robot) {
                    Whereabouts::Driving(drive) => drive.remaining(self.now),
                    Whereabouts::Standing { .. } => Metres::ZERO,
                };
                let time_remaining = Seconds::new(left).unwrap_or(Seconds::ZERO);
                Some(GoalStatus::Executing(Feedback { distance_remaining, time_remaining }))
            }
            _ => book.ended.iter().find(|ended| ended.id == id).map(|ended| ended.status.clone()),
        }
    }
}
