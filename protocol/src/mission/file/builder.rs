//! From the written form to a mission: names are checked, and what a request gives is put in.

use super::form::{RoleFile, TaskFile, TemplateParameter};
use crate::ids::{ItemId, NameError, RoleId, TaskId, TaskType};
use crate::mission::diagnostic::{AllowedNames, MissionDiagnostic, MissionErrorKind};
use crate::mission::domain::Domain;
use crate::mission::lost_item::LostItem;
use crate::mission::model::{
    ATTEMPTS, AlternativeMethod, Method, Mission, Role, TaskBody, TaskIndex, TaskNode, TaskOrder, TaskSpec,
};
use crate::mission::validate::TASKS_MAX;
use std::collections::{BTreeMap, BTreeSet};

/// Leaves to each branch the roles that do something in it; to the mission also those that do nothing in either.
pub(super) fn split_roles(mission: &mut Mission, recovery: &mut Mission) {
    let busy = |mission: &Mission| -> BTreeSet<RoleId> {
        mission.elementary().into_iter().flat_map(|(_, spec)| spec.roles.clone()).collect()
    };
    let (own, others) = (busy(mission), busy(recovery));
    mission.roles.retain(|role, _| own.contains(role) || !others.contains(role));
    recovery.roles.retain(|role, _| others.contains(role));
}

/// What is wrong with a recovery branch.
pub(super) fn recovery_diagnostics(mission: &Mission, recovery: &Mission, domain: &Domain) -> Vec<MissionDiagnostic> {
    let filled = LostItem::example(domain).substitute_mission(recovery.clone()).expect("all of it is known");
    let of_branch = |MissionDiagnostic { path, kind }: MissionDiagnostic| match path.strip_prefix("root") {
        Some(below) => MissionDiagnostic { path: format!("recovery{below}"), kind: kind },
        None => MissionDiagnostic { path: format!("recovery: {path}"), kind: kind },
    };
    let mut found: Vec<MissionDiagnostic> =
        filled.check(domain).err().into_iter().flat_map(|errors| errors.diagnostics).map(of_branch).collect();
    let names: BTreeSet<&TaskId> = mission.task_names().collect();
    for task in recovery.task_names().filter(|task| names.contains(task)) {
        let fault = MissionErrorKind::DuplicateId { first: format!("root/…/{task}") };
        found.push(MissionDiagnostic { path: format!("recovery/…/{task}"), kind: fault });
    }
    if mission.elementary().iter().all(|(_, spec)| spec.acquires.is_empty()) {
        found.push(MissionDiagnostic { path: "recovery".to_owned(), kind: MissionErrorKind::UnusedRecovery });
    }
    found
}

/// A mission under construction.
#[derive(Default)]
pub(super) struct MissionBuilder<'a> {
    /// What names stand for.
    pub(super) values: BTreeMap<&'a str, &'a str>,
    used: BTreeSet<&'a str>,
    pub(super) diagnostics: Vec<MissionDiagnostic>,
}

impl<'a> MissionBuilder<'a> {
    fn problem(&mut self, path: &str, fault: MissionErrorKind) {
        self.diagnostics.push(MissionDiagnostic { path: path.to_owned(), kind: fault });
    }

    /// Takes in what the request gives, and what it leaves to the file.
    pub(super) fn bind_parameters(
        &mut self,
        declared: &'a BTreeMap<String, TemplateParameter>,
        given: &'a BTreeMap<String, String>,
        domain: &Domain,
    ) {
        for (name, parameter) in declared {
            let path = format!("parameters/{name}");
            let kind = parameter.kind.value_kind();
            let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
            if name.is_empty() || !name.chars().all(plain) {
                let problem = "a parameter's name holds letters, digits, `_` and `-`".to_owned();
                self.problem(&path, MissionErrorKind::Substitution { text: name.clone(), problem });
            }
            match given.get(name).or(parameter.default.as_ref()) {
                Some(value) => {
                    if !kind.admits(value) {
                        let (name, value) = (name.clone(), value.chars().take(80).collect());
                        self.problem(&path, MissionErrorKind::BadValue { name, value, kind: kind.to_string() });
                    } else if let Some(fault) = domain.unknown_place(name, &kind, value) {
                        self.problem(&path, fault);
                    }
                    self.values.insert(name, value);
                }
                None => {
                    self.problem(&path, MissionErrorKind::MissingArgument { kind: kind.to_string() });
                    self.values.insert(name, ""); // so that its uses are not reported as well
                }
            }
        }
        for name in given.keys().filter(|name| !declared.contains_key(*name)) {
            let allowed = AllowedNames::suggest_for(name, declared.keys());
            self.problem(&format!("parameters/{name}"), MissionErrorKind::UnknownArgument { allowed });
        }
    }

