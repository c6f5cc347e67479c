//! Extensions of the standard domain: domain files, and skills in Rust.
//!
//! A program with extensions in Rust is `consort` or `consort-lab` itself, with all its commands, and with additional
//! [`Extensions`]: see `docs/tutorials/skill.md`. All nodes of a fleet need the same extensions: the
//! coordinator accepts only missions of its own task types.

use crate::descriptor::DescriptorRegistry;
use crate::domain::task_types_with;
use crate::domain_file::DomainFile;
use crate::environment::Environment;
use crate::library::SkillLibrary;
use consort_protocol::ids::TaskType;
use consort_protocol::mission::Domain;
use std::any::Any;
use std::collections::BTreeSet;
use std::error::Error;
use std::path::PathBuf;

/// A domain with its file.
#[derive(Debug, Clone)]
pub struct LoadedDomain {
    /// The file.
    pub path: PathBuf,
    /// The domain.
    pub domain: DomainFile,
}

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
    /// Parts of the simulator: `consort_world::extend::SimulatorExtension`.
    pub simulator: Option<&'static (dyn Any + Send + Sync)>,
}

impl Default for Extensions {
    fn default() -> Extensions {
        Extensions::NONE
    }
}

/// Skills cannot be added to the library.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{source_name}: {problem}")]
pub struct ExtensionError {
    /// File of the domain, or a name for the skills in Rust.
    pub source_name: String,
    /// The problem.
    pub problem: String,
}

impl Extensions {
    /// No extensions, as in `consort` itself.
    pub const NONE: Extensions = Extensions {
        domain: |domain| domain,
        descriptors: |descriptors| descriptors,
        library: |_| Ok(()),
        domains: &[],
        simulator: None,
    };

    /// Returns the extensions with one more domain. It is kept until the program ends.
    #[must_use]
    pub fn with_domain(self, path: impl Into<PathBuf>, domain: DomainFile) -> Extensions {
        let more = LoadedDomain { path: path.into(), domain };
        let domains: Vec<LoadedDomain> = self.domains.iter().cloned().chain([more]).collect();
        Extensions { domains: domains.leak(), ..self }
    }

    /// Returns the domain files.
    pub fn files(self) -> impl Iterator<Item = &'static DomainFile> + Clone {
        self.domains.iter().map(|loaded| &loaded.domain)
    }

    /// Returns the task types for missions, and the readings of drivers.
    pub fn domain(self) -> Domain {
        let readings = self.files().flat_map(DomainFile::reading_forms).map(|(name, _)| name.clone());
        (self.domain)(task_types_with(self.files()).with_readings(readings))
    }

    /// Returns the task types of the domain files.
    pub fn declared_task_types(self) -> BTreeSet<TaskType> {
        self.files().flat_map(|domain| domain.task_types().map(|(name, _)| name)).collect()
    }

    /// Returns the cost descriptors of tasks: `shipped`, extended.
    pub fn descriptors(self, shipped: DescriptorRegistry) -> DescriptorRegistry {
        let with_files = self.files().fold(shipped, |all, domain| domain.extend_descriptors(all));
        (self.descriptors)(with_files)
    }

    /// Returns the skill library for an environment.
    ///
    /// # Errors
    /// [`ExtensionError`] of a domain file, or of the skills in Rust.
    pub fn library(self, environment: Environment) -> Result<SkillLibrary, ExtensionError> {
        let mut library = SkillLibrary::standard(environment);
        let error = |source_name: String, problem: String| ExtensionError { source_name, problem };
        for LoadedDomain { path, domain } in self.domains {
            let extended = domain.extend_library(&mut library);
            extended.map_err(|problem| error(path.display().to_string(), problem.to_string()))?;
        }
        let extended = (self.library)(&mut library);
        extended.map_err(|problem| error("this program's own skills".to_owned(), problem.to_string()))?;
        Ok(library)
    }
}
