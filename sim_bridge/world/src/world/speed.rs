//! Changes of a robot's speed from outside: a crowd in the corridor, a worn tyre, a trial of an
//! evaluation.

use super::components::SimRobot;
use super::simulation::World;
use consort_protocol::ids::RobotId;
use consort_protocol::units::MetresPerSecond;

impl World {
    /// Sets the speed of a robot from its next drive on. The current drive is not affected. An
    /// unknown robot is ignored.
    pub fn set_speed(&mut self, robot: &RobotId, speed: MetresPerSecond) {
        if let Some(robot) = self.state.robots.get(robot).copied() {
            self.state.get_mut::<SimRobot>(robot).0.speed = speed;
        }
    }
}