    /// Finds parameters that stand nowhere.
    pub(super) fn find_unused(&mut self, declared: &BTreeMap<String, TemplateParameter>) {
        let unused: Vec<&String> = declared.keys().filter(|name| !self.used.contains(name.as_str())).collect();
        for name in unused {
            self.problem(&format!("parameters/{name}"), MissionErrorKind::UnusedParameter { name: name.clone() });
        }
    }

    /// The name, or a stand-in and a problem.
    fn name<N>(&mut self, path: &str, name: Result<N, NameError>) -> Option<N> {
        name.map_err(|error| self.problem(path, error.into())).ok()
    }

    /// One branch, of which `path` is the root.
    pub(super) fn mission(
        &mut self,
        name: &TaskId,
        declared: &'a BTreeMap<String, RoleFile>,
        root: &'a TaskFile,
        path: &str,
    ) -> Mission {
        let mut roles = BTreeMap::new();
        for (text, role) in declared {
            // A name that is none is told once, by the main branch.
            let id = RoleId::new(&**text);
            let id = if path == "root" { self.name(&format!("roles/{text}"), id) } else { id.ok() };
            roles.extend(id.map(|id| (id, Role { kind: role.kind, on_loss: role.on_loss })));
        }
        let mut tasks: Vec<TaskNode> = Vec::new();
        let mut open: Vec<(&'a TaskFile, Option<usize>, String)> = vec![(root, None, path.to_owned())];
        // One more than is allowed is enough for the check to refuse it.
        while let Some((node, parent, path)) = open.pop()
            && tasks.len() <= TASKS_MAX
        {
            let index = tasks.len();
            if let Some(TaskBody::Abstract(method)) = parent.map(|parent| &mut tasks[parent].body) {
                method.children.push(index as TaskIndex);
            }
            let stand_in = || TaskId::new(format!("unnamed-{index}")).expect("made of a slug's characters");
            let id = self.name(&path, TaskId::new(&*node.task)).unwrap_or_else(stand_in);
            let body = self.body(node, &path);
            tasks.push(TaskNode { id, body });
            // A file that is nested too deep shall not make paths of its own depth squared.
            let below = |child: &TaskFile| match path.len() {
                0..8192 => format!("{path}/{}", child.task),
                _ => path.clone(),
            };
            let children = node.tasks.iter().flatten().rev();
            open.extend(children.map(|child| (child, Some(index), below(child))));
        }
        Mission { name: name.clone(), roles, tasks }
    }

    fn body(&mut self, node: &'a TaskFile, path: &str) -> TaskBody {
        let problem = match (&node.method, &node.tasks, &node.task_type, &node.roles) {
            (Some(order), Some(_), None, None) if !node.has_entries() => {
                let alternatives = self.alternatives(node, path);
                return TaskBody::Abstract(Method { order: *order, children: vec![], alternatives });
            }
            (None, None, Some(task_type), Some(roles)) if node.alternatives.is_empty() => {
                return match self.elementary(node, task_type, roles, path) {
                    Some(spec) => TaskBody::Elementary(spec),
                    None => TaskBody::Abstract(Method::of(TaskOrder::Sequential, vec![])),
                };
            }
            (None, None, Some(_), Some(_)) => "is elementary and has `alternatives`",
            (Some(_), Some(_), None, None) => {
                "is abstract and has `parameters`, `reaches`, `acquires`, `releases` or `attempts`"
            }
            (Some(_), Some(_), ..) => "has `method` as well as `type` or `roles`",
            (Some(_), None, ..) => "has `method` but no `tasks`",
            (None, Some(_), ..) => "has `tasks` but no `method` (sequential or unordered)",
            (None, None, Some(_), None) => "has `type` but no `roles`",
            (None, None, None, Some(_)) => "has `roles` but no `type`",
            (None, None, None, None) => "has neither",
        };
        self.problem(path, MissionErrorKind::InvalidTaskShape { problem: problem.to_owned() });
        TaskBody::Abstract(Method::of(TaskOrder::Sequential, vec![]))
    }

    fn alternatives(&mut self, node: &'a TaskFile, path: &str) -> Vec<AlternativeMethod> {
        let mut alternatives = Vec::new();
        for (number, method) in (1..).zip(&node.alternatives) {
            let path = format!("{path}/alternative {number}");
            if method.method != TaskOrder::Sequential {
                let problem = "is an alternative, and the tasks of an alternative are `sequential`".to_owned();
                self.problem(&path, MissionErrorKind::InvalidTaskShape { problem });
            }
            let mut tasks = Vec::new();
            for task in &method.tasks {
                let path = format!("{path}/{}", task.task);
                let id = self.name(&path, TaskId::new(&*task.task));
                let spec = match self.body(task, &path) {
                    TaskBody::Elementary(spec) => Some(spec),
                    TaskBody::Abstract(_) => {
                        if task.task_type.is_none() {
                            let problem = "stands in an alternative, where all tasks are elementary".to_owned();
                            self.problem(&path, MissionErrorKind::InvalidTaskShape { problem });
                        }
                        None
                    }
                };
                tasks.extend(id.zip(spec));
            }
            alternatives.push(AlternativeMethod { tasks });
        }
        alternatives
    }

    fn elementary(&mut self, node: &'a TaskFile, task_type: &str, roles: &[String], path: &str) -> Option<TaskSpec> {
        let task_type = self.name(path, TaskType::new(task_type));
        let roles = roles.iter().filter_map(|role| self.name(path, RoleId::new(&**role))).collect();
        let parameters = self.entries(&node.parameters, path);
        let reaches = self.entries(&node.reaches, path);
        let mut acquires = BTreeMap::new();
        for (item, role) in &node.acquires {
            let item = self.name(path, ItemId::new(&**item));
            acquires.extend(item.zip(self.name(path, RoleId::new(&**role))));
        }
        let releases = node.releases.iter().filter_map(|item| self.name(path, ItemId::new(&**item))).collect();
        let attempts = node.attempts.unwrap_or(ATTEMPTS);
        Some(TaskSpec { parameters, reaches, acquires, releases, attempts, ..TaskSpec::of(task_type?, roles) })
    }

    fn entries(&mut self, entries: &'a BTreeMap<String, String>, path: &str) -> BTreeMap<String, String> {
        let mut filled = BTreeMap::new();
        for (name, text) in entries {
            match self.substitute(text) {
                Ok(value) => drop(filled.insert(name.clone(), value)),
                Err(fault) => self.problem(path, fault),
            }
        }
        filled
    }

    fn substitute(&mut self, text: &'a str) -> Result<String, MissionErrorKind> {
        let wrong =
            |problem: &str| MissionErrorKind::Substitution { text: text.to_owned(), problem: problem.to_owned() };
        let mut filled = String::new();
        let mut rest = text;
        while let Some((before, after)) = rest.split_once('$') {
            filled.push_str(before);
            if let Some(after) = after.strip_prefix('$') {
                filled.push('$');
                rest = after;
                continue;
            }
            let after = after.strip_prefix('{').ok_or_else(|| wrong("a `$` begins nothing"))?;
            let (name, after) = after.split_once('}').ok_or_else(|| wrong("a `${` is never closed"))?;
            let Some((name, value)) = self.values.get_key_value(name) else {
                let allowed = AllowedNames::suggest_for(name, self.values.keys());
                return Err(MissionErrorKind::UnknownReference { name: name.to_owned(), allowed });
            };
            self.used.insert(name);
            filled.push_str(value);
            rest = after;
        }
        filled.push_str(rest);
        Ok(filled)
    }
}
