//! Drawers that people and arms reach into.

use crate::world::components::{Body, DrawerOpen};
use crate::world::floor::Floor;
use crate::world::journal::Happening;
use crate::world::reach::refused;
use crate::world::setup::RobotBody;
use crate::world::system::{Kind, System, kinds};
use consort_skills::actions::{ActionError, ErrorCode, Goal};
use hecs::Entity;

/// See the [module](self).
pub(crate) struct Drawer;

impl System for Drawer {
    fn name(&self) -> &'static str {
        "drawer"
    }

    fn reads(&self) -> Vec<Kind> {
        kinds![Body]
    }

    fn writes(&self) -> Vec<Kind> {
        kinds![DrawerOpen]
    }

    fn equip(&self, floor: &mut Floor, robot: Entity, _body: &RobotBody) {
        floor.give(robot, DrawerOpen(false));
    }

    fn begin(&self, floor: &mut Floor, robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        let Goal::OperateDrawer { .. } = goal else { return None };
        if !floor.get::<Body>(robot).0.has_drawer {
            let message = format!("{} has no drawer", floor.name(robot));
            return Some(Err(refused(ErrorCode::DrawerState, message)));
        }
        Some(Ok(floor.now + floor.durations.operate_drawer_s))
    }

    fn finish(&self, floor: &mut Floor, robot: Entity, goal: &Goal) -> Result<(), ActionError> {
        let Goal::OperateDrawer { open } = *goal else { return Ok(()) };
        let was_open = std::mem::replace(&mut floor.get_mut::<DrawerOpen>(robot).0, open);
        if was_open != open {
            floor.note(Happening::Drawer { robot: floor.name(robot), open });
        }
        Ok(())
    }
}
