//! Flags of domains and missions of a user.

use consort_nodes::diagnostic::{Diagnostic, Diagnostics};
use consort_nodes::exit::Failure;
use consort_nodes::{domains, inputs};
use consort_protocol::ids::RoleId;
use consort_protocol::mission::Mission;
use consort_skills::extensions::Extensions;
use consort_skills::missions::NamedMissions;
use consort_skills::workload::{UserMission, Workload};
use consort_tests::chaos::user_missions;
use std::path::PathBuf;

/// Flag of domain files.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct DomainFlags {
    /// A domain file: actions and task types in addition to the standard ones; may be repeated
    #[arg(long = "domain", value_name = "FILE", env = "CONSORT_DOMAIN", value_delimiter = ',')]
    domains: Vec<PathBuf>,
}

impl DomainFlags {
    /// Reads the files.
    ///
    /// # Errors
    /// [`Diagnostics`] of the files.
    pub(crate) fn extend(&self, extensions: Extensions) -> Result<Extensions, Diagnostics> {
        domains::with_files(extensions, &self.domains)
    }
}

/// Flags of missions and of the domains that they need.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct WorkloadFlags {
    #[command(flatten)]
    domains: DomainFlags,
    /// A mission of your own: a mission file, or a file in the flat iHTN form (JSON); may be repeated
    #[arg(long = "mission", value_name = "FILE")]
    missions: Vec<String>,
    /// For a mission in the flat iHTN form: an agent that is a person, in addition to those of the domain; may be
    /// repeated
    #[arg(long = "person", value_name = "NAME", requires = "missions")]
    people: Vec<RoleId>,
}

impl WorkloadFlags {
    /// Reads the files.
    ///
    /// # Errors
    /// [`Diagnostics`] of the files.
    pub(crate) fn workload(&self, extensions: Extensions) -> Result<Workload, Diagnostics> {
        let read = |file: &String| {
            let document = inputs::mission(file, &self.people, &NamedMissions::default())?;
            Ok(UserMission { document, request: inputs::mission_request(file, &self.people)? })
        };
        let missions = self.missions.iter().map(read).collect::<Result<Vec<_>, Diagnostics>>()?;
        let mut names: Vec<_> = missions.iter().map(|mission| mission.document.name()).collect();
        names.sort_unstable();
        if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(Diagnostic::for_file("--mission", format!("two missions have the name {}", pair[0])).into());
        }
        Ok(Workload::new(self.domains.extend(extensions)?, missions))
    }

    /// Returns the flags as they were given.
    pub(crate) fn as_given(&self) -> Vec<String> {
        let domains = self.domains.domains.iter().map(|file| ("--domain", file.display().to_string()));
        let missions = self.missions.iter().map(|file| ("--mission", file.clone()));
        let people = self.people.iter().map(|name| ("--person", name.to_string()));
        domains.chain(missions).chain(people).flat_map(|(flag, value)| [flag.to_owned(), value]).collect()
    }
}

/// Returns the missions of the user in the hospital.
///
/// # Errors
/// [`Failure::Usage`] with the problems of the first wrong mission.
pub(crate) fn missions_in_hospital(workload: &Workload) -> Result<Vec<Mission>, Failure> {
    user_missions(workload)
        .map_err(|(mission, errors)| Failure::Usage(format!("--mission: the mission {mission}: {errors}")))
}
