//! The interface of systems. A system simulates an aspect of the world, in its own file.
//!
//! A system has no state of its own: its state is in components of entities, or in resources. It
//! declares the components that it reads and writes, and can access no others ([`SimState`]
//! enforces this while debug assertions are on). A world consists of the systems that its setup
//! names. A new system of the simulator is a file in `systems/` and a line in [`systems::ALL`]; a program
//! can add systems of its own (see [`extend`](crate::extend)).
//!
//! | method | called when |
//! |---|---|
//! | [`init_world`](System::init_world), [`init_robot`](System::init_robot) | the world, or a robot in it, is created |
//! | [`check_goal_allowed`](System::check_goal_allowed) | any goal is about to start |
//! | [`begin_goal`](System::begin_goal), [`finish_goal`](System::finish_goal), [`halt_goal`](System::halt_goal) | a goal of this system starts, reaches its end, is interrupted |
//! | [`request_person`](System::request_person), [`cancel_person_request`](System::cancel_person_request) | a person request arrives, or is canceled |
//! | [`on_timer`](System::on_timer) | a timer of this system is due |
//! | [`step`](System::step) | a grid instant has come, while any system steps |
//! | [`on_event`](System::on_event) | any system logged an event |
//!
//! [`systems::ALL`]: super::systems::ALL

use super::event::WorldEvent;
use super::setup::{RobotSetup, WorldSetup};
use super::sim_state::SimState;
use super::system_access::{ComponentType, SystemTimer};
use consort_skills::actions::{ActionError, Feedback, Goal, GoalId, GoalResult, PersonRequest};
use hecs::Entity;

/// End time of a goal with an unknown end.
pub const END_UNKNOWN: f64 = f64::INFINITY;

/// A rule of the simulator that advances a single aspect of the world.
pub trait System: Send + Sync {
    /// Name of the system in setups.
    fn name(&self) -> &'static str;

    /// Components that the system reads, apart from those it writes.
    fn reads(&self) -> Vec<ComponentType>;

    /// Components that the system writes.
    fn writes(&self) -> Vec<ComponentType>;

    /// Adds the system's resources.
    fn init_world(&self, _state: &mut SimState, _setup: &WorldSetup) {}

    /// Adds the system's components to a new robot.
    fn init_robot(&self, _state: &mut SimState, _robot: Entity, _body: &RobotSetup) {}

    /// Checks whether this system allows a robot to start a goal, whichever system executes it.
    ///
    /// # Errors
    /// Reason for the rejection.
    fn check_goal_allowed(&self, _state: &SimState, _robot: Entity, _goal: &Goal) -> Result<(), ActionError> {
        Ok(())
    }

    /// Kinds of goals of this system, by the names of their standard actions; empty for a system of a program
    /// that does not distinguish kinds. The goals that it gets have these names as their actions, whatever
    /// the actions are called in domain files.
    fn goal_kinds(&self) -> &'static [&'static str] {
        &[]
    }

    /// Starts a goal of an action whose declaration names this system. Returns its end time, or the reason why
    /// it cannot start; `None` if this system does not execute such goals. A goal with an unknown end returns
    /// [`END_UNKNOWN`]. It ends when the system calls [`SimState::complete_goal`].
    fn begin_goal(&self, _state: &mut SimState, _robot: Entity, _goal: &Goal) -> Option<Result<f64, ActionError>> {
        None
    }

    /// Applies the effect of a goal at its end, if that is still possible, and returns its result.
    ///
    /// # Errors
    /// Reason why it is not. Nothing has changed then.
    fn finish_goal(&self, _state: &mut SimState, _robot: Entity, _goal: &Goal) -> Result<GoalResult, ActionError> {
        Ok(GoalResult::default())
    }

    /// Interrupts the active goal and leaves everything as it is now.
    fn halt_goal(&self, _state: &mut SimState, _robot: Entity, _goal: &Goal) {}

    /// Returns the feedback of the active goal. `usual` is the feedback common to all goals.
    fn feedback(&self, _state: &SimState, _robot: Entity, _goal: &Goal, usual: Feedback) -> Feedback {
        usual
    }

    /// Accepts a person request. Returns false if this system does not simulate people.
    fn request_person(&self, _state: &mut SimState, _id: GoalId, _ask: &PersonRequest) -> bool {
        false
    }

    /// Cancels a person request.
    fn cancel_person_request(&self, _state: &mut SimState, _id: GoalId) {}

    /// Brings state that cannot be computed ahead up to the current grid instant. Returns whether
    /// the system needs another step. While no system does, the world has no grid.
    /// [`SimState::start_stepping`] starts it.
    fn step(&self, _state: &mut SimState) -> bool {
        false
    }

    /// Handles a timer scheduled with [`SimState::schedule`].
    fn on_timer(&self, _state: &mut SimState, _wake: SystemTimer) {}

    /// Observes an event.
    fn on_event(&self, _state: &mut SimState, _what: &WorldEvent) {}
}
