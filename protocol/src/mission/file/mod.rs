//! Mission files: templates of missions with open parameters, written by people in YAML or JSON.
//!
//! ```yaml
//! mission: inspect-room              # the name of the kind of mission: a slug
//! title: Look after one room         # for people; optional
//! parameters:                        # values that a request provides; optional
//!   room: { kind: place, default: IC Room 6, description: which room }
//! roles:                             # participants; at least 1 is managed
//!   r1: { kind: managed }
//!   clerk: { kind: unmanaged, description: on duty in the room }
//! root:                              # an abstract task: `task`, `method`, `tasks`
//!   task: inspect
//!   method: sequential               # or `unordered`
//!   tasks:
//!     # an elementary task: `task`, `type`, `roles`, and where needed `parameters` and `reaches`
//!     - { task: navto_room, type: navigation, roles: [r1], parameters: { to: "${room}" }, reaches: { location: "${room}" } }
//!     - { task: meet, type: wait, roles: [r1, clerk], parameters: { seconds: "5" } }   # two roles: a joint task
//! ```
//!
//! Optional fields of an elementary task:
//!
//! - `acquires: { parcel: r1 }`: after the task, `r1` has the parcel; `releases: [parcel]`: after
//!   the task, the parcel is outside the mission. Tasks that touch the same item must be ordered.
//!   The ledger derives from this which items a lost robot carries.
//! - `attempts: 3`: maximum number of attempts of its skill before the task fails permanently; 1 to
//!   10, default 2.
//! - for tasks with a person (`approach_person`, `authenticate_person`, `deposit`),
//!   `parameters: { timeout_s: "300" }`: time in seconds that the robot waits, at each attempt, for
//!   a person who has left; default 120.
//!
//! A role may name the robots that it accepts: `eligible: robot.attributes.section == ${section}` (see
//! [`ensemble`](crate::ensemble) for the variables). `eligible` beside `roles` holds for all managed roles,
//! in addition to their own. A mission may name the ensembles whose robots it prefers:
//! `ensembles: [icu, hospital]`.
//!
//! `energy_max: 0.4` is a bound on the energy of all its robots together, in full batteries. The estimates
//! of the bids count, and those of earlier awards of the mission.
//!
//! `time_limit_s: 900` is a bound on its time, in seconds from the request or from its earliest start. The mission
//! fails after it, as after the deadline of a request.
//!
//! A role may set `on_loss: restart`: if its holder is lost after other roles have acted on its
//! work, and has no item, another robot restarts the role from its first step. Without it such a
//! mission fails.
//!
//! In addition to `root` a file may have a `recovery` branch of the same form. It is executed
//! instead if a robot is lost that has, or may have, an item. Its roles are declared with the
//! others, and robots are sought anew for all of them. Its tasks have different names. In its
//! `parameters` and `reaches`, `${lost.item}`, `${lost.robot}` and `${lost.place}` stand for the
//! lost item, the robot that had it, and the last known place of that robot. If another robot is
//! lost during the recovery, it is replaced if it has no item. If it has an item, or if the branch
//! cannot be executed, the mission needs a person.
//!
//! An abstract task may have `alternatives`: other methods, each
//! `{ method: sequential, tasks: [ elementary tasks ] }`. They are tried in the order of the file
//! when a task of its own method has failed permanently. They are *local*: a single managed role
//! executes all tasks of the method and of its alternatives, and none of these tasks touches an
//! item.
//!
//! # Results and conditions
//!
//! Tasks return results, as their types declare. `${inspect.dust_g}` is the result `dust_g` of the
//! earlier task `inspect`; it may be the whole value of a parameter. `when: inspect.dust_g > 5.0` is a
//! condition in CEL: the task is skipped unless it holds. A result of a skipped task is unknown. A
//! condition whose value depends on it fails the mission; `false && skipped.x > 1.0` does not. A task with a
//! condition moves no item.
//!
//! ```yaml
//!     - task: clean
//!       choose:                                          # the first branch whose condition holds
//!         - { when: inspect.dust_g > 5.0, do: { task: vacuum, type: vacuum, roles: [r1] } }
//!       else: { task: note, type: wait, roles: [r1], parameters: { seconds: "1" } }
//!     - task: rounds
//!       for: room                                        # tasks are named look_1, look_2, …
//!       in: "${rooms}"                                   # or a list: [IC Room 6, PC Room 3]
//!       do: { task: look, type: navigation, roles: [r1], parameters: { to: "${room}" } }
//!     - task: clean_rooms
//!       for: room
//!       in: "${rooms}"
//!       spread: true                                     # robots share the rooms, with the roles r2_1, r2_2, …
//!       do: { task: sweep, type: sweep, roles: [r2], parameters: { at: "${room}" } }
//!     - task: polish
//!       repeat: 3                                        # at most
//!       do: { task: rub, type: rub, roles: [r1] }
//!       until: rub.shine > 0.9                           # the latest iteration
//! result: { dust_g: inspect.dust_g }                     # results of the mission, beside `root`
//! ```
//!
//! A parameter's `kind` is `place`, `seconds`, `number`, `text`, `places` or `texts`. Without a `default` a request must provide
//! the value. `${name}` stands for the value, within the values of `parameters` and `reaches` only;
//! `$$` stands for a dollar sign. A substituted value is never searched again, so a value cannot
//! insert another value.
//!
//! Files may come from any source. The size of a text is limited before it is parsed, and its depth
//! while it is parsed. YAML anchors, aliases, merge keys and multiple documents are rejected: no
//! mission needs them, and a few of them can expand to gigabytes.

