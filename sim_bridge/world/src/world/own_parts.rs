//! Parts of the simulator that the program itself adds.

use super::setup::{ProgramParts, WorldSetup};
use super::system::System;
use crate::kinematics::NamedChassis;
use consort_skills::extensions::Extensions;

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

    /// Checks that the parts, if there are any, are a [`SimulatorExtension`].
    pub(super) fn is_usable(self) -> bool {
        self.0.is_none() || self.extension().is_some()
    }

    pub(super) fn systems(self) -> impl Iterator<Item = &'static dyn System> {
        self.extension().into_iter().flat_map(|own| own.systems).copied()
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
