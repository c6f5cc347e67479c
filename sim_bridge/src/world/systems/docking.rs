//! Chargers: a robot that docks at one charges until it undocks or drives off.

use crate::map::PlaceKind;
use crate::world::components::SimRobot;
use crate::world::event_log::WorldEvent;
use crate::world::goals::GoalHistory;
use crate::world::location::RobotLocation;
use crate::world::preconditions::action_error;
use crate::world::setup::RobotSetup;
use crate::world::sim_state::SimState;
use crate::world::system::{ComponentType, System, kinds};
use consort_protocol::ids::PlaceId;
use consort_protocol::units::Seconds;
use consort_skills::actions::{ActionError, ErrorCode, Feedback, Goal, GoalProgress};
use hecs::Entity;

/// Whether a robot is connected to the charger at its place.
pub(crate) struct Docked(pub(crate) bool);

/// See the [module](self).
pub(crate) struct Docking;

impl System for Docking {
    fn name(&self) -> &'static str {
        "docking"
    }

    fn reads(&self) -> Vec<ComponentType> {
        kinds![SimRobot, GoalHistory, RobotLocation]
    }

    fn writes(&self) -> Vec<ComponentType> {
        kinds![Docked]
    }

    fn init_robot(&self, floor: &mut SimState, robot: Entity, _body: &RobotSetup) {
        floor.insert(robot, Docked(false));
    }

    fn begin_goal(&self, floor: &mut SimState, robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        let takes = floor.durations.dock_s;
        let may = match goal {
            Goal::Dock { charger } => floor.charger_here(robot, charger.as_ref()),
            Goal::Undock if !floor.get::<Docked>(robot).0 => {
                Err(action_error(ErrorCode::Charger, format!("{} is not docked", floor.robot_id(robot))))
            }
            Goal::Undock => Ok(()),
            _ => return None,
        };
        Some(may.map(|()| floor.now + takes))
    }

    fn finish_goal(&self, floor: &mut SimState, robot: Entity, goal: &Goal) -> Result<(), ActionError> {
        if let Goal::Dock { charger } = goal {
            floor.charger_here(robot, charger.as_ref())?;
        }
        floor.connect(robot, matches!(goal, Goal::Dock { .. }));
        Ok(())
    }

    fn feedback(&self, floor: &SimState, _robot: Entity, _goal: &Goal, usual: Feedback) -> Feedback {
        let taken_s = floor.durations.dock_s - usual.time_remaining.get();
        Feedback { progress: GoalProgress::Docking(Seconds::new(taken_s.max(0.0)).unwrap_or(Seconds::ZERO)), ..usual }
    }

    fn on_event(&self, floor: &mut SimState, what: &WorldEvent) {
        if let WorldEvent::GoalStarted { robot, goal, .. } = what
            && let Goal::NavigateToPose { .. } | Goal::FollowWaypoints { .. } | Goal::Spin { .. } = goal
            && let Some(robot) = floor.robots.get(robot).copied()
        {
            floor.connect(robot, false);
        }
    }
}

impl SimState {
    /// Whether the robot stands at a charger, and at the one that is meant.
    fn charger_here(&self, robot: Entity, meant: Option<&PlaceId>) -> Result<(), ActionError> {
        let place = self.map.place_at(self.require_place(robot)?);
        if let Some(meant) = meant {
            let Some(charger) = self.map.place(meant) else {
                let message = format!("there is no place {:?} here{}", meant.as_str(), self.map.suggest(meant));
                return Err(action_error(ErrorCode::Unknown, message));
            };
            if charger.id != place.id {
                let message = format!("{} is at {}, not at {meant}", self.robot_id(robot), place.id);
                return Err(action_error(ErrorCode::OutOfReach, message));
            }
        }
        if place.kind != PlaceKind::Charger {
            return Err(action_error(ErrorCode::Charger, format!("{} is no charger", place.id)));
        }
        Ok(())
    }

    fn connect(&mut self, robot: Entity, docked: bool) {
        let was = std::mem::replace(&mut self.get_mut::<Docked>(robot).0, docked);
        if was != docked {
            self.log_event(WorldEvent::Docked { robot: self.robot_id(robot), docked });
        }
    }
}