mod builder;
mod form;
mod scope;

pub(super) use form::unique_keys;
pub use form::{TemplateKind, TemplateParameter};

use self::builder::{MissionBuilder, recovery_diagnostics, split_roles};
use self::form::MissionFile;
use super::diagnostic::{MissionDiagnostic, MissionErrorKind, MissionErrors};
use super::domain::Domain;
use super::limits::FILE_BYTES_MAX;
use super::lost_item;
use super::model::Mission;
use crate::ids::{NameError, TaskId};
use crate::yaml;
use schemars::{Schema, schema_for};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::iter;
use std::path::Path;
use std::time::Duration;

/// Format of a mission file.
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
    /// Determines the format: by the file's extension if it is known, otherwise JSON if the text
    /// begins with a brace.
    pub fn of(path: Option<&Path>, text: &str) -> Self {
        match path.and_then(Path::extension).and_then(|extension| extension.to_str()) {
            Some("json") => Format::Json,
            Some("yaml" | "yml") => Format::Yaml,
            _ if text.trim_start_matches('\u{feff}').trim_start().starts_with('{') => Format::Json,
            _ => Format::Yaml,
        }
    }
}

/// Error: a text is not a mission file. Common for files written by hand; nothing was changed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MissionFileError {
    /// The text is larger than any mission needs; it was not parsed.
    #[error("the mission file has {bytes} bytes; at most {FILE_BYTES_MAX} are allowed")]
    TooLarge {
        /// Size of the file.
        bytes: usize,
    },
    /// The text has a syntax error, or wrong fields.
    #[error("not a mission file in {format}: {message}")]
    Syntax {
        /// Format used for parsing.
        format: Format,
        /// Message of the parser, with line and column.
        message: String,
    },
    /// The name of the mission is invalid.
    #[error(transparent)]
    Name(#[from] NameError),
    /// A request contains a field that only a flat iHTN needs.
    #[error(
        "`{field}` belongs to a mission in the flat iHTN form; a mission file has its own name, and its people are \
         the roles with `kind: unmanaged`"
    )]
    OnlyIhtn {
        /// The field.
        field: &'static str,
    },
    /// A flat iHTN has syntax errors or wrong fields.
    #[error(transparent)]
    Ihtn(#[from] MissionErrors),
}

/// Parsed mission file: a template that gives a mission for each choice of its parameters.
#[derive(Debug, Clone)]
pub struct MissionTemplate {
    name: TaskId,
    file: MissionFile,
}

