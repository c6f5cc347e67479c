//! Missions as users give them: a mission file, or a flat iHTN.

use super::diagnostic::MissionErrors;
use super::domain::Domain;
use super::file::{Format, MissionFileError, MissionTemplate, TemplateParameter};
use super::ihtn::{IhtnOptions, import_ihtn, is_flat_ihtn, parse_nodes, root_name};
use super::limits::FILE_BYTES_MAX;
use super::model::Mission;
use crate::ids::{RoleId, TaskId};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Mission as a user gives it.
#[derive(Debug, Clone)]
pub enum MissionDocument {
    /// A mission file.
    Template(Box<MissionTemplate>),
    /// A mission in the flat iHTN form.
    Ihtn {
        /// Text of the file, in JSON.
        text: String,
        /// Name of the mission, and its people.
        options: IhtnOptions,
    },
}

/// Fields that a flat iHTN lacks and a request adds.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct IhtnFields {
    /// Name of the mission. Default: the name of the root.
    pub name: Option<TaskId>,
    /// Agents that are people, in addition to those of the domain.
    pub people: BTreeSet<RoleId>,
}

impl IhtnFields {
    /// Returns the name of the first field that is given.
    pub fn first_given(&self) -> Option<&'static str> {
        match self {
            IhtnFields { name: Some(_), .. } => Some("name"),
            IhtnFields { people, .. } => (!people.is_empty()).then_some("people"),
        }
    }
}

impl MissionDocument {
    /// Parses a mission file or, in JSON, a flat iHTN.
    ///
    /// # Errors
    /// [`MissionFileError`]: errors of form, or `fields` that a mission file does not take.
    pub fn parse(text: &str, format: Format, fields: IhtnFields) -> Result<Self, MissionFileError> {
        if text.len() > FILE_BYTES_MAX {
            return Err(MissionFileError::TooLarge { bytes: text.len() });
        }
        if !is_ihtn_text(text, format) {
            let template = MissionTemplate::parse(text, format)?;
            return match fields.first_given() {
                Some(field) => Err(MissionFileError::OnlyIhtn { field }),
                None => Ok(MissionDocument::Template(Box::new(template))),
            };
        }
        let text = text.trim_start_matches('\u{feff}').to_owned();
        let default_name = TaskId::new("mission").expect("a slug");
        let nodes = parse_nodes(&text, fields.name.as_ref().unwrap_or(&default_name))?;
        let name = fields.name.or_else(|| root_name(&nodes)).unwrap_or(default_name);
        Ok(MissionDocument::Ihtn { text, options: IhtnOptions { name, people: fields.people } })
    }

    /// Checks a text and converts it for a request to the coordinator: the whole file, as JSON.
    ///
    /// # Errors
    /// Same as [`parse`](MissionDocument::parse).
    pub fn request(text: &str, format: Format, fields: IhtnFields) -> Result<Value, MissionFileError> {
        match MissionDocument::parse(text, format, fields)? {
            MissionDocument::Template(_) => MissionTemplate::request(text, format),
            MissionDocument::Ihtn { text, .. } => serde_json::from_str(&text)
                .map_err(|error| MissionFileError::Syntax { format, message: error.to_string() }),
        }
    }

    /// Sets the name of a mission in the flat iHTN form; a mission file keeps its own name.
    #[must_use]
    pub fn named(mut self, own_name: TaskId) -> Self {
        if let MissionDocument::Ihtn { options, .. } = &mut self {
            options.name = own_name;
        }
        self
    }

    /// Returns the name of the kind of mission.
    pub fn name(&self) -> &TaskId {
        match self {
            MissionDocument::Template(template) => template.name(),
            MissionDocument::Ihtn { options, .. } => &options.name,
        }
    }

    /// Returns the title for people; may be empty.
    pub fn title(&self) -> &str {
        match self {
            MissionDocument::Template(template) => template.title(),
            MissionDocument::Ihtn { .. } => "a mission in the flat iHTN form",
        }
    }

    /// Returns the parameters that a request provides. A flat iHTN has no parameters.
    pub fn parameters(&self) -> &BTreeMap<String, TemplateParameter> {
        static NO_PARAMETERS: BTreeMap<String, TemplateParameter> = BTreeMap::new();
        match self {
            MissionDocument::Template(template) => template.parameters(),
            MissionDocument::Ihtn { .. } => &NO_PARAMETERS,
        }
    }

    /// Returns the bound on the time of the mission. A flat iHTN has none.
    pub fn time_limit(&self) -> Option<Duration> {
        match self {
            MissionDocument::Template(template) => template.time_limit(),
            MissionDocument::Ihtn { .. } => None,
        }
    }

    /// Creates the mission with the given parameters and checks it against the domain.
    ///
    /// # Errors
    /// [`MissionErrors`] lists every problem.
    pub fn instantiate(&self, arguments: &BTreeMap<String, String>, domain: &Domain) -> Result<Mission, MissionErrors> {
        self.instantiate_with_recovery(arguments, domain).map(|(mission, _)| mission)
    }

    /// Creates the mission and its recovery branch, if it has one.
    ///
    /// # Errors
    /// Same as [`instantiate`](MissionDocument::instantiate).
    pub fn instantiate_with_recovery(
        &self,
        arguments: &BTreeMap<String, String>,
        domain: &Domain,
    ) -> Result<(Mission, Option<Mission>), MissionErrors> {
        match self {
            MissionDocument::Template(template) => template.instantiate_with_recovery(arguments, domain),
            MissionDocument::Ihtn { text, options } => {
                options.reject_arguments(arguments)?;
                Ok((import_ihtn(text, options, domain)?, None))
            }
        }
    }
}

fn is_ihtn_text(text: &str, format: Format) -> bool {
    format == Format::Json
        && serde_json::from_str(text.trim_start_matches('\u{feff}')).is_ok_and(|value| is_flat_ihtn(&value))
}
