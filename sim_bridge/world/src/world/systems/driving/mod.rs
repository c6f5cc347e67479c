//! Driving to a pose in a straight line, at the robot's speed or the lower limit of the lane or the goal, equally fast
//! in every direction; and riding lifts between places without a lane.
//!
//! A position is computed from the last departure, and the next point of interest is an entry in
//! the queue, so a driving robot costs nothing. Robots may pass through each other. Doors, lifts
//! and obstacles stop them. There are none of these off the lanes.
//!
//! A robot with kinematics takes the same routes, but [`steering`](super::steering) drives each
//! part and reports its end. It stops only where it may have to wait.
//!
//! ```text
//!  begin ─▶ driving ─▶ at a door ─▶ driving ─▶ … ─▶ complete          at a lift ─▶ in the lift ─▶ complete
//!              └─▶ obstacle: blocked                                                   └─▶ the next target
//! ```

mod drive;
mod task;
mod waits;

use crate::component_types;
use crate::world::components::{CoPresence, DepartureCount, SimRobot};
use crate::world::event::WorldEvent;
use crate::world::location::RobotLocation;
use crate::world::preconditions::action_error;
use crate::world::routing::DriveTarget;
use crate::world::setup::RobotSetup;
use crate::world::sim_state::SimState;
use crate::world::steered::{BodyIndex, Footprint, Steered};
use crate::world::system::{END_UNKNOWN, System};
use crate::world::system_access::{ComponentType, SystemTimer};
use crate::world::systems::doors::{DoorState, DoorsByName};
use crate::world::systems::lifts::LiftsByName;
use crate::world::systems::obstacles::{ActiveObstacles, KnownClosures};
use consort_protocol::ids::RobotId;
use consort_skills::actions::{
    ActionError, ActionParameters as _, ErrorCode, Feedback, FollowWaypoints, Goal, GoalProgress, GoalResult,
    NavigateToPose,
};
use hecs::Entity;
use std::collections::VecDeque;
use task::{DriveTask, Stage};

/// See the [module](self).
pub(crate) struct Driving;

impl System for Driving {
    fn name(&self) -> &'static str {
        "driving"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![SimRobot, DoorState, DoorsByName, ActiveObstacles, LiftsByName, Footprint]
    }

    fn writes(&self) -> Vec<ComponentType> {
        component_types![RobotLocation, DepartureCount, CoPresence, DriveTask, KnownClosures, Steered, BodyIndex]
    }

    fn init_robot(&self, state: &mut SimState, robot: Entity, _body: &RobotSetup) {
        state.insert(robot, DepartureCount(0));
        state.insert(
            robot,
            DriveTask {
                target: None,
                targets: 0,
                next_targets: VecDeque::new(),
                stage: Stage::Idle,
                timer: None,
                doorway: None,
            },
        );
    }

    fn goal_kinds(&self) -> &'static [&'static str] {
        &[NavigateToPose::ACTION, FollowWaypoints::ACTION]
    }

    fn begin_goal(&self, state: &mut SimState, robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        let single = |NavigateToPose { pose, place, speed_max_mps: speed_max }| {
            VecDeque::from([DriveTarget { pose, place, speed_max }])
        };
        let several = |FollowWaypoints { waypoints }| waypoints.iter().map(DriveTarget::from).collect();
        let targets = goal.read().map(|goal| goal.map(single)).or_else(|| goal.read().map(|goal| goal.map(several)))?;
        let mut targets: VecDeque<DriveTarget> = match targets {
            Ok(targets) => targets,
            Err(error) => return Some(Err(error)),
        };
        let Some(first) = targets.pop_front() else {
            return Some(Err(action_error(ErrorCode::Unknown, "there are no waypoints to follow".to_owned())));
        };
        state.advance_steered(robot);
        Some(state.set_target(robot, first).map(|()| {
            let mut task = state.get_mut::<DriveTask>(robot);
            (task.targets, task.next_targets) = (targets.len() + 1, targets);
            END_UNKNOWN
        }))
    }

    fn finish_goal(&self, state: &mut SimState, robot: Entity, _goal: &Goal) -> Result<GoalResult, ActionError> {
        state.end_drive(robot);
        Ok(GoalResult::default())
    }

    fn halt_goal(&self, state: &mut SimState, robot: Entity, _goal: &Goal) {
        state.end_drive(robot);
    }

    fn feedback(&self, state: &SimState, robot: Entity, goal: &Goal, usual: Feedback) -> Feedback {
        let progress = match goal.is::<FollowWaypoints>() {
            true => {
                let DriveTask { next_targets, targets, .. } = &*state.get::<DriveTask>(robot);
                let reached = targets.saturating_sub(next_targets.len() + 1);
                GoalProgress::Waypoint(u32::try_from(reached).unwrap_or(u32::MAX))
            }
            false => GoalProgress::Unspecified,
        };
        Feedback { progress, ..state.remaining_feedback(robot).unwrap_or(usual) }
    }

    fn on_timer(&self, state: &mut SimState, SystemTimer { entity: robot, .. }: SystemTimer) {
        state.get_mut::<DriveTask>(robot).timer = None;
        match state.take_stage(robot) {
            Stage::Driving(progress) => state.finish_part(robot, progress),
            Stage::AtDoor(progress, door) => state.on_door_timeout(robot, progress, door),
            stage @ (Stage::Idle | Stage::AtLift(_) | Stage::InLift) => {
                state.get_mut::<DriveTask>(robot).stage = stage;
            }
        }
    }

    fn on_event(&self, state: &mut SimState, event: &WorldEvent) {
        let entity_of = |robot: &RobotId| state.robots.get(robot).copied();
        match event {
            WorldEvent::DoorEntered { robot, .. } => {
                if let Some(robot) = entity_of(robot) {
                    state.enter_doorway(robot);
                }
            }
            WorldEvent::LiftEntered { robot, .. } => {
                if let Some(robot) = entity_of(robot) {
                    state.enter_lift(robot);
                }
            }
            WorldEvent::LiftLeft { robot, at, .. } => {
                if let Some((robot, at)) = entity_of(robot).zip(state.map.index(at)) {
                    state.leave_lift(robot, at);
                }
            }
            WorldEvent::LaneBlocked { .. } | WorldEvent::LaneCleared { .. } => state.recheck_obstacles(),
            _ => {}
        }
    }
}
