//! Turning on the spot.

use crate::component_types;
use crate::world::components::SimRobot;
use crate::world::location::RobotLocation;
use crate::world::preconditions::action_error;
use crate::world::sim_state::SimState;
use crate::world::steered::{BodyIndex, Steered};
use crate::world::system::System;
use crate::world::system_access::ComponentType;
use consort_protocol::pose::Pose;
use consort_skills::actions::{
    ActionError, ActionParameters as _, ErrorCode, Feedback, Goal, GoalProgress, GoalResult, Spin,
};
use hecs::Entity;

/// Turn rate in radians per second: Nav2's maximum for its spin behavior.
const TURN_RADPS: f64 = 1.0;

/// Greatest angle of a spin, in either direction: a hundred turns.
const TURN_MAX_RAD: f64 = 200.0 * std::f64::consts::PI;

/// See the [module](self).
pub(crate) struct Turning;

impl System for Turning {
    fn name(&self) -> &'static str {
        "turning"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![SimRobot]
    }

    fn writes(&self) -> Vec<ComponentType> {
        component_types![RobotLocation, Steered, BodyIndex]
    }

    fn goal_kinds(&self) -> &'static [&'static str] {
        &[Spin::ACTION]
    }

    fn begin_goal(&self, state: &mut SimState, robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        let angle_rad = match goal.read()? {
            Ok(Spin { angle_rad }) => angle_rad,
            Err(error) => return Some(Err(error)),
        };
        let body = &state.get::<SimRobot>(robot).0;
        if !body.mobile {
            return Some(Err(action_error(ErrorCode::Unknown, format!("{} cannot turn", body.id))));
        }
        if !(-TURN_MAX_RAD..=TURN_MAX_RAD).contains(&angle_rad) {
            let message =
                format!("{angle_rad} rad is no angle to turn by, allowed is -{TURN_MAX_RAD:.0} to {TURN_MAX_RAD:.0}");
            return Some(Err(action_error(ErrorCode::Unknown, message)));
        }
        Some(Ok(state.now + angle_rad.abs() / TURN_RADPS))
    }

    fn feedback(&self, _state: &SimState, _robot: Entity, goal: &Goal, usual: Feedback) -> Feedback {
        let Some(Ok(Spin { angle_rad })) = goal.read() else { return usual };
        let left_rad = (usual.time_remaining.get() * TURN_RADPS).min(angle_rad.abs());
        Feedback { progress: GoalProgress::Turned(angle_rad - left_rad.copysign(angle_rad)), ..usual }
    }

    fn finish_goal(&self, state: &mut SimState, robot: Entity, goal: &Goal) -> Result<GoalResult, ActionError> {
        let Some(Spin { angle_rad }) = goal.read().transpose()? else { return Ok(GoalResult::default()) };
        if let RobotLocation::Standing { pose, .. } = &mut *state.get_mut::<RobotLocation>(robot) {
            let yaw = pose.yaw + angle_rad;
            *pose = Pose::new(pose.x, pose.y, yaw.sin().atan2(yaw.cos()));
            state.change_steered(robot, |steered| steered.model.set_heading(pose.yaw));
        }
        Ok(GoalResult::default())
    }
}
