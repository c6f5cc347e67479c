//! Builds a mission from its parsed file: checks names and substitutes parameters.

use super::form::{RoleFile, TaskFile, TemplateParameter};
use crate::ids::{ItemId, NameError, RoleId, TaskId, TaskType};
use crate::mission::diagnostic::{MissionDiagnostic, MissionErrorKind};
use crate::mission::domain::Domain;
use crate::mission::limits::TASKS_MAX;
use crate::mission::lost_item::LostItem;
use crate::mission::model::{
    ATTEMPTS, AlternativeMethod, Method, Mission, Role, TaskBody, TaskIndex, TaskNode, TaskOrder, TaskSpec,
};
use consort_text::AllowedNames;
use std::collections::{BTreeMap, BTreeSet};

/// Keeps in each branch the roles that have a task in it. The main branch also keeps roles without
/// any task.
pub(super) fn split_roles(mission: &mut Mission, recovery: &mut Mission) {
    let roles_with_tasks = |mission: &Mission| -> BTreeSet<RoleId> {
        mission.elementary().into_iter().flat_map(|(_, spec)| spec.roles.clone()).collect()
    };
    let (own, others) = (roles_with_tasks(mission), roles_with_tasks(recovery));
    mission.roles.retain(|role, _| own.contains(role) || !others.contains(role));
    recovery.roles.retain(|role, _| others.contains(role));
}

/// Returns the problems of a recovery branch.
pub(super) fn recovery_diagnostics(mission: &Mission, recovery: &Mission, domain: &Domain) -> Vec<MissionDiagnostic> {
    let filled = LostItem::example(domain).substitute_mission(recovery.clone()).expect("the example has all values");
    let of_branch = |MissionDiagnostic { path, kind }: MissionDiagnostic| match path.strip_prefix("root") {
        Some(below) => MissionDiagnostic { path: format!("recovery{below}"), kind },
        None => MissionDiagnostic { path: format!("recovery: {path}"), kind },
    };
    let mut found: Vec<MissionDiagnostic> =
        filled.check(domain).err().into_iter().flat_map(|errors| errors.diagnostics).map(of_branch).collect();
    let names: BTreeSet<&TaskId> = mission.task_names().collect();
    for task in recovery.task_names().filter(|task| names.contains(task)) {
        let kind = MissionErrorKind::DuplicateId { first: format!("root/…/{task}") };
        found.push(MissionDiagnostic { path: format!("recovery/…/{task}"), kind });
    }
    if mission.elementary().iter().all(|(_, spec)| spec.acquires.is_empty()) {
        found.push(MissionDiagnostic { path: "recovery".to_owned(), kind: MissionErrorKind::UnusedRecovery });
    }
    found
}

/// Mission under construction.
#[derive(Default)]
pub(super) struct MissionBuilder<'a> {
    /// Values by parameter name.
    pub(super) values: BTreeMap<&'a str, &'a str>,
    used: BTreeSet<&'a str>,
    pub(super) diagnostics: Vec<MissionDiagnostic>,
}

impl<'a> MissionBuilder<'a> {
    fn report(&mut self, path: &str, kind: MissionErrorKind) {
        self.diagnostics.push(MissionDiagnostic { path: path.to_owned(), kind });
    }

    /// Binds the declared parameters to the arguments of the request, or to their defaults.
    pub(super) fn bind_parameters(
        &mut self,
        declared: &'a BTreeMap<String, TemplateParameter>,
        arguments: &'a BTreeMap<String, String>,
        domain: &Domain,
    ) {
        for (name, parameter) in declared {
            let path = format!("parameters/{name}");
            let kind = parameter.kind.value_kind();
            let is_allowed = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
            if name.is_empty() || !name.chars().all(is_allowed) {
                let problem = "a parameter name may contain letters, digits, `_` and `-`".to_owned();
                self.report(&path, MissionErrorKind::Substitution { text: name.clone(), problem });
            }
            match arguments.get(name).or(parameter.default.as_ref()) {
                Some(value) => {
                    if !kind.admits(value) {
                        let (name, value) = (name.clone(), value.chars().take(80).collect());
                        self.report(&path, MissionErrorKind::BadValue { name, value, kind: kind.to_string() });
                    } else if let Some(kind) = domain.unknown_place(name, &kind, value) {
                        self.report(&path, kind);
                    }
                    self.values.insert(name, value);
                }
                None => {
                    self.report(&path, MissionErrorKind::MissingArgument { kind: kind.to_string() });
                    self.values.insert(name, ""); // so that its uses are not reported, too
                }
            }
        }
        for name in arguments.keys().filter(|name| !declared.contains_key(*name)) {
            let allowed = AllowedNames::suggest_for(name, declared.keys());
            self.report(&format!("parameters/{name}"), MissionErrorKind::UnknownArgument { allowed });
        }
    }

