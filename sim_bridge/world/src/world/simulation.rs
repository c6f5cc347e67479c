//! The simulated world: its state and its systems.

use super::action_systems::ActionSystems;
use super::sim_state::SimState;
use super::system::System;
use super::system_access::{RunningSystem, SystemIndex};
use crate::map::Map;

/// A simulated world. Created by [`World::new`], driven through
/// [`RobotBackend`](consort_skills::actions::RobotBackend).
pub struct World {
    pub(super) state: SimState,
    pub(super) systems: Vec<&'static dyn System>,
    pub(super) actions: ActionSystems,
}

impl World {
    pub(super) fn with(state: SimState, systems: Vec<&'static dyn System>, actions: ActionSystems) -> World {
        World { state, systems, actions }
    }

    /// The map.
    pub fn map(&self) -> &Map {
        &self.state.map
    }

    /// The state of the simulation, for reading.
    pub fn state(&self) -> &SimState {
        &self.state
    }

    pub(super) fn system(&self, index: SystemIndex) -> &'static dyn System {
        self.systems[index.0]
    }

    pub(super) fn system_indices(&self) -> impl Iterator<Item = SystemIndex> + use<> {
        (0..self.systems.len()).map(SystemIndex)
    }

    /// Runs `run` as the system with this index.
    pub(super) fn run_system<T>(&mut self, index: SystemIndex, run: impl FnOnce(&dyn System, &mut SimState) -> T) -> T {
        let system = self.system(index);
        // The lists are only needed for the check.
        let (reads, writes) = if cfg!(debug_assertions) { (system.reads(), system.writes()) } else { (vec![], vec![]) };
        let running = RunningSystem { index, name: system.name(), reads, writes };
        self.state.run_as_system(running, |state| run(system, state))
    }

    /// Runs `run` as each of the systems in turn.
    pub(super) fn for_each_system(&mut self, mut run: impl FnMut(&dyn System, &mut SimState)) {
        for index in self.system_indices() {
            self.run_system(index, &mut run);
        }
    }

    /// Runs `run` as a given system on behalf of a caller from outside, if the system is part of
    /// this world.
    pub(super) fn run_as(&mut self, caller: &dyn System, run: impl FnOnce(&mut SimState)) {
        if let Some(place) = self.systems.iter().position(|system| system.name() == caller.name()) {
            self.run_system(SystemIndex(place), |_, state| run(state));
            self.process_commands_and_defer();
        }
    }
}

impl std::fmt::Debug for World {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("World")
            .field("map", &self.state.map.name())
            .field("now", &self.state.now)
            .field("robots", &self.state.robots.len())
            .field("people", &self.state.people.len())
            .field("due", &self.state.queue.len())
            .finish_non_exhaustive()
    }
}
