//! Mission files: a mission with its parameters left open, as people write it, in YAML or JSON.
//!
//! ```yaml
//! mission: inspect-room              # the name of the kind of mission: a slug
//! title: Look after one room         # for people; optional
//! parameters:                        # what a request fills in; optional
//!   room: { kind: place, default: IC Room 6, description: which room }
//! roles:                             # who takes part; at least one is managed
//!   r1: { kind: managed }
//!   nurse: { kind: unmanaged, description: on duty in the room }
//! root:                              # an abstract task: `task`, `method`, `tasks`
//!   task: inspect
//!   method: sequential               # or `unordered`
//!   tasks:
//!     # an elementary task: `task`, `type`, `roles`, and where needed `parameters` and `reaches`
//!     - { task: navto_room, type: navigation, roles: [r1], parameters: { to: "${room}" }, reaches: { location: "${room}" } }
//!     - { task: meet, type: wait, roles: [r1, nurse], parameters: { seconds: "5" } }   # two roles: a joint task
//! ```
//!
//! An elementary task may say more:
//!
//! - `acquires: { sample: r1 }`: once it has ended, `r1` has the sample; `releases: [sample]`: nobody of the mission has.
//!   Tasks that touch one item must be in a definite order. The ledger knows from this what a lost robot carries.
//! - `attempts: 3`: how often its skill is tried before the task has failed; 1 to 10, 2 if nothing is said.
//! - where it takes a person (`approach_person`, `authenticate_person`, `deposit`), `parameters: { patience: "300" }`: how many
//!   seconds it waits, at each attempt, for one who has left; 120 if nothing is said.
//!
//! A role may say `on_loss: restart`: if its holder is lost after others have acted on its work, and has no item in its
//! hands, another begins it from the beginning. Without it such a mission fails.
//!
//! Beside `root` a file may have a `recovery`, of the same shape: what is done instead if a robot is lost that has, or may
//! have, an item. Its roles are declared with the others, and robots are sought anew for all that take part in it. Its
//! tasks have names of their own. In its `parameters` and `reaches`, `${lost.item}`, `${lost.robot}` and `${lost.place}`
//! stand for what was lost, who had it, and where that robot was last known to be. A robot that is lost in turn, with nothing in
//! its hands, is replaced; with an item, or if the branch cannot be carried out, the mission needs a person.
//!
//! An abstract task may have `alternatives`: other methods, each `{ method: sequential, tasks: [ elementary tasks ] }`,
//! tried in the order of the file when a task of its own method has failed for good. They are *local*: all tasks of the
//! method and of its alternatives are done by one managed role alone, and none touches an item.
//!
//! A parameter's `kind` is `place`, `seconds` or `text`; without a `default` a request must give it. `${name}` stands
//! for its value, within the values of `parameters` and `reaches` only; `$$` stands for a dollar sign. What was put
//! in is never searched again, so a value cannot smuggle in another.
//!
//! Files may come from anyone. Text is limited in size before it is read and in depth while it is read; YAML anchors,
//! aliases, merge keys and further documents are refused, as no mission needs them and a few of them make
//! gigabytes.

mod builder;
mod form;

pub(super) use form::unique_keys;
pub use form::{TemplateKind, TemplateParameter};

use self::builder::{MissionBuilder, recovery_diagnostics, split_roles};
use self::form::MissionFile;
use super::diagnostic::{MissionDiagnostic, MissionErrorKind, MissionErrors};
use super::domain::Domain;
use super::lost_item;
use super::model::Mission;
use crate::ids::{NameError, TaskId};
use schemars::{Schema, schema_for};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::Path;

/// Largest mission file, in bytes. Five hundred tasks with generous comments take a third of it.
pub const FILE_BYTES_MAX: usize = 256 * 1024;

/// How a mission file is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// JSON, as clients send it.
    Json,
    /// YAML, as people write it.
    Yaml,
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Format::Json => "JSON",
            Format::Yaml => "YAML",
        })
    }
}

impl Format {
    /// By the file's extension where it has one that says; else JSON if the text begins with a brace.
    pub fn of(path: Option<&Path>, text: &str) -> Self {
        match path.and_then(Path::extension).and_then(|extension| extension.to_str()) {
            Some("json") => Format::Json,
            Some("yaml" | "yml") => Format::Yaml,
            _ if text.trim_start_matches('\u{feff}').trim_start().starts_with('{') => Format::Json,
            _ => Format::Yaml,
        }
    }
}

/// Why a text is no mission file. Ordinary for files written by hand; nothing was taken over.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MissionFileError {
    /// More text than any mission needs; none of it was read.
    #[error("the mission file has {bytes} bytes; at most {FILE_BYTES_MAX} are allowed")]
    TooLarge {
        /// Its size.
        bytes: usize,
    },
    /// Not the format, or not the fields.
    #[error("not a mission file in {format}: {message}")]
    Syntax {
        /// How it was read.
        format: Format,
        /// What the reader says, with line and column.
        message: String,
    },
    /// The mission's own name is none.
    #[error(transparent)]
    Name(#[from] NameError),
}

/// A mission file that was read: a mission for every choice of its parameters.
#[derive(Debug, Clone)]
pub struct MissionTemplate {
    name: TaskId,
    file: MissionFile,
}

