//! Import of missions in the flat iHTN form of the MissionControl replication package.
//!
//! A JSON object maps ids to nodes: `name`, `type` (`task`, `method` or `action`), `parent` (`"-1"`
//! for the root), `agents`, `locations` and `children` (a list, or `""` for an empty list). The
//! form has less information than [`Mission`]; these rules fill the gaps:
//!
//! - A `task` has exactly 1 `method`, and both become a single abstract task with the name of the
//!   task. There is no ordering field: children are in sequence.
//! - The roles are the agents of actions. Agents that occur only at tasks and methods have no
//!   action and are omitted. The form does not mark persons: the caller does
//!   ([`IhtnOptions::unmanaged`]).
//! - Names repeat. The first node keeps its name; the next nodes are named `name-2`, `name-3`, ….
//! - An action's name is its task type, after [`IhtnOptions::aliases`]. If the domain lacks that
//!   type, a name `type-word` is split at the first `-` for which two conditions hold: the domain
//!   has `type`, and exactly 1 of its parameters is a choice that includes `word`. So
//!   `operate_drawer-open` is `operate_drawer { action: open }`.
//! - A location becomes the type's parameter of kind place (the required parameter if there are
//!   several). For the types in [`IhtnOptions::reaching`] it is also the reached state.
//! - A parameter of kind role takes the agent of the action's method that is not the action's own,
//!   if there is exactly 1 such agent: in a method of `r1` and `lab_arm`, `r1` approaches
//!   `lab_arm`.

mod build;
mod form;
mod tree;

use self::form::FlatFile;
use super::diagnostic::{IhtnError, MissionDiagnostic, MissionErrorKind, MissionErrors};
use super::domain::Domain;
use super::limits::{FILE_BYTES_MAX, TASKS_MAX};
use super::model::Mission;
use crate::ids::{RoleId, TaskId, TaskType};
use std::collections::{BTreeMap, BTreeSet};

/// Options of the import of a flat iHTN.
#[derive(Debug, Clone)]
pub struct IhtnOptions {
    /// Name of the mission.
    pub name: TaskId,
    /// Agents that are people, or otherwise not commanded by the fleet.
    pub unmanaged: BTreeSet<RoleId>,
    /// Task types by their names in the file (`navto` for `navigation`).
    pub aliases: BTreeMap<String, TaskType>,
    /// Task types after which the location of the action is reached (`navigation`).
    pub reaching: BTreeSet<TaskType>,
}

/// Imports a flat iHTN and checks the mission against the domain.
///
/// # Errors
/// [`MissionErrors`] lists the problems of the tree; if there are none, those of the tasks.
pub fn import_ihtn(text: &str, options: &IhtnOptions, domain: &Domain) -> Result<Mission, MissionErrors> {
    let reject = |kind: IhtnError| MissionErrors {
        mission: options.name.to_string(),
        diagnostics: vec![MissionDiagnostic { path: "file".to_owned(), kind: kind.into() }],
    };
    if text.len() > FILE_BYTES_MAX {
        return Err(reject(IhtnError::TooLarge { bytes: text.len() }));
    }
    let FlatFile(nodes) =
        serde_json::from_str(text).map_err(|error| reject(IhtnError::Syntax { message: error.to_string() }))?;
    if nodes.len() > 2 * TASKS_MAX {
        let kind = MissionErrorKind::TooManyTasks { found: nodes.len(), max: 2 * TASKS_MAX };
        return Err(MissionErrors {
            mission: options.name.to_string(),
            diagnostics: vec![MissionDiagnostic { path: "file".to_owned(), kind }],
        });
    }
    let all = |diagnostics| MissionErrors { mission: options.name.to_string(), diagnostics };
    let root = tree::find_root(&nodes).map_err(all)?;
    let mission = build::build_mission(&nodes, root, options, domain).map_err(all)?;
    mission.check(domain)?;
    Ok(mission)
}

#[cfg(test)]
mod tests;
