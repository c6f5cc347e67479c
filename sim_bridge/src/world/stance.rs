//! Where robots are at this moment, for whoever draws them.

use super::World;
use super::components::Departures;
use super::whereabouts::Whereabouts;
use crate::map::LevelIndex;
use consort_protocol::ids::RobotId;
use consort_protocol::pose::Pose;

/// Where a robot is.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Stance {
    pub(crate) robot: RobotId,
    /// The level it is on, or that of the stop to which a lift takes it.
    pub(crate) level: LevelIndex,
    pub(crate) pose: Pose,
    /// How far above the floor it hovers, in metres.
    pub(crate) height_m: f64,
}

/// See [`World::motion`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Motion {
    /// Whether any robot is under way, or still braking.
    pub(crate) moves: bool,
    /// How often robots have set off by now, all of them together: at each corner of their ways, too.
    departures: u64,
}

impl World {
    /// Where all robots are, in the order of their names.
    pub(crate) fn stances(&self) -> impl Iterator<Item = Stance> {
        self.floor.robots.iter().map(|(robot, entity)| {
            let whereabouts = *self.floor.get::<Whereabouts>(*entity);
            let now = self.floor.now;
            Stance {
                robot: robot.clone(),
                level: self.floor.map.at(whereabouts.spot(now).last_place()).level,
                pose: whereabouts.pose(now),
                height_m: self.mover(robot).map_or(0.0, |mover| mover.position().z),
            }
        })
    }

    /// What moves at this moment: equal for two instants between which no robot set off or came to rest.
    pub(crate) fn motion(&self) -> Motion {
        let mut motion = Motion::default();
        for robot in self.floor.robots.values() {
            motion.moves |= self.floor.is_under_way(*robot);
            motion.departures += self.floor.find::<Departures>(*robot).map_or(0, |departures| departures.0);
        }
        motion
    }
}
