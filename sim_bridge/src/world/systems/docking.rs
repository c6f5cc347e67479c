//! Chargers: a robot that docks at one charges until it undocks or drives off.

use crate::map::PlaceKind;
use crate::world::components::Body;
use crate::world::floor::Floor;
use crate::world::goals::GoalBook;
use crate::world::journal::Happening;
use crate::world::reach::refused;
use crate::world::setup::RobotBody;
use crate::world::system::{Kind, System, kinds};
use crate::world::whereabouts::Whereabouts;
use consort_protocol::ids::PlaceId;
use consort_skills::actions::{ActionError, ErrorCode, Goal};
use hecs::Entity;

/// Whether a robot is connected to the charger at its place.
pub(crate) struct Docked(pub(crate) bool);

/// See the [module](self).
pub(crate) struct Docking;

impl System for Docking {
    fn name(&self) -> &'static str {
        "docking"
    }

    fn reads(&self) -> Vec<Kind> {
        kinds![Body, GoalBook, Whereabouts]
    }

    fn writes(&self) -> Vec<Kind> {
        kinds![Docked]
    }

    fn equip(&self, floor: &mut Floor, robot: Entity, _body: &RobotBody) {
        floor.give(robot, Docked(false));
    }

    fn begin(&self, floor: &mut Floor, robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        let takes = floor.durations.dock_s;
        let may = match goal {
            Goal::Dock { charger } => floor.charger_here(robot, charger.as_ref()),
            Goal::Undock if !floor.get::<Docked>(robot).0 => {
                Err(refused(ErrorCode::Charger, format!("{} is not docked", floor.name(robot))))
            }
            Goal::Undock => Ok(()),
            _ => return None,
        };
        Some(may.map(|()| floor.now + takes))
    }

    fn finish(&self, floor: &mut Floor, robot: Entity, goal: &Goal) -> Result<(), ActionError> {
        if let Goal::Dock { charger } = goal {
            floor.charger_here(robot, charger.as_ref())?;
        }
        floor.connect(robot, matches!(goal, Goal::Dock { .. }));
        Ok(())
    }

    fn observe(&self, floor: &mut Floor, what: &Happening) {
        if let Happening::GoalBegan { robot, goal, .. } = what
            && let Goal::NavigateToPose { .. } | Goal::FollowWaypoints { .. } | Goal::Spin { .. } = goal
            && let Some(robot) = floor.robots.get(robot).copied()
        {
            floor.connect(robot, false);
        }
    }
}

impl Floor {
    /// Whether the robot stands at a charger, and at the one that is meant.
    fn charger_here(&self, robot: Entity, meant: Option<&PlaceId>) -> Result<(), ActionError> {
        let place = self.map.at(self.standing_place(robot)?);
        if let Some(meant) = meant {
            let Some(charger) = self.map.place(meant) else {
                let message = format!("there is no place {:?} here{}", meant.as_str(), self.map.suggest(meant));
                return Err(refused(ErrorCode::Unknown, message));
            };
            if charger.id != place.id {
                let message = format!("{} is at {}, not at {meant}", self.name(robot), place.id);
                return Err(refused(ErrorCode::OutOfReach, message));
            }
        }
        if place.kind != PlaceKind::Charger {
            return Err(refused(ErrorCode::Charger, format!("{} is no charger", place.id)));
        }
        Ok(())
    }

    fn connect(&mut self, robot: Entity, docked: bool) {
        let was = std::mem::replace(&mut self.get_mut::<Docked>(robot).0, docked);
        if was != docked {
            self.note(Happening::Docked { robot: self.name(robot), docked });
        }
    }
}
