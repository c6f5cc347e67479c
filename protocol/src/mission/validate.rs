//! Validation of missions from files and from the network.
//!
//! Every problem is reported, not only the first, each with the path to the task. After successful
//! validation the tree is well-formed (every index in range, children after parents, 1 parent each,
//! no task left over), so that code that walks it needs no further checks.

use super::diagnostic::{AllowedNames, MissionDiagnostic, MissionErrorKind, MissionErrors};
use super::domain::{Domain, ValueKind};
use super::model::{ATTEMPTS_MAX, Method, Mission, RoleKind, TaskBody, TaskSpec};
use crate::ids::{RoleId, TaskId};
use crate::plan::GlobalOrder;
use std::collections::{BTreeMap, BTreeSet};

/// Maximum number of tasks of a mission, including abstract tasks. Raised: more memory on every
/// robot and ledger; the largest published mission has 21 tasks.
pub const TASKS_MAX: usize = 512;
/// Maximum number of roles of a mission.
pub const ROLES_MAX: usize = 64;
/// Maximum number of levels of the tree.
pub const DEPTH_MAX: usize = 32;
/// Maximum number of roles of a joint task: each role signals to each other role, so the number of
/// messages grows quadratically.
pub const JOINT_MAX: usize = 8;
/// Maximum number of parameters, and of reached states, of a task.
pub const ENTRIES_MAX: usize = 32;
/// Maximum length of a name or value of a parameter or of a reached state, in characters.
pub const VALUE_CHARS_MAX: usize = 256;

