//! Extensions: domain files, and skills in Rust for programs of one's own.
//!
//! A program with skills in Rust is `consort` itself, with all its commands, and with additional [`Extensions`]:
//! see `docs/tutorials/skill.md`. All nodes of a fleet need the same extensions: the
//! coordinator accepts only missions of its own task types.

use crate::diagnostic::{Diagnostic, Diagnostics};
use crate::domains::{self, LoadedDomain};
use consort_driver::Contract;
use consort_protocol::ids::{ActionName, TaskType};
use consort_protocol::mission::Domain;
use consort_skills::descriptor::DescriptorRegistry;
use consort_skills::domain::{shipped_domain, standard_library, task_types_with};
use consort_skills::domain_file::{ActionForm, DomainFile, ReadingForm};
use consort_skills::environment::Environment;
use consort_skills::library::SkillLibrary;
use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::path::PathBuf;

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
    /// The domain files, from `--domain` and the fleet file.
    pub domains: &'static [LoadedDomain],
}

impl Default for Extensions {
    /// No extensions, as in `consort` itself.
    fn default() -> Extensions {
        Extensions {
            domain: |domain| domain,
            descriptors: |descriptors| descriptors,
            library: |_| Ok(()),
            domains: &[],
        }
    }
}

impl Extensions {
    /// Returns the extensions with more domain files.
    ///
    /// # Errors
    /// [`Diagnostics`] of the files.
    pub(crate) fn with_domains(self, paths: &[PathBuf]) -> Result<Extensions, Diagnostics> {
        Ok(Extensions { domains: domains::load_more(self.domains, paths)?, ..self })
    }

    /// Returns the task types for missions.
    pub fn domain(self) -> Domain {
        (self.domain)(task_types_with(self.domains.iter().map(|loaded| &loaded.domain)))
    }

    /// Returns what the simulator does with the declared actions.
    pub(crate) fn simulated_actions(self) -> BTreeMap<ActionName, ActionForm> {
        self.all_domains().flat_map(DomainFile::simulated_actions).collect()
    }

    /// Returns the declared readings.
    pub(crate) fn readings(self) -> BTreeMap<String, ReadingForm> {
        let forms = self.all_domains().flat_map(DomainFile::reading_forms);
        forms.map(|(name, form)| (name.clone(), form.clone())).collect()
    }

    /// Returns the actions that drivers may offer, and the readings that they may send.
    pub(crate) fn driver_contract(self) -> Contract {
        Contract::new(self.all_domains())
    }

    /// Returns the shipped domain and those of the files.
    fn all_domains(self) -> impl Iterator<Item = &'static DomainFile> {
        let files = self.domains.iter().map(|loaded| &loaded.domain);
        [shipped_domain()].into_iter().chain(files)
    }

    /// Returns the task types of the domain files.
    pub(crate) fn declared_task_types(self) -> BTreeSet<TaskType> {
        self.domains.iter().flat_map(|loaded| loaded.domain.task_types().map(|(name, _)| name)).collect()
    }

    /// Returns the cost descriptors of tasks: `shipped`, extended.
    pub(crate) fn descriptors(self, shipped: DescriptorRegistry) -> DescriptorRegistry {
        let files = self.domains.iter();
        let with_services = shipped_domain().extend_descriptors(shipped);
        (self.descriptors)(files.fold(with_services, |all, loaded| loaded.domain.extend_descriptors(all)))
    }

    /// Returns the skill library for an environment.
    ///
    /// # Errors
    /// [`Diagnostics`] of the program's own extensions.
    pub(crate) fn library(self, environment: Environment) -> Result<SkillLibrary, Diagnostics> {
        let mut library = standard_library(environment);
        for LoadedDomain { path, domain } in self.domains {
            domain.extend_library(&mut library).map_err(|problem| Diagnostic::for_file(path.display(), problem))?;
        }
        (self.library)(&mut library).map_err(|problem| Diagnostic::for_file("this program's own skills", problem))?;
        Ok(library)
    }
}