impl MissionTemplate {
    /// Parses a mission file. Tasks, roles and parameters are checked by
    /// [`MissionTemplate::instantiate`].
    ///
    /// ```
    /// use consort_protocol::mission::{Domain, Format, MissionTemplate, TaskSchema, ValueKind};
    ///
    /// let file = r#"{ "mission": "go", "roles": { "r1": { "kind": "managed" } },
    ///     "root": { "task": "go", "type": "navigate", "roles": ["r1"], "parameters": { "to": "Dock" } } }"#;
    /// let navigation = TaskSchema::default().required("to", ValueKind::Place);
    /// let domain = Domain::default().with("navigation".parse()?, navigation);
    /// let template = MissionTemplate::parse(file, Format::Json)?;
    /// let error = template.instantiate(&Default::default(), &domain).unwrap_err().to_string();
    /// assert!(error.contains("unknown task type `navigate`") && error.ends_with("did you mean `navigation`?"), "{error}");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`MissionFileError`] with the place at which the text does not match the documented form.
    pub fn parse(text: &str, format: Format) -> Result<Self, MissionFileError> {
        if text.len() > FILE_BYTES_MAX {
            return Err(MissionFileError::TooLarge { bytes: text.len() });
        }
        let text = text.trim_start_matches('\u{feff}');
        let syntax = |message: String| MissionFileError::Syntax { format, message };
        let file: MissionFile = match format {
            Format::Json => serde_json::from_str(text).map_err(|error| syntax(error.to_string()))?,
            Format::Yaml => yaml::parse(text).map_err(syntax)?,
        };
        Ok(Self { name: TaskId::new(&*file.mission)?, file })
    }

    /// Converts a mission file for a request to the coordinator: the whole file, as JSON, from any
    /// format.
    ///
    /// # Errors
    /// Same as [`parse`](MissionTemplate::parse): errors of form are reported here, where the file
    /// is, and not by the coordinator.
    pub fn request(text: &str, format: Format) -> Result<Value, MissionFileError> {
        MissionTemplate::parse(text, format)?;
        let syntax = |message: String| MissionFileError::Syntax { format, message };
        let text = text.trim_start_matches('\u{feff}');
        let value: Value = match format {
            Format::Json => serde_json::from_str(text).map_err(|problem| syntax(problem.to_string()))?,
            Format::Yaml => yaml::parse(text).map_err(syntax)?,
        };
        Ok(scalars_as_text(value, false))
    }

    /// Returns the JSON Schema of mission files. Rules beyond the schema, such as the known task
    /// types, are checked by [`instantiate`].
    ///
    /// [`instantiate`]: MissionTemplate::instantiate
    pub fn schema() -> Schema {
        schema_for!(MissionFile)
    }

    /// Returns the name of the kind of mission.
    pub fn name(&self) -> &TaskId {
        &self.name
    }

    /// Returns the title for people; may be empty.
    pub fn title(&self) -> &str {
        &self.file.title
    }

    /// Returns the parameters that a request provides.
    pub fn parameters(&self) -> &BTreeMap<String, TemplateParameter> {
        &self.file.parameters
    }

    /// Returns the bound on the time of the mission.
    pub fn time_limit(&self) -> Option<Duration> {
        self.file.time_limit_s.map(|seconds| Duration::from_secs(seconds.into()))
    }

    /// Creates the mission with the given parameters and checks it against the domain. The recovery
    /// branch is checked, too.
    ///
    /// # Errors
    /// [`MissionErrors`] lists every problem of the given values and of the file.
    pub fn instantiate(&self, arguments: &BTreeMap<String, String>, domain: &Domain) -> Result<Mission, MissionErrors> {
        self.instantiate_with_recovery(arguments, domain).map(|(mission, _)| mission)
    }

