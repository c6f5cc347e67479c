//! Current positions of robots, for displays and recordings.

use super::components::DepartureCount;
use super::location::RobotLocation;
use super::simulation::World;
use crate::map::LevelIndex;
use consort_protocol::ids::RobotId;
use consort_protocol::pose::Pose;

/// Position of a robot.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct MotionState {
    pub(crate) robot: RobotId,
    /// Level of the robot. In a lift, the level of the destination.
    pub(crate) level: LevelIndex,
    pub(crate) pose: Pose,
    /// Height above the floor, in metres.
    pub(crate) height_m: f64,
}

/// See [`World::motion_summary`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct MotionSummary {
    /// True if any robot moves or brakes.
    pub(crate) any_moving: bool,
    /// Number of departures of all robots so far, including those at each corner of a path.
    departures: u64,
}

impl World {
    /// Positions of all robots, in the order of their names.
    pub(crate) fn motion_states(&self) -> impl Iterator<Item = MotionState> {
        self.state.robots.iter().map(|(robot, entity)| {
            let location = *self.state.get::<RobotLocation>(*entity);
            let now = self.state.now;
            MotionState {
                robot: robot.clone(),
                level: self.state.map.place_at(location.map_position(now).last_place()).level,
                pose: location.pose(now),
                height_m: self.with_kinematic_model(robot, |model| model.position().z).unwrap_or_default(),
            }
        })
    }

    /// Summary of all motion. It is equal at two instants if no robot departed or stopped between
    /// them.
    pub(crate) fn motion_summary(&self) -> MotionSummary {
        let mut summary = MotionSummary::default();
        for robot in self.state.robots.values() {
            summary.any_moving |= self.state.is_moving(*robot);
            summary.departures += self.state.find::<DepartureCount>(*robot).map_or(0, |departures| departures.0);
        }
        summary
    }
}
