//! Structure of a mission: the tree of tasks and the assignment to roles, without a domain.
//!
//! After a successful check the tree is well-formed (every index in range, children after parents,
//! 1 parent each, no task left over), so that code that walks it needs no further checks.

use super::diagnostic::{MissionDiagnostic, MissionErrorKind, MissionErrors};
use super::limits::{DEPTH_MAX, ENTRIES_MAX, JOINT_MAX, ROLES_MAX, TASKS_MAX, VALUE_CHARS_MAX};
use super::model::{ATTEMPTS_MAX, Method, Mission, PATIENCE_MAX_S, RoleKind, TaskBody, TaskSpec};
use crate::ids::{RoleId, TaskId};
use consort_text::AllowedNames;
use std::collections::{BTreeMap, BTreeSet};

impl Mission {
    /// Checks the tree and the roles without a domain: sufficient to divide the mission.
    ///
    /// # Errors
    /// [`MissionErrors`] lists all problems.
    pub(crate) fn check_structure(&self) -> Result<(), MissionErrors> {
        MissionErrors::ok_if_empty(&self.name, check_tree_and_roles(self))
    }

    /// Returns the problem of a request to people with these roles that escalates to another role.
    /// That role need not be one of the mission.
    pub fn escalation_problem(&self, asked: &[RoleId], to: &RoleId) -> Option<MissionErrorKind> {
        let role = to.clone();
        if asked.contains(to) {
            return Some(MissionErrorKind::EscalationToAsked { role });
        }
        let is_managed = self.roles.get(to).is_some_and(|declared| declared.kind == RoleKind::Managed);
        is_managed.then_some(MissionErrorKind::EscalationToRobot { role })
    }
}

pub(super) fn at(path: &str, kind: MissionErrorKind) -> MissionDiagnostic {
    MissionDiagnostic { path: path.to_owned(), kind }
}

/// Returns the parent of each task: the first preceding task that lists it as a child.
fn parents(mission: &Mission) -> Vec<Option<usize>> {
    let mut parents = vec![None; mission.tasks.len()];
    for (index, node) in mission.tasks.iter().enumerate() {
        let TaskBody::Abstract(method) = &node.body else { continue };
        for child in &method.children {
            let child = *child as usize;
            if child > index && child < parents.len() && parents[child].is_none() {
                parents[child] = Some(index);
            }
        }
    }
    parents
}

/// Returns the path of each task.
pub(super) fn paths(mission: &Mission) -> Vec<String> {
    let mut paths: Vec<String> = Vec::with_capacity(mission.tasks.len());
    for (index, (node, parent)) in mission.tasks.iter().zip(parents(mission)).enumerate() {
        paths.push(match parent {
            _ if index == 0 => "root".to_owned(),
            // A path grows by at most 65 characters per level; longer paths beyond the limit would
            // not help.
            Some(parent) if paths[parent].len() < 65 * (DEPTH_MAX + 1) => format!("{}/{}", paths[parent], node.id),
            Some(_) => format!("…/{}", node.id),
            None => format!("tasks[{index}] ({})", node.id),
        });
    }
    paths
}

pub(super) fn check_tree_and_roles(mission: &Mission) -> Vec<MissionDiagnostic> {
    let mut found = Vec::new();
    if mission.tasks.is_empty() {
        found.push(at("root", MissionErrorKind::NoTask));
        return found;
    }
    let others = mission.tasks.iter().map(|node| match &node.body {
        TaskBody::Abstract(method) => method.alternatives.iter().map(|other| other.tasks.len()).sum(),
        TaskBody::Elementary(_) => 0,
    });
    let count = mission.tasks.len() + others.sum::<usize>();
    if count > TASKS_MAX {
        found.push(at("root", MissionErrorKind::TooManyTasks { found: count, max: TASKS_MAX }));
    }
    if mission.roles.len() > ROLES_MAX {
        found.push(at("roles", MissionErrorKind::TooManyRoles { found: mission.roles.len(), max: ROLES_MAX }));
    }
    if !found.is_empty() {
        return found; // further checks could take long, and their output would be too long to read
    }
    if mission.managed_roles().next().is_none() {
        found.push(at("roles", MissionErrorKind::NoManagedRole));
    }
    let parents = parents(mission);
    let paths = paths(mission);
    check_tree(mission, &parents, &paths, &mut found);
    let mut roles_with_tasks: BTreeSet<&RoleId> = BTreeSet::new();
    for (node, path) in mission.tasks.iter().zip(&paths) {
        for (path, _, spec) in specs(&node.id, &node.body, path) {
            roles_with_tasks.extend(&spec.roles);
            found.extend(check_assignment(mission, spec).into_iter().map(|kind| at(&path, kind)));
        }
    }
    let unused = mission.roles.keys().filter(|role| !roles_with_tasks.contains(role));
    found.extend(unused.map(|role| at(&format!("roles/{role}"), MissionErrorKind::UnusedRole)));
    if found.is_empty() {
        // Only in a well-formed tree, since this walks it.
        for (index, (node, path)) in mission.tasks.iter().zip(&paths).enumerate() {
            if let TaskBody::Abstract(method) = &node.body {
                found.extend(check_locality(mission, index, method).map(|kind| at(path, kind)));
            }
        }
    }
    found
}

