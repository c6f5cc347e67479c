//! Turning on the spot.

use crate::world::components::Body;
use crate::world::floor::Floor;
use crate::world::reach::refused;
use crate::world::system::{Kind, System, kinds};
use crate::world::systems::steering::Steered;
use crate::world::whereabouts::Whereabouts;
use consort_protocol::pose::Pose;
use consort_skills::actions::{ActionError, ErrorCode, Goal};
use hecs::Entity;

/// Radians per second at which robots turn: Nav2's greatest for its spin behavior.
const TURN_RADPS: f64 = 1.0;

/// Most that a robot turns at a time, either way: a hundred times round.
const TURN_MAX_RAD: f64 = 200.0 * std::f64::consts::PI;

/// See the [module](self).
pub(crate) struct Turning;

impl System for Turning {
    fn name(&self) -> &'static str {
        "turning"
    }

    fn reads(&self) -> Vec<Kind> {
        kinds![Body]
    }

    fn writes(&self) -> Vec<Kind> {
        kinds![Whereabouts, Steered]
    }

    fn begin(&self, floor: &mut Floor, robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        let Goal::Spin { angle_rad } = *goal else { return None };
        let body = &floor.get::<Body>(robot).0;
        if !body.mobile {
            return Some(Err(refused(ErrorCode::Unknown, format!("{} cannot turn", body.id))));
        }
        if !(-TURN_MAX_RAD..=TURN_MAX_RAD).contains(&angle_rad) {
            let message =
                format!("{angle_rad} rad is no angle to turn by, allowed is -{TURN_MAX_RAD:.0} to {TURN_MAX_RAD:.0}");
            return Some(Err(refused(ErrorCode::Unknown, message)));
        }
        Some(Ok(floor.now + angle_rad.abs() / TURN_RADPS))
    }

    fn finish(&self, floor: &mut Floor, robot: Entity, goal: &Goal) -> Result<(), ActionError> {
        let Goal::Spin { angle_rad } = *goal else { return Ok(()) };
        if let Whereabouts::Standing { pose, .. } = &mut *floor.get_mut::<Whereabouts>(robot) {
            let yaw = pose.yaw + angle_rad;
            *pose = Pose::new(pose.x, pose.y, yaw.sin().atan2(yaw.cos()));
            if let Some(mut steered) = floor.find_mut::<Steered>(robot) {
                steered.mover.turn_to(pose.yaw);
            }
        }
        Ok(())
    }
}
