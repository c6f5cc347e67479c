//! Arms that take things out of drawers and off tables, as far as they reach and as much as they lift, and put them down.

use crate::world::components::{Beside, Body, Departures, DrawerOpen, Label, Who};
use crate::world::floor::Floor;
use crate::world::reach::refused;
use crate::world::samples::{Custody, Handovers, Holder, Load};
use crate::world::system::{Kind, System, kinds};
use crate::world::whereabouts::Whereabouts;
use consort_protocol::ids::RobotId;
use consort_skills::actions::{ActionError, ErrorCode, Goal};
use hecs::Entity;

/// What changes hands: each thing, and to whom, in this order.
type Moves = Vec<(Entity, Holder)>;

/// See the [module](self).
pub(crate) struct Arm;

impl System for Arm {
    fn name(&self) -> &'static str {
        "arm"
    }

    fn reads(&self) -> Vec<Kind> {
        kinds![Beside, Body, Departures, DrawerOpen, Label, Whereabouts, Who]
    }

    fn writes(&self) -> Vec<Kind> {
        kinds![Custody, Handovers, Load]
    }

    fn begin(&self, floor: &mut Floor, robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        let takes = match goal {
            Goal::PickUp { .. } | Goal::Grasp { .. } => floor.durations.pick_up_s,
            Goal::Deposit { .. } => floor.durations.deposit_s,
            _ => return None,
        };
        Some(floor.moves(robot, goal).map(|_| floor.now + takes))
    }

    fn finish(&self, floor: &mut Floor, robot: Entity, goal: &Goal) -> Result<(), ActionError> {
        for (thing, to) in floor.moves(robot, goal)? {
            floor.get_mut::<Load>(thing).distance_m = 0.0;
            floor.hand_over(thing, to);
        }
        Ok(())
    }
}

impl Floor {
    /// What would change hands if the goal ended now.
    fn moves(&self, robot: Entity, goal: &Goal) -> Result<Moves, ActionError> {
        match goal {
            Goal::PickUp { from } => self.pick_up(robot, from),
            Goal::Grasp { object } => self.grasp(robot, object),
            Goal::Deposit { into } => self.deposit(robot, into.as_ref()),
            _ => Ok(vec![]),
        }
    }

    fn pick_up(&self, robot: Entity, from: &RobotId) -> Result<Moves, ActionError> {
        let from = self.other_robot(robot, from)?;
        let held = self.in_arm(robot)?;
        if let Some(held) = held.filter(|_| self.get::<Body>(robot).0.mobile) {
            let message = format!("{} already holds {}", self.name(robot), self.label(held));
            return Err(refused(ErrorCode::Busy, message));
        }
        self.open_drawer_in_reach(robot, from)?;
        let to = Holder::Arm(robot);
        if let Some(sample) = self.held(Holder::Drawer(from)).first() {
            self.within_strength(robot, *sample)?;
        }
        match (self.held(Holder::Drawer(from)).first().copied(), held) {
            (Some(sample), None) => Ok(vec![(sample, to)]),
            (Some(sample), Some(held)) => {
                // A fixed arm lays what it holds on the table beside it, then takes the next.
                let table = Holder::Table(self.standing_place(robot)?);
                Ok(vec![(held, table), (sample, to)])
            }
            (None, _) => Err(refused(ErrorCode::DrawerState, format!("the drawer of {} is empty", self.name(from)))),
        }
    }

    fn grasp(&self, robot: Entity, object: &str) -> Result<Moves, ActionError> {
        let place = self.standing_place(robot)?;
        if let Some(held) = self.in_arm(robot)? {
            let message = format!("{} already holds {}", self.name(robot), self.label(held));
            return Err(refused(ErrorCode::Busy, message));
        }
        let there = self.held(Holder::Table(place));
        let Some(thing) = there.iter().copied().find(|thing| self.label(*thing) == object) else {
            let labels: Vec<String> = there.iter().map(|thing| self.label(*thing)).collect();
            let lies = if labels.is_empty() { "nothing".to_owned() } else { labels.join(", ") };
            let message = format!("no {object:?} lies at {}; there lies: {lies}", self.map.at(place).id);
            return Err(refused(ErrorCode::OutOfReach, message));
        };
        let (distance_m, reach_m) = (self.get::<Load>(thing).distance_m, self.get::<Body>(robot).0.reach_m);
        if distance_m > reach_m {
            let message = format!("{object} is {distance_m} m away, {} reaches {reach_m} m", self.name(robot));
            return Err(refused(ErrorCode::OutOfReach, message));
        }
        self.within_strength(robot, thing)?;
        Ok(vec![(thing, Holder::Arm(robot))])
    }

    fn within_strength(&self, robot: Entity, thing: Entity) -> Result<(), ActionError> {
        let (weight_kg, most) = (self.get::<Load>(thing).weight_kg, self.get::<Body>(robot).0.payload_max_kg);
        if weight_kg <= most {
            return Ok(());
        }
        let message = format!("{} weighs {weight_kg} kg, {} lifts {most} kg", self.label(thing), self.name(robot));
        Err(refused(ErrorCode::TooHeavy, message))
    }

    fn deposit(&self, robot: Entity, into: Option<&RobotId>) -> Result<Moves, ActionError> {
        let Some(sample) = self.in_arm(robot)? else {
            return Err(refused(ErrorCode::DrawerState, format!("{} holds nothing", self.name(robot))));
        };
        let to = match into {
            None => Holder::Table(self.standing_place(robot)?),
            Some(into) => {
                let into = self.other_robot(robot, into)?;
                self.open_drawer_in_reach(robot, into)?;
                self.room_in_drawer(into)?;
                Holder::Drawer(into)
            }
        };
        Ok(vec![(sample, to)])
    }

    /// What a robot's arm holds, if anything; an error for a robot without an arm.
    fn in_arm(&self, robot: Entity) -> Result<Option<Entity>, ActionError> {
        if !self.get::<Body>(robot).0.has_arm {
            return Err(refused(ErrorCode::OutOfReach, format!("{} has no arm", self.name(robot))));
        }
        Ok(self.held(Holder::Arm(robot)).first().copied())
    }
}