/// Returns the elementary tasks of a node itself, including those of its alternatives, each with
/// its path.
pub(super) fn specs<'a>(id: &'a TaskId, body: &'a TaskBody, path: &str) -> Vec<(String, &'a TaskId, &'a TaskSpec)> {
    match body {
        TaskBody::Elementary(spec) => vec![(path.to_owned(), id, spec)],
        TaskBody::Abstract(method) => {
            let others = (1..).zip(&method.alternatives);
            let tasks = others.flat_map(|(number, other)| other.tasks.iter().map(move |task| (number, task)));
            tasks.map(|(number, (id, spec))| (format!("{path}/alternative {number}/{id}"), id, spec)).collect()
        }
    }
}

/// Checks that a method with alternatives is local to a single managed role.
fn check_locality(mission: &Mission, index: usize, method: &Method) -> Option<MissionErrorKind> {
    if method.alternatives.is_empty() {
        return None;
    }
    let own = mission.elementary_below(index);
    let others = method.alternatives.iter().flat_map(|other| other.tasks.iter().map(|(id, spec)| (id, spec)));
    let all: Vec<_> = own.into_iter().chain(others).collect();
    let role = all.first().and_then(|(_, spec)| spec.roles.first())?;
    all.into_iter().find_map(|(task, spec)| {
        let problem = if spec.roles[..] != [role.clone()] {
            let roles: Vec<&str> = spec.roles.iter().map(RoleId::as_str).collect();
            format!("is executed by {}, and the first task by {role}", roles.join(" and "))
        } else if mission.roles.get(role).is_some_and(|role| role.kind == RoleKind::Unmanaged) {
            format!("is executed by {role}, which is unmanaged")
        } else if let Some(item) = spec.items().next() {
            format!("touches `{item}`")
        } else {
            return None;
        };
        Some(MissionErrorKind::NonLocalAlternatives { task: task.clone(), problem })
    })
}

fn check_tree(mission: &Mission, parents: &[Option<usize>], paths: &[String], found: &mut Vec<MissionDiagnostic>) {
    let tasks = mission.tasks.len();
    let mut named: BTreeMap<&TaskId, String> = BTreeMap::new();
    let mut claimed: BTreeSet<usize> = BTreeSet::new();
    let mut depths: Vec<usize> = Vec::with_capacity(tasks);
    for (index, node) in mission.tasks.iter().enumerate() {
        let path = &paths[index];
        let depth = parents[index].map_or(1, |parent| depths[parent] + 1);
        depths.push(depth);
        if depth == DEPTH_MAX + 1 {
            found.push(at(path, MissionErrorKind::TooDeep { found: depth, max: DEPTH_MAX }));
        }
        if index > 0 && parents[index].is_none() {
            found.push(at(path, MissionErrorKind::NoParent));
        }
        let others = match &node.body {
            TaskBody::Abstract(_) => specs(&node.id, &node.body, path),
            TaskBody::Elementary(_) => vec![],
        };
        let own = std::iter::once((path.clone(), &node.id)).chain(others.into_iter().map(|(path, id, _)| (path, id)));
        for (path, id) in own {
            match named.get(id) {
                Some(first) => found.push(at(&path, MissionErrorKind::DuplicateId { first: first.clone() })),
                None => drop(named.insert(id, path)),
            }
        }
        let TaskBody::Abstract(method) = &node.body else { continue };
        if method.children.is_empty() {
            found.push(at(path, MissionErrorKind::EmptyMethod));
        }
        for (number, other) in (1..).zip(&method.alternatives) {
            if other.tasks.is_empty() {
                found.push(at(&format!("{path}/alternative {number}"), MissionErrorKind::EmptyMethod));
            }
        }
        for &child in &method.children {
            let Some(child_node) = mission.tasks.get(child as usize) else {
                found.push(at(path, MissionErrorKind::ChildOutOfRange { child, tasks }));
                continue;
            };
            let name = child_node.id.to_string();
            if child as usize <= index {
                found.push(at(path, MissionErrorKind::ChildNotAfter { child: name }));
            } else if !claimed.insert(child as usize) {
                let parent = parents[child as usize].map_or_else(String::new, |parent| paths[parent].clone());
                found.push(at(path, MissionErrorKind::TwoParents { child: name, parent }));
            }
        }
    }
}

