//! What a goal needs and what it brings about.
//!
//! One function decides both, in values: [`World::effect`] says what a goal would change if it ended now, or why it
//! cannot. It is asked when a goal begins, and again when it ends; only then is the effect carried out.

use super::World;
use super::components::{Beside, Body, Departures, DrawerOpen, Label, Who};
use super::journal::Happening;
use super::motion::Spot;
use super::samples::Holder;
use crate::map::PlaceIndex;
use crate::suggest::did_you_mean;
use consort_protocol::ids::{RobotId, RoleId};
use consort_skills::actions::{ActionError, ErrorCode, Goal};
use hecs::Entity;

/// An error for a robot that asked for what cannot be.
pub(super) fn refused(code: ErrorCode, message: String) -> ActionError {
    ActionError { code, message }
}

/// A goal's name for people.
pub(super) fn verb(goal: &Goal) -> &'static str {
    match goal {
        Goal::NavigateToPose { .. } => "navigate_to_pose",
        Goal::ApproachPerson { .. } => "approach_person",
        Goal::AuthenticatePerson { .. } => "authenticate_person",
        Goal::OperateDrawer { .. } => "operate_drawer",
        Goal::ApproachRobot { .. } => "approach_robot",
        Goal::PickUp { .. } => "pick_up",
        Goal::Deposit { .. } => "deposit",
        Goal::Wait { .. } => "wait",
    }
}

/// What a goal changes when it ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Effect {
    Nothing,
    Beside(Beside),
    Drawer {
        open: bool,
    },
    HandOver {
        sample: Entity,
        to: Holder,
    },
    /// A fixed arm lays what it holds on the table beside it, then takes the next.
    Exchange {
        held: Entity,
        table: Holder,
        sample: Entity,
        to: Holder,
    },
}

impl World {
    /// What `goal` changes for `robot` if it ends now.
    pub(super) fn effect(&self, robot: Entity, goal: &Goal) -> Result<Effect, ActionError> {
        match goal {
            Goal::NavigateToPose { .. } | Goal::Wait { .. } => Ok(Effect::Nothing),
            Goal::ApproachPerson { role } => self.approach_person(robot, role),
            Goal::AuthenticatePerson { role } => self.authenticate_person(robot, role),
            Goal::OperateDrawer { open } => self.operate_drawer(robot, *open),
            Goal::ApproachRobot { robot: other } => self.approach_robot(robot, other),
            Goal::PickUp { from } => self.pick_up(robot, from),
            Goal::Deposit { into } => self.deposit(robot, into.as_ref()),
        }
    }

    /// How long `goal` takes; driving aside, which takes what the way takes.
    pub(super) fn duration(&self, goal: &Goal) -> f64 {
        match goal {
            Goal::NavigateToPose { .. } => 0.0,
            Goal::ApproachPerson { .. } => self.durations.approach_person_s,
            Goal::AuthenticatePerson { .. } => self.durations.authenticate_person_s,
            Goal::OperateDrawer { .. } => self.durations.operate_drawer_s,
            Goal::ApproachRobot { .. } => self.durations.approach_robot_s,
            Goal::PickUp { .. } => self.durations.pick_up_s,
            Goal::Deposit { .. } => self.durations.deposit_s,
            Goal::Wait { time } => time.get(),
        }
    }

    pub(super) fn carry_out(&mut self, robot: Entity, effect: Effect) {
        match effect {
            Effect::Nothing => {}
            Effect::Beside(beside) => *self.get_mut::<Beside>(robot) = beside,
            Effect::Drawer { open } => {
                let was_open = std::mem::replace(&mut self.get_mut::<DrawerOpen>(robot).0, open);
                if was_open != open {
                    self.note(Happening::Drawer { robot: self.name(robot), open });
                }
            }
            Effect::HandOver { sample, to } => self.hand_over(sample, to),
            Effect::Exchange { held, table, sample, to } => {
                self.hand_over(held, table);
                self.hand_over(sample, to);
            }
        }
    }

    fn approach_person(&self, robot: Entity, role: &RoleId) -> Result<Effect, ActionError> {
        let place = self.standing_place(robot)?;
        let is_here = |person: &&Entity| {
            let who = self.get::<Who>(**person);
            who.role == *role && who.place == place
        };
        match self.people.values().find(is_here) {
            Some(person) => Ok(Effect::Beside(Beside::Person { person: *person, authenticated: false })),
            None => {
                let message = format!("{}: no {role} is at {}", self.name(robot), self.map.at(place).id);
                Err(refused(ErrorCode::OutOfReach, message))
            }
        }
    }

    fn authenticate_person(&self, robot: Entity, role: &RoleId) -> Result<Effect, ActionError> {
        let Beside::Person { person, .. } = *self.get::<Beside>(robot) else {
            let message = format!("{} has not approached a {role}", self.name(robot));
            return Err(refused(ErrorCode::OutOfReach, message));
        };
        let who = self.get::<Who>(person);
        if who.role != *role {
            let message = format!("{}: {} is a {}, not a {role}", self.name(robot), who.name, who.role);
            return Err(refused(ErrorCode::NotAuthenticated, message));
        }
        Ok(Effect::Beside(Beside::Person { person, authenticated: true }))
    }

