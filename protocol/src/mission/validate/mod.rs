//! Validation of missions from files and from the network.
//!
//! Every problem is reported, not only the first, each with the path to the task.

use super::diagnostic::{MissionErrorKind, MissionErrors};
use super::domain::{Domain, ValueKind};
use super::limits::{ROLES_MAX, TASKS_MAX};
use super::model::{Mission, RoleKind, TaskSpec};
use super::order::GlobalOrder;
use super::policies::policy_problems;
use super::references::reference_problems;
use super::structure::{at, check_tree_and_roles, paths, specs};
use consort_text::AllowedNames;

impl Mission {
    /// Checks the tree, the roles, and each task against the domain.
    ///
    /// # Errors
    /// [`MissionErrors`] lists all problems.
    pub fn check(&self, domain: &Domain) -> Result<(), MissionErrors> {
        let mut found = check_tree_and_roles(self);
        found.extend(policy_problems(self, domain));
        if found.is_empty() {
            match GlobalOrder::of(self) {
                Ok(order) => found.extend(reference_problems(self, &order, domain)),
                Err(errors) => found.extend(errors.diagnostics),
            }
        }
        // In a malformed tree some paths are meaningless, but the tasks can still be checked.
        if self.tasks.len() <= TASKS_MAX && self.roles.len() <= ROLES_MAX {
            let paths = paths(self);
            for (node, path) in self.tasks.iter().zip(&paths) {
                for (path, _, spec) in specs(&node.id, &node.body, path) {
                    found.extend(check_task(self, spec, domain).into_iter().map(|kind| at(&path, kind)));
                }
            }
        }
        MissionErrors::ok_if_empty(&self.name, found)
    }
}

/// Checks the type, the parameters and the items of a task.
pub(super) fn check_task(mission: &Mission, spec: &TaskSpec, domain: &Domain) -> Vec<MissionErrorKind> {
    let Some(schema) = domain.get(&spec.task_type) else {
        let allowed = AllowedNames::suggest_for(spec.task_type.as_str(), domain.task_types());
        return vec![MissionErrorKind::UnknownType { task_type: spec.task_type.to_string(), allowed }];
    };
    let task_type = || spec.task_type.to_string();
    let mut found = Vec::new();
    // A person may hand an item over in any task.
    let is_of_robots = || {
        let mut roles = spec.roles.iter().map(|role| mission.roles.get(role));
        roles.all(|role| role.is_some_and(|role| role.kind == RoleKind::Managed))
    };
    if schema.hands_over == Some(false)
        && let Some(item) = spec.items().next()
        && is_of_robots()
    {
        let names = domain.handing_over().map(ToString::to_string).collect();
        let allowed = AllowedNames { names, nearest: None };
        let (item, task_type) = (item.clone(), spec.task_type.clone());
        found.push(MissionErrorKind::HandsNothingOver { item, task_type, allowed });
    }
    for (name, parameter) in &schema.parameters {
        if parameter.required && !spec.parameters.contains_key(name) {
            let kind = parameter.kind.to_string();
            found.push(MissionErrorKind::MissingParameter { task_type: task_type(), name: name.clone(), kind });
        }
    }
    for (name, value) in &spec.parameters {
        let Some(parameter) = schema.parameters.get(name) else {
            let allowed = AllowedNames::suggest_for(name, schema.parameters.keys());
            found.push(MissionErrorKind::UnknownParameter { task_type: task_type(), name: name.clone(), allowed });
            continue;
        };
        let is_role = parameter.kind == ValueKind::Role;
        if is_role && !mission.roles.keys().any(|role| role.as_str() == value) {
            let allowed = AllowedNames::suggest_for(value, mission.roles.keys());
            found.push(MissionErrorKind::ParameterRole { name: name.clone(), role: value.clone(), allowed });
        } else if !parameter.kind.admits(value) {
            let kind = parameter.kind.to_string();
            found.push(MissionErrorKind::BadValue { name: name.clone(), value: value.clone(), kind });
        } else {
            found.extend(domain.unknown_place(name, &parameter.kind, value));
        }
    }
    found
}

#[cfg(test)]
mod tests;