/// Checks the roles, attempts and items of a task.
fn check_assignment(mission: &Mission, spec: &TaskSpec) -> Vec<MissionErrorKind> {
    let mut found = Vec::new();
    if spec.roles.is_empty() {
        found.push(MissionErrorKind::NoRole { allowed: AllowedNames { names: role_names(mission), nearest: None } });
    }
    if spec.roles.len() > JOINT_MAX {
        found.push(MissionErrorKind::TooManyJoint { found: spec.roles.len(), max: JOINT_MAX });
    }
    let mut seen = BTreeSet::new();
    for role in &spec.roles {
        if !seen.insert(role) {
            found.push(MissionErrorKind::RoleTwice { role: role.clone() });
        } else if !mission.roles.contains_key(role) {
            let allowed = AllowedNames::suggest_for(role.as_str(), mission.roles.keys());
            found.push(MissionErrorKind::UnknownRole { role: role.to_string(), allowed });
        }
    }
    if !(1..=ATTEMPTS_MAX).contains(&spec.attempts) {
        found.push(MissionErrorKind::Attempts { found: spec.attempts, max: ATTEMPTS_MAX });
    }
    let waits = [("patience_s", spec.patience_s), ("escalate", spec.escalation.as_ref().map(|other| other.after_s))];
    for (what, seconds) in waits.into_iter().filter_map(|(what, seconds)| Some((what, seconds?))) {
        if !(1..=PATIENCE_MAX_S).contains(&seconds) {
            found.push(MissionErrorKind::Patience { what, found: seconds, max: PATIENCE_MAX_S });
        }
        let of_robot = |role: &&RoleId| mission.roles.get(*role).is_some_and(|role| role.kind == RoleKind::Managed);
        if let Some(role) = spec.roles.iter().find(of_robot) {
            found.push(MissionErrorKind::PatienceOfRobot { what, role: role.clone() });
        }
    }
    if let Some(escalation) = &spec.escalation {
        found.extend(mission.escalation_problem(&spec.roles, &escalation.to));
    }
    for role in spec.acquires.values().filter(|role| !mission.roles.contains_key(*role)) {
        let allowed = AllowedNames::suggest_for(role.as_str(), mission.roles.keys());
        found.push(MissionErrorKind::UnknownRole { role: role.to_string(), allowed });
    }
    if let Some(item) = spec.releases.iter().find(|item| spec.acquires.contains_key(*item)) {
        found.push(MissionErrorKind::ItemTwice { item: item.clone() });
    }
    let items = spec.items().count();
    if items > ENTRIES_MAX {
        found.push(MissionErrorKind::TooManyEntries { what: "items", found: items, max: ENTRIES_MAX });
    }
    for (what, entries) in [("parameters", &spec.parameters), ("reached states", &spec.reaches)] {
        if entries.len() > ENTRIES_MAX {
            found.push(MissionErrorKind::TooManyEntries { what, found: entries.len(), max: ENTRIES_MAX });
        }
        let what = if what == "parameters" { "the parameter" } else { "the reached state" };
        for (name, value) in entries {
            let length = name.chars().count().max(value.chars().count());
            if length > VALUE_CHARS_MAX {
                let name = name.chars().take(40).collect();
                found.push(MissionErrorKind::TooLong { what, name, found: length, max: VALUE_CHARS_MAX });
            }
        }
    }
    found
}

fn role_names(mission: &Mission) -> Vec<String> {
    mission.roles.keys().map(ToString::to_string).collect()
}