fn yaml_options() -> serde_saphyr::Options {
    serde_saphyr::options! {
        budget: serde_saphyr::budget! {
            max_aliases: 0,
            max_anchors: 0,
            max_depth: 128,
            flow_nesting_limit: 128,
            max_documents: 1,
            max_nodes: 50_000,
            max_events: 100_000,
            max_merge_keys: 0,
        },
        merge_keys: serde_saphyr::options::MergeKeyPolicy::Error,
    }
}

impl MissionTemplate {
    /// Reads a mission file. Tasks, roles and parameters are judged by [`MissionTemplate::instantiate`].
    ///
    /// ```
    /// use consort_protocol::mission::{Domain, Format, MissionTemplate};
    ///
    /// let file = r#"{ "mission": "go", "roles": { "r1": { "kind": "managed" } },
    ///     "root": { "task": "go", "type": "navigate", "roles": ["r1"], "parameters": { "to": "Dock" } } }"#;
    /// let template = MissionTemplate::parse(file, Format::Json)?;
    /// let wrong = template.instantiate(&Default::default(), &Domain::hospital()).unwrap_err().to_string();
    /// assert!(wrong.contains("unknown task type `navigate`") && wrong.ends_with("did you mean `navigation`?"), "{wrong}");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`FileError`] says where the text is not of the documented form.
    pub fn parse(text: &str, format: Format) -> Result<Self, MissionFileError> {
        if text.len() > FILE_BYTES_MAX {
            return Err(MissionFileError::TooLarge { bytes: text.len() });
        }
        let text = text.trim_start_matches('\u{feff}');
        let syntax = |message: String| MissionFileError::Syntax { format, message };
        let file: MissionFile = match format {
            Format::Json => serde_json::from_str(text).map_err(|error| syntax(error.to_string()))?,
            Format::Yaml => {
                serde_saphyr::from_str_with_options(text, yaml_options()).map_err(|error| syntax(error.to_string()))?
            }
        };
        Ok(Self { name: TaskId::new(&*file.mission)?, file })
    }

    /// The form of a mission file, as a JSON Schema. What it cannot say, as which task types there are, [`instantiate`] does.
    ///
    /// [`instantiate`]: MissionTemplate::instantiate
    pub fn schema() -> Schema {
        schema_for!(MissionFile)
    }

    /// The name of the kind of mission.
    pub fn name(&self) -> &TaskId {
        &self.name
    }

    /// What it is about, for people; may be empty.
    pub fn title(&self) -> &str {
        &self.file.title
    }

    /// What a request fills in.
    pub fn parameters(&self) -> &BTreeMap<String, TemplateParameter> {
        &self.file.parameters
    }

    /// The mission with its parameters filled in, checked against the domain; its recovery branch, too, is checked.
    ///
    /// # Errors
    /// [`MissionErrors`] lists every problem of the values given and of the file.
    pub fn instantiate(&self, given: &BTreeMap<String, String>, domain: &Domain) -> Result<Mission, MissionErrors> {
        self.instantiate_with_recovery(given, domain).map(|(mission, _)| mission)
    }

    /// The mission and its recovery branch, if it has one. What is told of the loss is filled in when there is one.
    ///
    /// # Errors
    /// As [`instantiate`](MissionTemplate::instantiate).
    pub fn instantiate_with_recovery(
        &self,
        given: &BTreeMap<String, String>,
        domain: &Domain,
    ) -> Result<(Mission, Option<Mission>), MissionErrors> {
        let mut building = MissionBuilder::default();
        building.bind_parameters(&self.file.parameters, given, domain);
        let mut mission = building.mission(&self.name, &self.file.roles, &self.file.root, "root");
        let mut recovery = self.file.recovery.as_ref().map(|root| {
            building.values.extend(lost_item::VARIABLES);
            building.mission(&self.name, &self.file.roles, root, "recovery")
        });
        building.find_unused(&self.file.parameters);
        let mut problems = building.diagnostics;
        let unwritten = !problems.is_empty();
        let place = |problem: &MissionDiagnostic| match &problem.kind {
            MissionErrorKind::UnknownPlace { place, .. } => Some(place.clone()),
            _ => None,
        };
        let astray: BTreeSet<String> = problems.iter().filter_map(place).collect();
        let mut found = vec![];
        if let Some(recovery) = &mut recovery {
            split_roles(&mut mission, recovery);
            found = recovery_diagnostics(&mission, recovery, domain);
        }
        found.splice(0..0, mission.check(domain).err().into_iter().flat_map(|errors| errors.diagnostics));
        // Where something could not be put in, what is missing for that reason is no problem of its own.
        let own = |problem: &MissionDiagnostic| match &problem.kind {
            MissionErrorKind::NoRole { .. }
            | MissionErrorKind::UnusedRole
            | MissionErrorKind::MissingParameter { .. } => !unwritten,
            MissionErrorKind::BadValue { .. } | MissionErrorKind::EmptyMethod | MissionErrorKind::NoManagedRole => {
                !unwritten
            }
            // Told once, of the request, and not of every task that goes there.
            MissionErrorKind::UnknownPlace { place, .. } => !astray.contains(place),
            _ => true,
        };
        problems.extend(found.into_iter().filter(own));
        MissionErrors::ok_if_empty(&self.name, problems)?;
        Ok((mission, recovery))
    }
}

#[cfg(test)]
mod more_tests;
#[cfg(test)]
mod tests;
