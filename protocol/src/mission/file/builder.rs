//! Builds a mission from its parsed file: checks names and substitutes parameters.

use super::form::{
    ChoiceFile, ITERATIONS_MAX, ListFile, RoleFile, TaskFile, TemplateKind, TemplateParameter, text_literal,
};
use super::scope::Scope;
use crate::ensemble::Eligibility;
use crate::ids::{EnsembleId, ItemId, NameError, RoleId, TaskId, TaskType};
use crate::mission::diagnostic::{MissionDiagnostic, MissionErrorKind};
use crate::mission::domain::Domain;
use crate::mission::limits::TASKS_MAX;
use crate::mission::lost_item::{LOST, LostItem};
use crate::mission::model::{
    ATTEMPTS, AlternativeMethod, Method, Mission, ResultReference, Role, RoleKind, TaskBody, TaskIndex, TaskNode,
    TaskOrder, TaskSpec,
};
use consort_text::AllowedNames;
use std::collections::{BTreeMap, BTreeSet};
use std::mem;

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
    kinds: BTreeMap<&'a str, TemplateKind>,
    used: BTreeSet<&'a str>,
    /// Number of elementary tasks of each role, in all branches.
    pub(super) tasks_by_role: BTreeMap<&'a str, usize>,
    managed_roles: BTreeSet<&'a str>,
    /// Roles of the iterations of spread loops, by the role in the file that they replace.
    spread_roles: BTreeMap<&'a str, BTreeSet<RoleId>>,
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
                    for part in parameter.kind.parts(value) {
                        if !kind.admits(part) {
                            let (name, value) = (name.clone(), part.chars().take(80).collect());
                            self.report(&path, MissionErrorKind::BadValue { name, value, kind: kind.to_string() });
                        } else if let Some(kind) = domain.unknown_place(name, &kind, part) {
                            self.report(&path, kind);
                        }
                    }
                    self.values.insert(name, value);
                    self.kinds.insert(name, parameter.kind);
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

    /// Builds the roles of all branches. The robot of each managed role must also meet `eligible`.
    pub(super) fn roles(
        &mut self,
        declared: &'a BTreeMap<String, RoleFile>,
        eligible: Option<&str>,
    ) -> BTreeMap<RoleId, Role> {
        let of_mission = eligible.and_then(|text| self.eligibility(text, "eligible"));
        let mut roles = BTreeMap::new();
        for (name, RoleFile { kind, on_loss, eligible, .. }) in declared {
            let path = format!("roles/{name}");
            let eligible_path = format!("{path}/eligible");
            let eligible = match (kind, eligible, &of_mission) {
                (RoleKind::Managed, Some(own), Some(of_mission)) => {
                    self.eligibility(own, &eligible_path).map(|own| format!("({of_mission}) && ({own})"))
                }
                (RoleKind::Managed, None, of_mission) => of_mission.clone(),
                (_, own, _) => own.as_ref().and_then(|own| self.expression(own, &Scope::default(), &eligible_path)),
            };
            let id = self.name(&path, RoleId::new(&**name));
            self.managed_roles.extend((*kind == RoleKind::Managed).then_some(name.as_str()));
            let role = Role { kind: *kind, on_loss: *on_loss, eligible, spread: false };
            roles.extend(id.map(|id| (id, role)));
        }
        roles
    }

    /// Returns a condition that is an expression by itself, so that it can be part of another. `None` if a
    /// problem was reported.
    fn eligibility(&mut self, text: &str, path: &str) -> Option<String> {
        let text = self.expression(text, &Scope::default(), path)?;
        match Eligibility::compile(&text) {
            Ok(_) => Some(text),
            Err(problem) => {
                self.report(path, MissionErrorKind::Expression { text, problem });
                None
            }
        }
    }

    /// Replaces the roles of spread loops by those of their iterations, once all tasks are built.
    pub(super) fn spread(&mut self, roles: &mut BTreeMap<RoleId, Role>) {
        for (name, iterations) in mem::take(&mut self.spread_roles) {
            let Some(role) = RoleId::new(name).ok().and_then(|id| roles.remove(&id)) else { continue };
            for id in iterations {
                if roles.contains_key(&id) {
                    let kind = MissionErrorKind::DuplicateRole { role: id.clone() };
                    self.report(&format!("roles/{name}"), kind);
                }
                roles.insert(id, Role { spread: true, ..role.clone() });
            }
        }
    }

    /// Builds the ensembles of the mission.
    pub(super) fn ensembles(&mut self, names: &[String]) -> Vec<EnsembleId> {
        names.iter().filter_map(|name| self.name("ensembles", EnsembleId::new(&**name))).collect()
    }

    /// Builds a branch with `path` as the path of its root.
    pub(super) fn tasks(&mut self, root: &'a TaskFile, path: &str) -> Vec<TaskNode> {
        let mut tasks: Vec<TaskNode> = Vec::new();
        let first = OpenTask { node: root, parent: None, path: path.to_owned(), scope: Scope::default() };
        let mut open: Vec<OpenTask<'a>> = vec![first];
        // A single task above the limit is sufficient for the check to reject the mission.
        while let Some(OpenTask { node, parent, path, scope }) = open.pop()
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
            let id = self.name(&path, TaskId::new(scope.task_name(&node.task))).unwrap_or_else(generated);
            let mut scope = scope;
            if let Some(text) = &node.when {
                scope.conditions.extend(self.expression(text, &scope, &path));
            }
            let (body, children) = self.body(node, &path, &scope);
            tasks.push(TaskNode { id, body });
            // In a file that is nested too deeply, the total size of the paths must not grow with
            // the square of the depth.
            let below = |task: &str| match path.len() {
                0..8192 => format!("{path}/{task}"),
                _ => path.clone(),
            };
            let children = children.into_iter().rev();
            open.extend(children.map(|(child, scope)| {
                let path = below(&scope.task_name(&child.task));
                OpenTask { node: child, parent: Some(index), path, scope }
            }));
        }
        tasks
    }

    /// Returns the results of the mission.
    pub(super) fn results(&mut self, results: &'a BTreeMap<String, String>) -> BTreeMap<String, String> {
        let scope = Scope::default();
        let substitute = |(name, text): (&String, &'a String)| {
            Some((name.clone(), self.expression(text, &scope, &format!("result/{name}"))?))
        };
        results.iter().filter_map(substitute).collect()
    }

    /// Returns the content of a task and the tasks directly below it, with their scopes.
    fn body(&mut self, node: &'a TaskFile, path: &str, scope: &Scope) -> (TaskBody, Vec<(&'a TaskFile, Scope)>) {
        let sequence = |children| (TaskBody::Abstract(Method::of(TaskOrder::Sequential, vec![])), children);
        let is_plain = node.tasks.is_none() && node.task_type.is_none() && node.roles.is_none();
        let is_plain = is_plain && !node.has_entries() && node.alternatives.is_empty();
        let is_plain_sequence = is_plain && node.method.is_none() && !node.spread;
        let problem = match (&node.choose, &node.variable, &node.values, node.repeat, &node.until, &node.body) {
            (None, None, None, None, None, None) if node.otherwise.is_none() && !node.spread => {
                return self.plain_body(node, path, scope);
            }
            (Some(choices), None, None, None, None, None) if is_plain_sequence => {
                return sequence(self.choice(choices, node.otherwise.as_deref(), path, scope));
            }
            (None, Some(variable), Some(values), None, None, Some(body)) if is_plain && node.otherwise.is_none() => {
                let order = match (node.spread, node.method) {
                    (false, method) => method.unwrap_or(TaskOrder::Sequential),
                    (true, None | Some(TaskOrder::Unordered)) => TaskOrder::Unordered,
                    (true, Some(TaskOrder::Sequential)) => {
                        let problem = "is spread over robots, so its iterations are unordered".to_owned();
                        self.report(path, MissionErrorKind::InvalidTaskShape { problem });
                        TaskOrder::Unordered
                    }
                };
                let own_roles = if node.spread { self.own_roles(body, path) } else { BTreeSet::new() };
                let children = self.for_each(variable, values, body, &own_roles, path, scope);
                return (TaskBody::Abstract(Method::of(order, vec![])), children);
            }
            (None, None, None, Some(count), Some(until), Some(body))
                if is_plain_sequence && node.otherwise.is_none() =>
            {
                return sequence(self.repetition(count, until, body, path, scope));
            }
            (Some(_), ..) => "has `choose`, with which only `else` is allowed",
            (None, Some(_), ..) | (None, None, Some(_), ..) => {
                "is a loop, which has `for`, `in` and `do`, and may have a `method` or `spread: true`"
            }
            (None, None, None, Some(_), ..) | (None, None, None, None, Some(_), _) => {
                "is a repetition, which has `repeat`, `do` and `until`"
            }
            (None, None, None, None, None, _) => {
                "has `else` without `choose`, `do` without `for` or `repeat`, or `spread` without `for`"
            }
        };
        self.report(path, MissionErrorKind::InvalidTaskShape { problem: problem.to_owned() });
        sequence(vec![])
    }

    /// Returns the branches of a choice. Each is executed if its condition holds and no earlier one does.
    fn choice(
        &mut self,
        choices: &'a [ChoiceFile],
        otherwise: Option<&'a TaskFile>,
        path: &str,
        scope: &Scope,
    ) -> Vec<(&'a TaskFile, Scope)> {
        let mut branches = vec![];
        let mut remaining = scope.clone();
        for ChoiceFile { when, body } in choices {
            let Some(condition) = self.expression(when, scope, path) else { continue };
            branches.push((body, remaining.clone().with_condition(condition.clone())));
            remaining = remaining.with_condition(format!("!({condition})"));
        }
        branches.extend(otherwise.map(|body| (body, remaining)));
        branches
    }

    /// Returns the roles of each iteration of a spread loop alone: the managed roles of its body that no other
    /// task has.
    fn own_roles(&mut self, body: &'a TaskFile, path: &str) -> BTreeSet<&'a str> {
        let tasks = body.tasks_by_role();
        let is_own = |role: &&str| self.managed_roles.contains(role) && self.tasks_by_role.get(role) == tasks.get(role);
        let own: BTreeSet<&str> = tasks.keys().copied().filter(is_own).collect();
        if own.is_empty() {
            let problem = "is spread over robots, but has no managed role that no other task has".to_owned();
            self.report(path, MissionErrorKind::InvalidTaskShape { problem });
        }
        for role in &own {
            self.check_variable(role, "a role of a spread loop", path, &Scope::default());
            self.spread_roles.entry(role).or_default();
        }
        own
    }

    fn check_variable(&mut self, name: &str, what: &str, path: &str, scope: &Scope) {
        if self.values.contains_key(name) || scope.values.contains_key(name) {
            let problem = format!("{what} has the name of a parameter or of another variable");
            self.report(path, MissionErrorKind::Substitution { text: name.to_owned(), problem });
        }
    }

    /// Returns the iterations of a loop over values, each with roles of its own.
    fn for_each(
        &mut self,
        variable: &'a str,
        values: &'a ListFile,
        body: &'a TaskFile,
        own_roles: &BTreeSet<&'a str>,
        path: &str,
        scope: &Scope,
    ) -> Vec<(&'a TaskFile, Scope)> {
        self.check_variable(variable, "the variable of the loop", path, scope);
        let values: Vec<String> = match values {
            ListFile::Values(values) => {
                values.iter().filter_map(|value| self.substitute_or_report(value, scope, path)).collect()
            }
            ListFile::Reference(text) => match self.list_parameter(text) {
                Some(values) => values,
                None => {
                    let problem = "`in` is a list, or `${name}` of a parameter of kind `places` or `texts`".to_owned();
                    self.report(path, MissionErrorKind::Substitution { text: text.clone(), problem });
                    vec![]
                }
            },
        };
        let names = body.names();
        let iteration = |(number, value)| {
            let mut scope = scope.iteration(number, &names).with_own_roles(own_roles);
            scope.values.insert(variable.to_owned(), value);
            (body, scope)
        };
        (1..).zip(values).map(iteration).collect()
    }

    /// Returns the values of the list parameter that the text refers to.
    fn list_parameter(&mut self, text: &str) -> Option<Vec<String>> {
        let name = text.strip_prefix("${")?.strip_suffix('}')?;
        let kind =
            self.kinds.get(name).copied().filter(|kind| matches!(kind, TemplateKind::Places | TemplateKind::Texts))?;
        let (name, value) = self.values.get_key_value(name)?;
        self.used.insert(name);
        Some(kind.parts(value).into_iter().map(str::to_owned).collect())
    }

    /// Returns the iterations of a repetition. Each is executed if no earlier one has met the condition
    /// `until`.
    fn repetition(
        &mut self,
        count: u32,
        until: &'a str,
        body: &'a TaskFile,
        path: &str,
        scope: &Scope,
    ) -> Vec<(&'a TaskFile, Scope)> {
        if !(1..=ITERATIONS_MAX).contains(&count) {
            let problem = format!("repeats {count} times; 1 to {ITERATIONS_MAX} times are allowed");
            self.report(path, MissionErrorKind::InvalidTaskShape { problem });
            return vec![];
        }
        let names = body.names();
        let mut conditions = scope.conditions.clone();
        let mut iterations = vec![];
        for number in 1..=count as usize {
            let mut iteration = scope.iteration(number, &names);
            let Some(condition) = self.expression(until, &iteration, path) else { break };
            iteration.conditions.clone_from(&conditions);
            iterations.push((body, iteration));
            conditions.push(format!("!({condition})"));
        }
        iterations
    }

    fn plain_body(&mut self, node: &'a TaskFile, path: &str, scope: &Scope) -> (TaskBody, Vec<(&'a TaskFile, Scope)>) {
        let empty = || (TaskBody::Abstract(Method::of(TaskOrder::Sequential, vec![])), vec![]);
        let problem = match (&node.method, &node.tasks, &node.task_type, &node.roles) {
            (Some(order), Some(tasks), None, None) if !node.has_entries() => {
                let alternatives = self.alternatives(node, path, scope);
                let children = tasks.iter().map(|task| (task, scope.clone())).collect();
                return (TaskBody::Abstract(Method { order: *order, children: vec![], alternatives }), children);
            }
            (None, None, Some(task_type), Some(roles)) if node.alternatives.is_empty() => {
                return match self.elementary(node, task_type, roles, path, scope) {
                    Some(spec) => (TaskBody::Elementary(spec), vec![]),
                    None => empty(),
                };
            }
            (None, None, Some(_), Some(_)) => "is elementary and has `alternatives`",
            (Some(_), Some(_), None, None) => {
                "is abstract and has `parameters`, `reaches`, `acquires`, `releases`, `attempts`, `patience_s` or `escalate`"
            }
            (Some(_), Some(_), ..) => "has `method` as well as `type` or `roles`",
            (Some(_), None, ..) => "has `method` but no `tasks`",
            (None, Some(_), ..) => "has `tasks` but no `method` (sequential or unordered)",
            (None, None, Some(_), None) => "has `type` but no `roles`",
            (None, None, None, Some(_)) => "has `roles` but no `type`",
            (None, None, None, None) => "has none of them",
        };
        self.report(path, MissionErrorKind::InvalidTaskShape { problem: problem.to_owned() });
        empty()
    }

    fn alternatives(&mut self, node: &'a TaskFile, path: &str, scope: &Scope) -> Vec<AlternativeMethod> {
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
                let id = self.name(&path, TaskId::new(scope.task_name(&task.task)));
                let spec = match self.body(task, &path, &scope.without_conditions()).0 {
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

    fn elementary(
        &mut self,
        node: &'a TaskFile,
        task_type: &str,
        roles: &'a [String],
        path: &str,
        scope: &Scope,
    ) -> Option<TaskSpec> {
        let task_type = self.name(path, TaskType::new(task_type));
        let roles = roles.iter().filter_map(|role| self.role(role, path, scope)).collect();
        let is_input = |text: &str| reference(text, scope).is_some();
        let (inputs, parameters): (BTreeMap<_, _>, BTreeMap<_, _>) =
            node.parameters.iter().partition(|(_, text)| is_input(text));
        let inputs = inputs
            .into_iter()
            .filter_map(|(name, text): (&String, &String)| Some((name.clone(), reference(text, scope)?)));
        let inputs = inputs.collect();
        let parameters = self.entries(parameters, path, scope);
        let reaches = self.entries(node.reaches.iter().collect(), path, scope);
        let mut acquires = BTreeMap::new();
        for (item, role) in &node.acquires {
            let item = self.name(path, ItemId::new(&**item));
            acquires.extend(item.zip(self.role(role, path, scope)));
        }
        let releases = node.releases.iter().filter_map(|item| self.name(path, ItemId::new(&**item))).collect();
        let attempts = node.attempts.unwrap_or(ATTEMPTS);
        let conditions = scope.conditions.clone();
        let spec = TaskSpec::of(task_type?, roles);
        Some(TaskSpec {
            parameters,
            reaches,
            acquires,
            releases,
            attempts,
            patience_s: node.patience_s,
            escalation: node.escalate.clone().map(Box::new),
            inputs,
            conditions,
            ..spec
        })
    }

    /// Returns a role of a task, in its iteration of a spread loop.
    fn role(&mut self, role: &'a str, path: &str, scope: &Scope) -> Option<RoleId> {
        let id = self.name(path, RoleId::new(scope.own_role(role).unwrap_or(role)))?;
        if scope.own_role(role).is_some() {
            self.spread_roles.entry(role).or_default().insert(id.clone());
        }
        Some(id)
    }

    fn entries(
        &mut self,
        entries: BTreeMap<&'a String, &'a String>,
        path: &str,
        scope: &Scope,
    ) -> BTreeMap<String, String> {
        let mut filled = BTreeMap::new();
        for (name, text) in entries {
            filled.extend(self.substitute_or_report(text, scope, path).map(|value| (name.clone(), value)));
        }
        filled
    }

    fn substitute_or_report(&mut self, text: &'a str, scope: &Scope, path: &str) -> Option<String> {
        self.substitute(text, scope).map_err(|kind| self.report(path, kind)).ok()
    }

    fn substitute(&mut self, text: &'a str, scope: &Scope) -> Result<String, MissionErrorKind> {
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
            match scope.values.get(name) {
                Some(value) => filled.push_str(value),
                None if name.split_once('.').is_some_and(|(task, _)| task != LOST) => {
                    return Err(error("a result of a task can only be the whole value"));
                }
                None => filled.push_str(self.value(name, scope)?),
            }
            rest = after;
        }
        filled.push_str(rest);
        Ok(filled)
    }

    /// Returns the value of a parameter of the mission.
    fn value(&mut self, name: &str, scope: &Scope) -> Result<&'a str, MissionErrorKind> {
        let Some((name, value)) = self.values.get_key_value(name) else {
            let known = self.values.keys().copied().chain(scope.values.keys().map(String::as_str));
            let allowed = AllowedNames::suggest_for(name, known.collect::<BTreeSet<_>>());
            return Err(MissionErrorKind::UnknownReference { name: name.to_owned(), allowed });
        };
        self.used.insert(name);
        Ok(value)
    }

    /// Returns an expression with the values of parameters. `None` if a problem was reported.
    fn expression(&mut self, text: &str, scope: &Scope, path: &str) -> Option<String> {
        let literal = |name: &str| match scope.values.get(name) {
            Some(value) => Ok(text_literal(value)),
            None => {
                let kind = self.kinds.get(name).copied().unwrap_or(TemplateKind::Text);
                self.value(name, scope).map(|value| kind.literal(value))
            }
        };
        let unclosed =
            || MissionErrorKind::Substitution { text: text.to_owned(), problem: "a `${` is not closed".to_owned() };
        scope.expression(text, literal, unclosed).map_err(|kind| self.report(path, kind)).ok()
    }
}

/// Task of a file that is not built yet.
struct OpenTask<'a> {
    node: &'a TaskFile,
    parent: Option<usize>,
    path: String,
    scope: Scope,
}

/// Returns the result that a text refers to, if it is `${task.result}`.
fn reference(text: &str, scope: &Scope) -> Option<ResultReference> {
    let name = text.strip_prefix("${")?.strip_suffix('}')?;
    let (task, result) = name.split_once('.').filter(|(task, _)| *task != LOST)?;
    Some(ResultReference { task: scope.task_id(task)?, result: result.to_owned() })
}
