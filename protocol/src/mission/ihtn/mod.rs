//! Import of missions in the flat iHTN form of the MissionControl replication package.
//!
//! A JSON object maps ids to nodes: `name`, `type` (`task`, `method` or `action`), `parent` (`"-1"`
//! for the root), `agents`, `locations` and `children` (a list, or `""` for an empty list). The
//! form has less information than [`Mission`]; these rules fill the gaps:
//!
//! - A `task` has exactly 1 `method`, and both become a single abstract task with the name of the
//!   task. There is no ordering field: children are in sequence.
//! - The roles are the agents of actions. Agents that occur only at tasks and methods have no
//!   action and are omitted. The form does not mark people and things: the request names people
//!   ([`IhtnOptions::people`]), and the domain names people and objects ([`IhtnNames`]).
//! - Names repeat. The first node keeps its name; the next nodes are named `name-2`, `name-3`, ….
//! - An action's name is its task type, after [`IhtnNames::actions`]. If the domain lacks that
//!   type, a name `type-word` is split at the first `-` for which two conditions hold: the domain
//!   has `type`, and exactly 1 of its parameters is a choice that includes `word`. So
//!   `operate_box-open` is `operate_box { action: open }`.
//! - A location stands for a place of the map, after [`IhtnNames::places`]. It becomes the type's
//!   parameter of kind place (the required parameter if there are several). For the types in
//!   [`IhtnNames::reaching`] it is also the reached state. Several locations become the parameters
//!   `location_1`, `location_2`, ….
//! - An agent that is an object is no role. It becomes the type's parameter `object`; several
//!   objects become `object_1`, `object_2`, ….
//! - A parameter of kind role takes the agent of the action's method that is not the action's own,
//!   if there is exactly 1 such agent: in a method of `r1` and `lab_arm`, `r1` approaches
//!   `lab_arm`.
//!
//! [`IhtnNames`]: super::IhtnNames
//! [`IhtnNames::actions`]: super::IhtnNames::actions
//! [`IhtnNames::places`]: super::IhtnNames::places
//! [`IhtnNames::reaching`]: super::IhtnNames::reaching

mod build;
mod form;
mod tree;
mod undeclared;

pub use undeclared::{ActionUse, UndeclaredActions, undeclared_actions};

use self::form::{FlatFile, FlatNode, NO_PARENT};
use super::diagnostic::{IhtnError, MissionDiagnostic, MissionErrorKind, MissionErrors};
use super::domain::Domain;
use super::limits::{FILE_BYTES_MAX, TASKS_MAX};
use super::model::Mission;
use crate::ids::{RoleId, TaskId};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};

/// Options of the import of a flat iHTN.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct IhtnOptions {
    /// Name of the mission.
    pub name: TaskId,
    /// Agents that are people, or otherwise not commanded by the fleet, in addition to the people
    /// of the domain. Each must have an action.
    pub people: BTreeSet<RoleId>,
}

/// Checks whether a JSON value has the form of a flat iHTN: an object of nodes, without the keys of
/// a mission file. The nodes are not checked.
pub fn is_flat_ihtn(value: &Value) -> bool {
    let is_node = |node: &Value| node.get("parent").is_some() && node.get("type").is_some();
    value.as_object().is_some_and(|nodes| {
        !nodes.contains_key("mission") && !nodes.contains_key("root") && nodes.values().any(is_node)
    })
}

/// Imports a flat iHTN and checks the mission against the domain.
///
/// # Errors
/// [`MissionErrors`] lists the problems of the nodes; if there are none, those of the tree; then
/// those of the tasks.
pub fn import_ihtn(text: &str, options: &IhtnOptions, domain: &Domain) -> Result<Mission, MissionErrors> {
    let all = |diagnostics| MissionErrors { mission: options.name.to_string(), diagnostics };
    let nodes = parse_nodes(text, &options.name)?;
    let root = tree::find_root(&nodes).map_err(all)?;
    let mission = build::build_mission(&nodes, root, options, domain).map_err(all)?;
    mission.check(domain)?;
    Ok(mission)
}

/// Parses the nodes. Their tree is not checked. `name` is the mission's name in errors.
///
/// # Errors
/// [`MissionErrors`] of the size and the form.
pub(super) fn parse_nodes(text: &str, name: &TaskId) -> Result<BTreeMap<String, FlatNode>, MissionErrors> {
    let all = |diagnostics| MissionErrors { mission: name.to_string(), diagnostics };
    let at_file = |kind: MissionErrorKind| all(vec![MissionDiagnostic { path: "file".to_owned(), kind }]);
    if text.len() > FILE_BYTES_MAX {
        return Err(at_file(IhtnError::TooLarge { bytes: text.len() }.into()));
    }
    let nodes = match serde_json::from_str(text) {
        Ok(FlatFile(nodes)) => nodes,
        Err(error) => {
            let named = problems_of_nodes(text);
            let whole = || at_file(IhtnError::Syntax { message: error.to_string() }.into());
            return Err(if named.is_empty() { whole() } else { all(named) });
        }
    };
    if nodes.len() > 2 * TASKS_MAX {
        return Err(at_file(MissionErrorKind::TooManyTasks { found: nodes.len(), max: 2 * TASKS_MAX }));
    }
    Ok(nodes)
}

/// Returns the problems within the nodes of a text that is no flat iHTN. The text of a request has
/// no useful lines, so these problems name their nodes.
fn problems_of_nodes(text: &str) -> Vec<MissionDiagnostic> {
    let Ok(Value::Object(values)) = serde_json::from_str(text) else { return vec![] };
    let problem = |(id, value): (String, Value)| {
        let path = format!("node {id} ({})", value.get("name").and_then(Value::as_str).unwrap_or("?"));
        let error = serde_json::from_value::<FlatNode>(value).err()?;
        Some(MissionDiagnostic { path, kind: IhtnError::Node { message: error.to_string() }.into() })
    };
    values.into_iter().filter_map(problem).collect()
}

/// Returns the name of the root, if there is a root and its name is valid for a mission.
pub(super) fn root_name(nodes: &BTreeMap<String, FlatNode>) -> Option<TaskId> {
    let root = nodes.values().find(|node| node.parent == NO_PARENT)?;
    TaskId::new(&*root.name).ok()
}

impl IhtnOptions {
    /// Rejects parameters of a request: a flat iHTN has none.
    pub(super) fn reject_arguments(&self, arguments: &BTreeMap<String, String>) -> Result<(), MissionErrors> {
        let unknown =
            |name: &String| MissionDiagnostic { path: format!("parameters/{name}"), kind: IhtnError::Parameter.into() };
        MissionErrors::ok_if_empty(&self.name, arguments.keys().map(unknown).collect())
    }

    /// Returns the people of the request and of the domain.
    fn all_people(&self, domain: &Domain) -> BTreeSet<RoleId> {
        self.people.union(&domain.ihtn_names().people).cloned().collect()
    }
}

#[cfg(test)]
mod tests;