    /// Reports declared parameters that no task uses.
    pub(super) fn find_unused(&mut self, declared: &BTreeMap<String, TemplateParameter>) {
        let unused: Vec<&String> = declared.keys().filter(|name| !self.used.contains(name.as_str())).collect();
        for name in unused {
            self.report(&format!("parameters/{name}"), MissionErrorKind::UnusedParameter { name: name.clone() });
        }
    }

    /// Returns the name, or reports the problem and returns `None`.
    fn name<N>(&mut self, path: &str, name: Result<N, NameError>) -> Option<N> {
        name.map_err(|error| self.report(path, error.into())).ok()
    }

    /// Builds a branch with `path` as the path of its root.
    pub(super) fn mission(
        &mut self,
        name: &TaskId,
        declared: &'a BTreeMap<String, RoleFile>,
        root: &'a TaskFile,
        path: &str,
    ) -> Mission {
        let mut roles = BTreeMap::new();
        for (text, role) in declared {
            // An invalid name is reported once, for the main branch.
            let id = RoleId::new(&**text);
            let id = if path == "root" { self.name(&format!("roles/{text}"), id) } else { id.ok() };
            roles.extend(id.map(|id| (id, Role { kind: role.kind, on_loss: role.on_loss })));
        }
        let mut tasks: Vec<TaskNode> = Vec::new();
        let mut open: Vec<(&'a TaskFile, Option<usize>, String)> = vec![(root, None, path.to_owned())];
        // A single task above the limit is sufficient for the check to reject the mission.
        while let Some((node, parent, path)) = open.pop()
            && tasks.len() <= TASKS_MAX
        {
            let index = tasks.len();
            if let Some(TaskBody::Abstract(method)) = parent.map(|parent| &mut tasks[parent].body) {
                method.children.push(index as TaskIndex);
            }
            // An invalid name is an error of the file, which is reported. The task keeps a generated name
            // so that the rest of the file is checked, too.
            let generated =
                || TaskId::new(format!("unnamed-{index}")).expect("consists of characters allowed in a slug");
            let id = self.name(&path, TaskId::new(&*node.task)).unwrap_or_else(generated);
            let body = self.body(node, &path);
            tasks.push(TaskNode { id, body });
            // In a file that is nested too deeply, the total size of the paths must not grow with
            // the square of the depth.
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
            (None, None, None, None) => "has none of them",
        };
        self.report(path, MissionErrorKind::InvalidTaskShape { problem: problem.to_owned() });
        TaskBody::Abstract(Method::of(TaskOrder::Sequential, vec![]))
    }

    fn alternatives(&mut self, node: &'a TaskFile, path: &str) -> Vec<AlternativeMethod> {
        let mut alternatives = Vec::new();
        for (number, method) in (1..).zip(&node.alternatives) {
            let path = format!("{path}/alternative {number}");
            if method.method != TaskOrder::Sequential {
                let problem = "is an alternative; its method must be `sequential`".to_owned();
                self.report(&path, MissionErrorKind::InvalidTaskShape { problem });
            }
            let mut tasks = Vec::new();
            for task in &method.tasks {
                let path = format!("{path}/{}", task.task);
                let id = self.name(&path, TaskId::new(&*task.task));
                let spec = match self.body(task, &path) {
                    TaskBody::Elementary(spec) => Some(spec),
                    TaskBody::Abstract(_) => {
                        if task.task_type.is_none() {
                            let problem = "is part of an alternative; its tasks must be elementary".to_owned();
                            self.report(&path, MissionErrorKind::InvalidTaskShape { problem });
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
                Err(kind) => self.report(path, kind),
            }
        }
        filled
    }

    fn substitute(&mut self, text: &'a str) -> Result<String, MissionErrorKind> {
        let error =
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
            let after = after.strip_prefix('{').ok_or_else(|| error("a `$` is not followed by `{` or `$`"))?;
            let (name, after) = after.split_once('}').ok_or_else(|| error("a `${` is not closed"))?;
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
