//! Drawers that people and arms reach into.

use crate::component_types;
use crate::world::actions::OperateDrawer;
use crate::world::components::{DrawerOpen, SimRobot};
use crate::world::event::WorldEvent;
use crate::world::preconditions::action_error;
use crate::world::setup::RobotSetup;
use crate::world::sim_state::SimState;
use crate::world::system::System;
use crate::world::system_access::ComponentType;
use consort_skills::actions::{ActionError, ActionParameters as _, ErrorCode, Goal, GoalResult};
use hecs::Entity;

/// See the [module](self).
pub(crate) struct Drawer;

impl System for Drawer {
    fn name(&self) -> &'static str {
        "drawer"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![SimRobot]
    }

    fn writes(&self) -> Vec<ComponentType> {
        component_types![DrawerOpen]
    }

    fn init_robot(&self, state: &mut SimState, robot: Entity, _body: &RobotSetup) {
        state.insert(robot, DrawerOpen(false));
    }

    fn goal_kinds(&self) -> &'static [&'static str] {
        &[OperateDrawer::ACTION]
    }

    fn begin_goal(&self, state: &mut SimState, robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        if let Err(error) = goal.read::<OperateDrawer>()? {
            return Some(Err(error));
        }
        if !state.get::<SimRobot>(robot).0.has_drawer {
            let message = format!("{} has no drawer", state.robot_id(robot));
            return Some(Err(action_error(ErrorCode::ContainerState, message)));
        }
        Some(Ok(state.now + state.durations.operate_drawer_s))
    }

    fn finish_goal(&self, state: &mut SimState, robot: Entity, goal: &Goal) -> Result<GoalResult, ActionError> {
        let Some(OperateDrawer { open }) = goal.read().transpose()? else { return Ok(GoalResult::default()) };
        let was_open = std::mem::replace(&mut state.get_mut::<DrawerOpen>(robot).0, open);
        if was_open != open {
            state.log_event(WorldEvent::DrawerMoved { robot: state.robot_id(robot), open });
        }
        Ok(GoalResult::default())
    }
}
