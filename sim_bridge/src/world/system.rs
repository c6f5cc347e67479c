//! What a system is: one thing that happens on the floor, in a file of its own.
//!
//! A system has no state: all it knows is in components of entities, or in components of the floor itself. It says which
//! it reads and which it writes, and can get at no others ([`Floor`] sees to that wherever debug assertions are on). A world
//! is made of the systems that its setup names; a new one is a file in `systems/` and a line in [`systems::ALL`].
//!
//! | it is asked | when |
//! |---|---|
//! | [`furnish`](System::furnish), [`equip`](System::equip) | the floor, or a robot on it, comes to be |
//! | [`permit`](System::permit) | any goal is to begin |
//! | [`begin`](System::begin), [`finish`](System::finish), [`halt`](System::halt) | a goal that it carries out begins, reaches its end, is broken off |
//! | [`ask`](System::ask), [`dismiss`](System::dismiss) | somebody asks a person for something, or no longer does |
//! | [`wake`](System::wake) | an instant has come that it arranged |
//! | [`step`](System::step) | an instant of the world's grid has come, while anything steps |
//! | [`observe`](System::observe) | something happened, by whatever system |
//!
//! [`systems::ALL`]: super::systems::ALL

use super::event_log::WorldEvent;
use super::setup::{RobotSetup, WorldSetup};
use super::sim_state::SimState;
use consort_skills::actions::{ActionError, Feedback, Goal, GoalId, PersonRequest};
use hecs::{Component, Entity};
use std::any::TypeId;

/// A type of component.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ComponentType {
    id: TypeId,
    name: &'static str,
}

impl ComponentType {
    /// The type of `T`.
    pub(crate) fn of<T: Component>() -> ComponentType {
        ComponentType { id: TypeId::of::<T>(), name: std::any::type_name::<T>() }
    }

    /// Whether it is the type of this number.
    pub(crate) fn is(self, id: TypeId) -> bool {
        self.id == id
    }

    /// Its name, without its path.
    pub(crate) fn name(self) -> &'static str {
        self.name.rsplit("::").next().unwrap_or(self.name)
    }
}

/// The types named, as [`Kind`]s.
macro_rules! kinds {
    ($($component:ty),* $(,)?) => { vec![$($crate::world::system::ComponentType::of::<$component>()),*] };
}
pub(crate) use kinds;

/// When a goal ends whose end is not known beforehand.
pub(crate) const END_UNKNOWN: f64 = f64::INFINITY;

/// What a system arranged for an instant to come, for itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct SystemTimer {
    /// The entity it is about.
    pub(crate) entity: Entity,
    /// Whatever the system tells its wakes apart by.
    pub(crate) number: u64,
}

/// One thing that happens on the floor.
pub(crate) trait System: Sync {
    /// What setups call it.
    fn name(&self) -> &'static str;

    /// The components it looks at, beside those that it writes.
    fn reads(&self) -> Vec<ComponentType>;

    /// The components it changes.
    fn writes(&self) -> Vec<ComponentType>;

    /// Gives the floor itself what the system needs.
    fn init_world(&self, _floor: &mut SimState, _setup: &WorldSetup) {}

    /// Gives a new robot what the system needs.
    fn init_robot(&self, _floor: &mut SimState, _robot: Entity, _body: &RobotSetup) {}

    /// Whether a robot may begin a goal as far as this system is concerned, whoever carries it out.
    ///
    /// # Errors
    /// Why it may not.
    fn check_goal_allowed(&self, _floor: &SimState, _robot: Entity, _goal: &Goal) -> Result<(), ActionError> {
        Ok(())
    }

    /// Begins a goal: when it will end, or why it cannot begin; `None` if this system does not carry out such goals. A goal
    /// whose end is not known beforehand ends at [`LATER`], that is, when the system says [`Floor::achieve`].
    fn begin_goal(&self, _floor: &mut SimState, _robot: Entity, _goal: &Goal) -> Option<Result<f64, ActionError>> {
        None
    }

    /// The goal has come to its end: brings about what it is for, if it still can.
    ///
    /// # Errors
    /// Why it cannot: nothing has changed then.
    fn finish_goal(&self, _floor: &mut SimState, _robot: Entity, _goal: &Goal) -> Result<(), ActionError> {
        Ok(())
    }

    /// The goal under way is broken off: leaves everything as it is now.
    fn halt_goal(&self, _floor: &mut SimState, _robot: Entity, _goal: &Goal) {}

    /// How far a goal under way has come: `usual` is what is known of any goal.
    fn feedback(&self, _floor: &SimState, _robot: Entity, _goal: &Goal, usual: Feedback) -> Feedback {
        usual
    }

    /// Takes an ask of a person; false if this system knows nothing of people.
    fn request_person(&self, _floor: &mut SimState, _id: GoalId, _ask: &PersonRequest) -> bool {
        false
    }

    /// Withdraws an ask.
    fn cancel_person_request(&self, _floor: &mut SimState, _id: GoalId) {}

    /// An instant of the grid: brings up to now what cannot be computed ahead. Whether it has anything more to step; while
    /// no system has, the world has no grid, and nothing to do. [`Floor::step_on`] begins it.
    fn step(&self, _floor: &mut SimState) -> bool {
        false
    }

    /// An instant that it arranged with [`Floor::arrange`].
    fn on_timer(&self, _floor: &mut SimState, _wake: SystemTimer) {}

    /// Something happened.
    fn on_event(&self, _floor: &mut SimState, _what: &WorldEvent) {}
}