impl Mission {
    /// Checks the tree, the roles, and each task against the domain.
    ///
    /// # Errors
    /// [`MissionErrors`] lists all problems.
    pub fn check(&self, domain: &Domain) -> Result<(), MissionErrors> {
        let mut found = check_tree_and_roles(self);
        if found.is_empty()
            && let Err(errors) = GlobalOrder::of(self)
        {
            found.extend(errors.diagnostics);
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

    /// Checks the tree and the roles without a domain: sufficient to divide the mission.
    ///
    /// # Errors
    /// [`MissionErrors`] lists all problems.
    pub fn check_structure(&self) -> Result<(), MissionErrors> {
        MissionErrors::ok_if_empty(&self.name, check_tree_and_roles(self))
    }
}

fn at(path: &str, kind: MissionErrorKind) -> MissionDiagnostic {
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
fn paths(mission: &Mission) -> Vec<String> {
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

fn check_tree_and_roles(mission: &Mission) -> Vec<MissionDiagnostic> {
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
fn specs<'a>(id: &'a TaskId, body: &'a TaskBody, path: &str) -> Vec<(String, &'a TaskId, &'a TaskSpec)> {
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

/// Checks the type and the parameters of a task.
fn check_task(mission: &Mission, spec: &TaskSpec, domain: &Domain) -> Vec<MissionErrorKind> {
    let Some(schema) = domain.get(&spec.task_type) else {
        let allowed = AllowedNames::suggest_for(spec.task_type.as_str(), domain.task_types());
        return vec![MissionErrorKind::UnknownType { task_type: spec.task_type.to_string(), allowed }];
    };
    let task_type = || spec.task_type.to_string();
    let mut found = Vec::new();
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
mod tests {
    use super::super::model::{Method, Role, RoleKind, TaskNode, TaskOrder};
    use super::*;
    use crate::ids::{TaskId, TaskType};

    fn role(name: &str) -> RoleId {
        RoleId::new(name).unwrap()
    }

    fn elementary(id: &str, task_type: &str, roles: &[&str], parameters: &[(&str, &str)]) -> TaskNode {
        let spec = TaskSpec {
            parameters: parameters.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect(),
            ..TaskSpec::of(TaskType::new(task_type).unwrap(), roles.iter().map(|name| role(name)).collect())
        };
        TaskNode { id: TaskId::new(id).unwrap(), body: TaskBody::Elementary(spec) }
    }

    fn refined(id: &str, children: &[u32]) -> TaskNode {
        let method = Method::of(TaskOrder::Sequential, children.to_vec());
        TaskNode { id: TaskId::new(id).unwrap(), body: TaskBody::Abstract(method) }
    }

    fn mission(roles: &[(&str, RoleKind)], tasks: Vec<TaskNode>) -> Mission {
        Mission {
            name: TaskId::new("trial").unwrap(),
            roles: roles.iter().map(|(name, kind)| (role(name), Role::of(*kind))).collect(),
            tasks,
        }
    }

    const R1: &[(&str, RoleKind)] = &[("r1", RoleKind::Managed)];

    fn diagnostics(mission: &Mission) -> Vec<String> {
        match mission.check(&Domain::hospital()) {
            Ok(()) => vec![],
            Err(errors) => errors.diagnostics.iter().map(ToString::to_string).collect(),
        }
    }

    #[test]
    fn a_valid_mission_passes() {
        let tasks = vec![refined("top", &[1]), elementary("go", "navigation", &["r1"], &[("to", "Laboratory")])];
        assert_eq!(diagnostics(&mission(R1, tasks)), Vec::<String>::new());
    }

    #[test]
    fn every_problem_is_reported_with_its_path_and_allowed_names() {
        let tasks = vec![
            refined("top", &[1, 2, 3]),
            elementary("go", "navigatoin", &["r1"], &[]),
            elementary("fetch", "pick_up", &["r1", "r9", "r1"], &[("from_role", "nurs"), ("colour", "red")]),
            refined("more", &[4]),
            elementary("shut", "operate_drawer", &["r1"], &[("action", "slam")]),
        ];
        let roles = &[("r1", RoleKind::Managed), ("nurse", RoleKind::Unmanaged)];
        assert_eq!(
            diagnostics(&mission(roles, tasks)),
            [
                "root/fetch: unknown role `r9`; allowed: nurse, r1; did you mean `r1`?",
                "root/fetch: names the role `r1` twice",
                "roles/nurse: has no task; add a task for it or remove it",
                "root/go: unknown task type `navigatoin`; allowed: approach_person, approach_robot, \
                 authenticate_person, carry, deposit, disinfect, dock, follow_path, grasp, navigation, operate_door, \
                 operate_drawer, pick_up, undock, wait; did you mean `navigation`?",
                "root/fetch: `pick_up` has no parameter `colour`; allowed: from_role, item",
                "root/fetch: parameter `from_role` names the role `nurs`, which is not declared in the mission; allowed: \
                 nurse, r1; did you mean `nurse`?",
                "root/more/shut: parameter `action` is \"slam\"; it must be one of close, open",
            ]
        );
    }

    #[test]
    fn a_missing_parameter_is_named() {
        let tasks = vec![elementary("go", "navigation", &["r1"], &[])];
        assert_eq!(diagnostics(&mission(R1, tasks)), ["root: `navigation` needs the parameter `to`: a place"]);
    }

    #[test]
    fn a_malformed_tree_is_rejected() {
        let go = |id| elementary(id, "wait", &["r1"], &[("seconds", "1")]);
        let cases = [
            (vec![], vec!["root: the mission has no task; the first task is the root"]),
            (
                vec![refined("top", &[1, 7]), go("a")],
                vec!["root: is refined into task number 7, but the mission has 2 tasks, counted from 0"],
            ),
            (
                vec![refined("top", &[1, 2]), refined("loop", &[0]), go("a")],
                vec!["root/loop: is refined into `top`, which is not listed after it: a cycle, or tasks out of order"],
            ),
            (
                vec![refined("top", &[1, 2]), refined("x", &[2]), go("a")],
                vec!["root/x: is refined into `a`, which already belongs to root; a task has one parent"],
            ),
            (
                vec![refined("top", &[1]), go("a"), go("b")],
                vec!["tasks[2] (b): belongs to no task; only the first task, the root, has no parent"],
            ),
            (
                vec![refined("top", &[1, 2]), refined("x", &[]), go("a")],
                vec!["root/x: its method has no tasks; a method needs at least 1 task"],
            ),
            (
                vec![refined("top", &[1, 2]), go("a"), go("a")],
                vec!["root/a: has the same name as root/a; task names must be unique in a mission"],
            ),
            (
                vec![refined("top", &[1]), elementary("a", "wait", &[], &[("seconds", "1")])],
                vec![
                    "root/a: has no role; name at least 1 role, allowed: r1",
                    "roles/r1: has no task; add a task for it or remove it",
                ],
            ),
        ];
        for (tasks, expected) in cases {
            assert_eq!(diagnostics(&mission(R1, tasks)), expected);
        }
    }

    #[test]
    fn a_mission_without_managed_roles_is_rejected() {
        let tasks = vec![elementary("a", "wait", &["nurse"], &[("seconds", "1")])];
        let roles = &[("nurse", RoleKind::Unmanaged)];
        assert_eq!(
            diagnostics(&mission(roles, tasks)),
            ["roles: no role is managed; a mission needs at least 1 role that a robot fills"]
        );
    }

    #[test]
    fn sizes_have_limits() {
        let many: Vec<u32> = (1..=TASKS_MAX as u32).collect();
        let mut tasks = vec![refined("top", &many)];
        tasks.extend(many.iter().map(|n| elementary(&format!("t{n}"), "wait", &["r1"], &[("seconds", "1")])));
        assert_eq!(diagnostics(&mission(R1, tasks.clone())), ["root: 513 tasks; at most 512 are allowed"]);
        tasks.pop();
        tasks[0] = refined("top", &many[..TASKS_MAX - 1]);
        assert_eq!(diagnostics(&mission(R1, tasks)), Vec::<String>::new());

        let mut chain: Vec<TaskNode> = (0..DEPTH_MAX as u32).map(|n| refined(&format!("d{n}"), &[n + 1])).collect();
        chain.push(elementary("end", "wait", &["r1"], &[("seconds", "1")]));
        let found = diagnostics(&mission(R1, chain));
        assert_eq!(found.len(), 1);
        assert!(found[0].ends_with("is 33 levels deep; at most 32 are allowed"), "{found:?}");
    }
}