    /// Creates the mission and its recovery branch, if it has one. The values of the loss are
    /// substituted when the loss occurs.
    ///
    /// # Errors
    /// Same as [`instantiate`](MissionTemplate::instantiate).
    pub fn instantiate_with_recovery(
        &self,
        arguments: &BTreeMap<String, String>,
        domain: &Domain,
    ) -> Result<(Mission, Option<Mission>), MissionErrors> {
        let mut builder = MissionBuilder::default();
        for task in iter::once(&self.file.root).chain(&self.file.recovery) {
            for (role, tasks) in task.tasks_by_role() {
                *builder.tasks_by_role.entry(role).or_default() += tasks;
            }
        }
        builder.bind_parameters(&self.file.parameters, arguments, domain);
        let mut mission = Mission {
            name: self.name.clone(),
            roles: builder.roles(&self.file.roles, self.file.eligible.as_deref()),
            ensembles: builder.ensembles(&self.file.ensembles),
            energy_max: self.file.energy_max,
            tasks: builder.tasks(&self.file.root, "root"),
            results: BTreeMap::new(),
        };
        let mut recovery = self.file.recovery.as_ref().map(|root| {
            builder.values.extend(lost_item::VARIABLES);
            Mission { tasks: builder.tasks(root, "recovery"), ..mission.clone() }
        });
        mission.results = builder.results(&self.file.result);
        builder.spread(&mut mission.roles);
        if let Some(recovery) = &mut recovery {
            recovery.roles.clone_from(&mission.roles);
        }
        [Some(&mut mission), recovery.as_mut()].into_iter().flatten().for_each(|branch| {
            branch.set_typical_inputs(domain);
            branch.set_domains(domain);
        });
        builder.find_unused(&self.file.parameters);
        let mut problems = builder.diagnostics;
        let incomplete = !problems.is_empty();
        let place = |problem: &MissionDiagnostic| match &problem.kind {
            MissionErrorKind::UnknownPlace { place, .. } => Some(place.clone()),
            _ => None,
        };
        let unknown_places: BTreeSet<String> = problems.iter().filter_map(place).collect();
        let mut diagnostics_found = vec![];
        if let Some(recovery) = &mut recovery {
            split_roles(&mut mission, recovery);
            diagnostics_found = recovery_diagnostics(&mission, recovery, domain);
        }
        let own: Vec<_> = mission.check(domain).err().into_iter().flat_map(|errors| errors.diagnostics).collect();
        // Ensembles and roles of both branches are reported once.
        diagnostics_found.retain(|found| {
            let is_same =
                |own: &MissionDiagnostic| own.kind == found.kind && found.path == format!("recovery: {}", own.path);
            !own.iter().any(is_same)
        });
        diagnostics_found.splice(0..0, own);
        // After a failed substitution, missing values that follow from it are not reported again.
        let is_reported = |problem: &MissionDiagnostic| match &problem.kind {
            MissionErrorKind::NoRole { .. }
            | MissionErrorKind::UnusedRole
            | MissionErrorKind::MissingParameter { .. } => !incomplete,
            MissionErrorKind::BadValue { .. } | MissionErrorKind::EmptyMethod | MissionErrorKind::NoManagedRole => {
                !incomplete
            }
            // Reported once, for the request, and not for every task that uses the place.
            MissionErrorKind::UnknownPlace { place, .. } => !unknown_places.contains(place),
            _ => true,
        };
        problems.extend(diagnostics_found.into_iter().filter(is_reported));
        MissionErrors::ok_if_empty(&self.name, problems)?;
        Ok((mission, recovery))
    }
}

/// Keys with numbers and truth values.
const TYPED: [&str; 7] = ["attempts", "energy_max", "time_limit_s", "repeat", "spread", "patience_s", "after_s"];

/// Keys with maps whose keys and values are free texts.
const TEXTS: [&str; 4] = ["parameters", "reaches", "acquires", "result"];

/// Converts scalars to text, except those of [`TYPED`]: all other values of mission files are texts, and YAML parses a
/// bare `5` as a number. `is_free` is true within one of [`TEXTS`].
fn scalars_as_text(value: Value, is_free: bool) -> Value {
    match value {
        Value::Array(list) => list.into_iter().map(|value| scalars_as_text(value, is_free)).collect(),
        Value::Object(map) => {
            let convert = |(key, value): (String, Value)| {
                let value = match &*key {
                    name if !is_free && TYPED.contains(&name) => value,
                    name => scalars_as_text(value, is_free || TEXTS.contains(&name)),
                };
                (key, value)
            };
            map.into_iter().map(convert).collect()
        }
        Value::Bool(value) => Value::String(value.to_string()),
        Value::Number(value) => Value::String(value.to_string()),
        Value::Null | Value::String(_) => value,
    }
}

#[cfg(test)]
mod tests;
