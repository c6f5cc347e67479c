//! Parts of the simulator that the program itself adds.

use super::setup::{ProgramParts, SetupError, WorldSetup};
use super::system::System;
use super::systems;
use crate::kinematics::NamedChassis;
use consort_skills::extensions::Extensions;
use std::collections::BTreeSet;

/// Parts of the simulator that a program adds; see [`extend`](crate::extend).
pub struct SimulatorExtension {
    /// Systems. Their names differ from those of the shipped systems.
    pub systems: &'static [&'static dyn System],
    /// Chassis, by name.
    pub chassis: &'static [NamedChassis],
}

impl SimulatorExtension {
    /// Returns the parts of a program, if it adds any.
    pub fn of(extensions: Extensions) -> Option<&'static SimulatorExtension> {
        ProgramParts(extensions.simulator).extension()
    }
}

impl ProgramParts {
    fn extension(self) -> Option<&'static SimulatorExtension> {
        self.0?.downcast_ref()
    }

    fn systems(self) -> impl Iterator<Item = &'static dyn System> {
        self.extension().into_iter().flat_map(|own| own.systems).copied()
    }

    /// Returns the system with this name, of the program itself or shipped.
    pub(super) fn system(self, name: &str) -> Option<&'static dyn System> {
        self.systems().find(|system| system.name() == name).or_else(|| systems::by_name(name))
    }

    /// Names of the shipped systems and of those of the program.
    pub(super) fn system_names(self) -> impl Iterator<Item = &'static str> {
        systems::system_names().chain(self.systems().map(System::name))
    }

    /// Returns the systems of the program that have the name of another system, and an extension that is
    /// none of the simulator.
    pub(super) fn unusable_parts(self) -> Vec<SetupError> {
        if self.0.is_some() && self.extension().is_none() {
            return vec![SetupError::NoSimulatorExtension];
        }
        let mut names: BTreeSet<&str> = systems::system_names().collect();
        let ambiguous = self.systems().map(System::name).filter(|name| !names.insert(name));
        ambiguous.map(|name| SetupError::AmbiguousSystem { name: name.to_owned() }).collect()
    }

    pub(super) fn chassis(self) -> &'static [NamedChassis] {
        self.extension().map_or(&[], |own| own.chassis)
    }
}

impl WorldSetup {
    /// Adds the actions and the readings of all domain files of a program, and its parts of the simulator. Its
    /// systems receive events after the shipped ones, unless [`systems`](Self::systems) names them.
    #[must_use]
    pub fn extended(self, extensions: Extensions) -> Self {
        let mut setup = extensions.files().fold(self, WorldSetup::domain);
        setup.program = ProgramParts(extensions.simulator);
        for system in setup.program.systems() {
            if !setup.systems.iter().any(|name| name == system.name()) {
                setup.systems.push(system.name().to_owned());
            }
        }
        setup
    }
}