    fn operate_drawer(&self, robot: Entity, open: bool) -> Result<Effect, ActionError> {
        if self.get::<Body>(robot).0.has_drawer {
            return Ok(Effect::Drawer { open });
        }
        Err(refused(ErrorCode::DrawerState, format!("{} has no drawer", self.name(robot))))
    }

    fn approach_robot(&self, robot: Entity, other: &RobotId) -> Result<Effect, ActionError> {
        let other = self.other_robot(robot, other)?;
        self.same_place(robot, other)?;
        Ok(Effect::Beside(Beside::Robot { robot: other, departures: self.get::<Departures>(other).0 }))
    }

    fn pick_up(&self, robot: Entity, from: &RobotId) -> Result<Effect, ActionError> {
        let from = self.other_robot(robot, from)?;
        let held = self.in_arm(robot)?;
        if let Some(held) = held.filter(|_| self.get::<Body>(robot).0.mobile) {
            let message = format!("{} already holds {}", self.name(robot), self.label(held));
            return Err(refused(ErrorCode::Busy, message));
        }
        self.open_drawer_in_reach(robot, from)?;
        let to = Holder::Arm(robot);
        match (self.held(Holder::Drawer(from)).first().copied(), held) {
            (Some(sample), None) => Ok(Effect::HandOver { sample, to }),
            (Some(sample), Some(held)) => {
                let table = Holder::Table(self.standing_place(robot)?);
                Ok(Effect::Exchange { held, table, sample, to })
            }
            (None, _) => Err(refused(ErrorCode::DrawerState, format!("the drawer of {} is empty", self.name(from)))),
        }
    }

    fn deposit(&self, robot: Entity, into: Option<&RobotId>) -> Result<Effect, ActionError> {
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
        Ok(Effect::HandOver { sample, to })
    }

    /// What a robot's arm holds, if anything; an error for a robot without an arm.
    fn in_arm(&self, robot: Entity) -> Result<Option<Entity>, ActionError> {
        if !self.get::<Body>(robot).0.has_arm {
            return Err(refused(ErrorCode::OutOfReach, format!("{} has no arm", self.name(robot))));
        }
        Ok(self.held(Holder::Arm(robot)).first().copied())
    }

    fn open_drawer_in_reach(&self, robot: Entity, other: Entity) -> Result<(), ActionError> {
        self.same_place(robot, other)?;
        let (name, others) = (self.name(robot), self.name(other));
        if !self.is_beside(robot, other) && !self.is_beside(other, robot) {
            let message = format!("neither of {name} and {others} has approached the other");
            return Err(refused(ErrorCode::OutOfReach, message));
        }
        if !self.get::<Body>(other).0.has_drawer {
            return Err(refused(ErrorCode::DrawerState, format!("{others} has no drawer")));
        }
        if !self.get::<DrawerOpen>(other).0 {
            return Err(refused(ErrorCode::DrawerState, format!("the drawer of {others} is closed")));
        }
        Ok(())
    }

    pub(super) fn room_in_drawer(&self, robot: Entity) -> Result<(), ActionError> {
        let held = self.held(Holder::Drawer(robot));
        if held.len() < self.limits.drawer_slots {
            return Ok(());
        }
        let labels: Vec<String> = held.into_iter().map(|sample| self.label(sample)).collect();
        let message = format!("the drawer of {} is full: it holds {}", self.name(robot), labels.join(", "));
        Err(refused(ErrorCode::DrawerState, message))
    }

    fn is_beside(&self, robot: Entity, other: Entity) -> bool {
        let departures = self.get::<Departures>(other).0;
        *self.get::<Beside>(robot) == Beside::Robot { robot: other, departures }
    }

    fn same_place(&self, robot: Entity, other: Entity) -> Result<(), ActionError> {
        let place = self.standing_place(robot)?;
        let spot = self.spot(other);
        if spot == Spot::Place(place) {
            return Ok(());
        }
        let (name, others) = (self.name(robot), self.name(other));
        let message = format!("{name} is at {}, {others} {}", self.map.at(place).id, spot.describe(&self.map));
        Err(refused(ErrorCode::OutOfReach, message))
    }

    fn standing_place(&self, robot: Entity) -> Result<PlaceIndex, ActionError> {
        match self.spot(robot) {
            Spot::Place(place) => Ok(place),
            spot @ (Spot::Lane { .. } | Spot::Floor { .. }) => {
                let message = format!("{} is {}, at no place", self.name(robot), spot.describe(&self.map));
                Err(refused(ErrorCode::OutOfReach, message))
            }
        }
    }

    fn other_robot(&self, robot: Entity, other: &RobotId) -> Result<Entity, ActionError> {
        match self.robots.get(other) {
            Some(found) if *found == robot => {
                Err(refused(ErrorCode::Unknown, format!("{other} cannot do this with itself")))
            }
            Some(found) => Ok(*found),
            None => Err(self.no_robot(other)),
        }
    }

    pub(super) fn no_robot(&self, id: &RobotId) -> ActionError {
        let hint = did_you_mean(id.as_str(), self.robots.keys().map(RobotId::as_str));
        refused(ErrorCode::Unknown, format!("there is no robot {id} here{hint}"))
    }

    pub(super) fn name(&self, robot: Entity) -> RobotId {
        self.get::<Body>(robot).0.id.clone()
    }

    fn label(&self, sample: Entity) -> String {
        self.get::<Label>(sample).0.to_string()
    }
}
