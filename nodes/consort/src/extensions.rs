//! Extensions for programs with skills of their own.
//!
//! Such a program is `consort` itself, with all its commands, and with additional [`Extensions`]:
//! see `docs/tutorials/skill.md`. All nodes of a fleet need the same extensions: the
//! coordinator accepts only missions of its own task types.

use crate::diagnostic::{Diagnostic, Diagnostics};
use consort_protocol::mission::Domain;
use consort_skills::descriptor::DescriptorRegistry;
use consort_skills::domain::hospital;
use consort_skills::environment::Environment;
use consort_skills::library::SkillLibrary;
use std::error::Error;

/// The three parts of a skill: its task type in missions, its cost, and its execution. Each
/// function receives Consort's own definitions, and extends them.
#[derive(Debug, Clone, Copy)]
pub struct Extensions {
    /// Adds the task types, with their parameters.
    pub domain: fn(Domain) -> Domain,
    /// Adds the cost descriptors of the task types. A skill without a cost is never awarded.
    pub descriptors: fn(DescriptorRegistry) -> DescriptorRegistry,
    /// Adds leaves and trees; an error is shown to the user unchanged.
    pub library: fn(&mut SkillLibrary) -> Result<(), Box<dyn Error>>,
}

impl Default for Extensions {
    /// No extensions, as in `consort` itself.
    fn default() -> Extensions {
        Extensions { domain: |domain| domain, descriptors: |descriptors| descriptors, library: |_| Ok(()) }
    }
}

impl Extensions {
    /// Returns the task types for missions.
    pub fn domain(self) -> Domain {
        (self.domain)(hospital())
    }

    /// Returns the cost descriptors of tasks: `shipped`, extended.
    pub(crate) fn descriptors(self, shipped: DescriptorRegistry) -> DescriptorRegistry {
        (self.descriptors)(shipped)
    }

    /// Returns the skill library for an environment.
    ///
    /// # Errors
    /// [`Diagnostics`] of the program's own extensions.
    pub(crate) fn library(self, environment: Environment) -> Result<SkillLibrary, Diagnostics> {
        let mut library = SkillLibrary::standard(environment);
        (self.library)(&mut library).map_err(|problem| Diagnostic::for_file("this program's own skills", problem))?;
        Ok(library)
    }
}
