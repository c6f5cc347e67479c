//! Where robots are at this moment, for whoever draws them.

use super::World;
use super::components::DepartureCount;
use super::location::RobotLocation;
use crate::map::LevelIndex;
use consort_protocol::ids::RobotId;
use consort_protocol::pose::Pose;

/// Where a robot is.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct MotionState {
    pub(crate) robot: RobotId,
    /// The level it is on, or that of the stop to which a lift takes it.
    pub(crate) level: LevelIndex,
    pub(crate) pose: Pose,
    /// How far above the floor it hovers, in metres.
    pub(crate) height_m: f64,
}

/// See [`World::motion`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct MotionSummary {
    /// Whether any robot is under way, or still braking.
    pub(crate) any_moving: bool,
    /// How often robots have set off by now, all of them together: at each corner of their ways, too.
    departures: u64,
}

impl World {
    /// Where all robots are, in the order of their names.
    pub(crate) fn motion_states(&self) -> impl Iterator<Item = MotionState> {
        self.state.robots.iter().map(|(robot, entity)| {
            let whereabouts = *self.state.get::<RobotLocation>(*entity);
            let now = self.state.now;
            MotionState {
                robot: robot.clone(),
                level: self.state.map.place_at(whereabouts.map_position(now).last_place()).level,
                pose: whereabouts.pose(now),
                height_m: self.kinematic_model(robot).map_or(0.0, |mover| mover.position().z),
            }
        })
    }

    /// What moves at this moment: equal for two instants between which no robot set off or came to rest.
    pub(crate) fn motion_summary(&self) -> MotionSummary {
        let mut motion = MotionSummary::default();
        for robot in self.state.robots.values() {
            motion.any_moving |= self.state.is_moving(*robot);
            motion.departures += self.state.find::<DepartureCount>(*robot).map_or(0, |departures| departures.0);
        }
        motion
    }
}
