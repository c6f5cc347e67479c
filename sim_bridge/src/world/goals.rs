//! The life of a goal: begun or refused, under way, ended, remembered for a while.

use super::floor::{Due, Floor};
use super::journal::Happening;
use super::queue::Ticket;
use super::reach::{refused, verb};
use super::{Chosen, World};
use consort_protocol::ids::RobotId;
use consort_protocol::units::{Metres, Seconds};
use consort_skills::actions::{ActionError, BodyEvent, ErrorCode, Feedback, Goal, GoalId, GoalStatus};
use hecs::Entity;
use std::collections::VecDeque;

/// A robot's goals: the one under way, and those that lately ended.
#[derive(Default)]
pub(crate) struct GoalBook {
    current: Option<Current>,
    ended: VecDeque<Ended>,
    /// The largest id no longer remembered: what is not larger is taken for a repetition.
    forgotten: Option<GoalId>,
}

struct Current {
    id: GoalId,
    goal: Goal,
    /// None for a goal that ends when who carries it out says so.
    ends: Option<Ticket>,
    /// Who carries it out.
    by: Chosen,
}

struct Ended {
    id: GoalId,
    goal: Goal,
    status: GoalStatus,
}

impl GoalBook {
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
    pub(super) fn begin(&mut self, robot: Entity, id: GoalId, goal: Goal) {
        if self.floor.get::<GoalBook>(robot).knows(id) {
            return;
        }
        match self.try_begin(robot, &goal) {
            Ok((by, ends)) => {
                let floor = &mut self.floor;
                floor.note(Happening::GoalBegan { robot: floor.name(robot), id, goal: goal.clone() });
                let ends = ends.is_finite().then(|| floor.queue.arrange(ends, Due::GoalEnds(robot)));
                floor.get_mut::<GoalBook>(robot).current = Some(Current { id, goal, ends, by });
            }
            Err(error) => {
                let event = self.floor.record(robot, id, goal, GoalStatus::Aborted(error));
                self.floor.say(event);
            }
        }
    }

    /// Who carries the goal out and when it will end, if it may begin.
    fn try_begin(&mut self, robot: Entity, goal: &Goal) -> Result<(Chosen, f64), ActionError> {
        if let Some(current) = &self.floor.get::<GoalBook>(robot).current {
            let message =
                format!("{} is doing {} (goal {})", self.floor.name(robot), verb(&current.goal), current.id.0);
            return Err(refused(ErrorCode::Busy, message));
        }
        for chosen in self.chosen() {
            self.work(chosen, |system, floor| system.permit(floor, robot, goal))?;
        }
        for chosen in self.chosen() {
            if let Some(begun) = self.work(chosen, |system, floor| system.begin(floor, robot, goal)) {
                return begun.map(|ends| (chosen, ends));
            }
        }
        Err(refused(ErrorCode::Unknown, format!("no system of this world can {}", verb(goal))))
    }

    /// The goal under way has come to its end: its effect is carried out if it still can be.
    pub(super) fn complete(&mut self, robot: Entity) -> Option<BodyEvent> {
        let Current { id, goal, ends, by } = self.floor.get_mut::<GoalBook>(robot).current.take()?;
        ends.into_iter().for_each(|ends| self.floor.queue.take_back(ends));
        let status = match self.work(by, |system, floor| system.finish(floor, robot, &goal)) {
            Ok(()) => GoalStatus::Succeeded,
            Err(error) => GoalStatus::Aborted(error),
        };
        Some(self.floor.record(robot, id, goal, status))
    }

    /// Ends a goal early, if it is the one under way.
    pub(super) fn cancel_goal(&mut self, robot: Entity, id: GoalId) {
        let is_current = self.floor.get::<GoalBook>(robot).current.as_ref().is_some_and(|current| current.id == id);
        if is_current && let Some(event) = self.interrupt(robot, GoalStatus::Canceled) {
            self.floor.say(event);
        }
    }

    /// Ends the goal under way, if there is one, with everything as it is now.
    pub(super) fn interrupt(&mut self, robot: Entity, status: GoalStatus) -> Option<BodyEvent> {
        let Current { id, goal, ends, by } = self.floor.get_mut::<GoalBook>(robot).current.take()?;
        ends.into_iter().for_each(|ends| self.floor.queue.take_back(ends));
        self.work(by, |system, floor| system.halt(floor, robot, &goal));
        Some(self.floor.record(robot, id, goal, status))
    }

    /// Refuses a goal for a robot that is not here; nothing is remembered of it.
    pub(super) fn refuse_stranger(&mut self, robot: &RobotId, id: GoalId) {
        let status = GoalStatus::Aborted(self.floor.no_robot(robot));
        self.floor.say(BodyEvent::GoalEnded { robot: robot.clone(), goal: id, status });
    }

    pub(super) fn goals_of(&self, robot: Entity) -> Vec<GoalId> {
        let book = self.floor.get::<GoalBook>(robot);
        let ended = book.ended.iter().map(|ended| ended.id);
        let mut goals: Vec<GoalId> = ended.chain(book.current.as_ref().map(|current| current.id)).collect();
        goals.sort();
        goals
    }

    pub(super) fn goal_of(&self, robot: Entity, id: GoalId) -> Option<Goal> {
        let book = self.floor.get::<GoalBook>(robot);
        let current = book.current.as_ref().filter(|current| current.id == id).map(|current| &current.goal);
        let ended = || book.ended.iter().find(|ended| ended.id == id).map(|ended| &ended.goal);
        current.or_else(ended).cloned()
    }

    pub(super) fn goal_status(&self, robot: Entity, id: GoalId) -> Option<GoalStatus> {
        let book = self.floor.get::<GoalBook>(robot);
        match &book.current {
            Some(current) if current.id == id => {
                let left = current.ends.map_or(0.0, |ends| ends.time - self.floor.now);
                let time_remaining = Seconds::new(left.max(0.0)).unwrap_or(Seconds::ZERO);
                let usual = Feedback { distance_remaining: Metres::ZERO, time_remaining };
                let system = self.systems[current.by.0];
                Some(GoalStatus::Executing(system.feedback(&self.floor, robot, &current.goal, usual)))
            }
            _ => book.ended.iter().find(|ended| ended.id == id).map(|ended| ended.status.clone()),
        }
    }
}

impl Floor {
    /// Remembers how a goal ended: what the outside is to be told.
    fn record(&mut self, robot: Entity, id: GoalId, goal: Goal, status: GoalStatus) -> BodyEvent {
        let kept = self.limits.ended_kept;
        self.get_mut::<GoalBook>(robot).remember(Ended { id, goal, status: status.clone() }, kept);
        let robot = self.name(robot);
        self.note(Happening::GoalEnded { robot: robot.clone(), id, status: status.clone() });
        BodyEvent::GoalEnded { robot, goal: id, status }
    }
}
