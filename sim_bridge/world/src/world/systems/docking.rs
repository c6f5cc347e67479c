//! Chargers: a docked robot charges until it undocks or drives off.

use crate::component_types;
use crate::map::PlaceKind;
use crate::world::components::SimRobot;
use crate::world::event::WorldEvent;
use crate::world::goal_history::GoalHistory;
use crate::world::location::RobotLocation;
use crate::world::preconditions::action_error;
use crate::world::setup::RobotSetup;
use crate::world::sim_state::SimState;
use crate::world::system::System;
use crate::world::system_access::ComponentType;
use consort_protocol::ids::PlaceId;
use consort_protocol::units::Seconds;
use consort_skills::actions::{
    ActionError, ActionParameters as _, Dock, ErrorCode, Feedback, Goal, GoalProgress, GoalResult, Undock,
};
use hecs::Entity;

/// True if a robot is connected to the charger at its place.
pub(crate) struct Docked(pub(crate) bool);

/// See the [module](self).
pub(crate) struct Docking;

impl System for Docking {
    fn name(&self) -> &'static str {
        "docking"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![SimRobot, GoalHistory, RobotLocation]
    }

    fn writes(&self) -> Vec<ComponentType> {
        component_types![Docked]
    }

    fn init_robot(&self, state: &mut SimState, robot: Entity, _body: &RobotSetup) {
        state.insert(robot, Docked(false));
    }

    fn goal_kinds(&self) -> &'static [&'static str] {
        &[Dock::ACTION, Undock::ACTION]
    }

    fn begin_goal(&self, state: &mut SimState, robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        let duration_s = state.durations.dock_s;
        let allowed = match goal.read::<Dock>() {
            Some(dock) => dock.and_then(|Dock { charger }| state.check_charger(robot, charger.as_ref())),
            None => goal.read::<Undock>()?.and_then(|Undock {}| match state.get::<Docked>(robot).0 {
                true => Ok(()),
                false => Err(action_error(ErrorCode::Charger, format!("{} is not docked", state.robot_id(robot)))),
            }),
        };
        Some(allowed.map(|()| state.now + duration_s))
    }

    fn finish_goal(&self, state: &mut SimState, robot: Entity, goal: &Goal) -> Result<GoalResult, ActionError> {
        let dock = goal.read::<Dock>().transpose()?;
        if let Some(Dock { charger }) = &dock {
            state.check_charger(robot, charger.as_ref())?;
        }
        state.connect(robot, dock.is_some());
        Ok(GoalResult::default())
    }

    fn feedback(&self, state: &SimState, _robot: Entity, _goal: &Goal, usual: Feedback) -> Feedback {
        let taken_s = state.durations.dock_s - usual.time_remaining.get();
        Feedback { progress: GoalProgress::Docking(Seconds::new(taken_s.max(0.0)).unwrap_or(Seconds::ZERO)), ..usual }
    }

    fn on_event(&self, state: &mut SimState, event: &WorldEvent) {
        if let WorldEvent::GoalStarted { robot, .. } = event
            && let Some(robot) = state.robots.get(robot).copied()
            && state.get::<GoalHistory>(robot).moves_robot()
        {
            state.connect(robot, false);
        }
    }
}

impl SimState {
    /// Checks that the robot is at a charger, and at the requested charger, if any.
    fn check_charger(&self, robot: Entity, required: Option<&PlaceId>) -> Result<(), ActionError> {
        let place = self.map.place_at(self.require_place(robot)?);
        if let Some(required) = required {
            let Some(charger) = self.map.place(required) else {
                let message = format!("there is no place {:?} here{}", required.as_str(), self.map.suggest(required));
                return Err(action_error(ErrorCode::Unknown, message));
            };
            if charger.id != place.id {
                let message = format!("{} is at {}, not at {required}", self.robot_id(robot), place.id);
                return Err(action_error(ErrorCode::OutOfReach, message));
            }
        }
        if place.kind != PlaceKind::Charger && !self.chargers.contains_key(&place.id) {
            return Err(action_error(ErrorCode::Charger, format!("{} is not a charger", place.id)));
        }
        Ok(())
    }

    fn connect(&mut self, robot: Entity, docked: bool) {
        let before = std::mem::replace(&mut self.get_mut::<Docked>(robot).0, docked);
        if before != docked {
            self.log_event(WorldEvent::Docked { robot: self.robot_id(robot), docked });
        }
    }
}
