//! How fast a robot drives, changed from outside: a crowd in the corridor, a worn tyre, a trial of an evaluation.

use super::World;
use super::components::SimRobot;
use consort_protocol::ids::RobotId;
use consort_protocol::units::MetresPerSecond;

impl World {
    /// From its next drive on a robot drives so fast; one under way is not affected. Of a robot that is not here nothing is
    /// said.
    pub fn set_speed(&mut self, robot: &RobotId, speed: MetresPerSecond) {
        if let Some(robot) = self.state.robots.get(robot).copied() {
            self.state.get_mut::<SimRobot>(robot).0.speed = speed;
        }
    }
}
