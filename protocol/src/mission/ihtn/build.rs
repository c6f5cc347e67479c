//! Mission of a valid tree of a flat iHTN.

use super::IhtnOptions;
use super::form::{FlatNode, NodeType, diagnostic};
use crate::ids::{RoleId, TaskId, TaskType};
use crate::mission::diagnostic::{IhtnError, MissionDiagnostic, MissionErrorKind};
use crate::mission::domain::{Domain, TaskSchema, ValueKind};
use crate::mission::limits::ROLES_MAX;
use crate::mission::model::{Method, Mission, Role, RoleKind, TaskBody, TaskIndex, TaskNode, TaskOrder, TaskSpec};
use crate::mission::validate::check_task;
use consort_text::AllowedNames;
use std::collections::{BTreeMap, BTreeSet};

/// Builds the mission of a valid tree with this root.
///
/// # Errors
/// All problems of names, agents, task types and locations.
pub(super) fn build_mission(
    nodes: &BTreeMap<String, FlatNode>,
    root: &str,
    options: &IhtnOptions,
    domain: &Domain,
) -> Result<Mission, Vec<MissionDiagnostic>> {
    let mut builder = Builder::new(nodes, options, domain);
    let mission = builder.build(root);
    match builder.problems.is_empty() {
        true => Ok(mission),
        false => Err(builder.problems),
    }
}

/// Builder of a mission. It reports problems and continues.
pub(super) struct Builder<'a> {
    nodes: &'a BTreeMap<String, FlatNode>,
    options: &'a IhtnOptions,
    domain: &'a Domain,
    people: BTreeSet<RoleId>,
    problems: Vec<MissionDiagnostic>,
    /// Ids of the nodes of the tasks, in the order of [`Mission::tasks`].
    pub(super) order: Vec<&'a str>,
    /// Names of actions that the domain has no fitting task type for.
    pub(super) unfit: BTreeSet<&'a str>,
}

impl<'a> Builder<'a> {
    pub(super) fn new(nodes: &'a BTreeMap<String, FlatNode>, options: &'a IhtnOptions, domain: &'a Domain) -> Self {
        let people = options.all_people(domain);
        Self { nodes, options, domain, people, problems: Vec::new(), order: Vec::new(), unfit: BTreeSet::new() }
    }

    fn report(&mut self, id: &str, kind: impl Into<MissionErrorKind>) {
        self.problems.push(diagnostic(self.nodes, id, kind));
    }

    /// Reports that the task type of an action does not fit.
    fn report_unfit(&mut self, id: &str, node: &'a FlatNode, kind: impl Into<MissionErrorKind>) {
        self.unfit.insert(&node.name);
        self.report(id, kind);
    }

    /// Builds the mission. It is valid only if there are no problems.
    pub(super) fn build(&mut self, root: &'a str) -> Mission {
        let mut tasks: Vec<TaskNode> = Vec::new();
        let mut roles: BTreeMap<RoleId, Role> = BTreeMap::new();
        let mut names = Names::of(self.nodes);
        let mut open: Vec<(&'a str, Option<usize>)> = vec![(root, None)];
        while let Some((id, parent)) = open.pop() {
            let node = &self.nodes[id];
            let index = tasks.len();
            if let Some(TaskBody::Abstract(method)) = parent.map(|parent| &mut tasks[parent].body) {
                method.children.push(index as TaskIndex);
            }
            let body = if node.node_type == NodeType::Action {
                self.action(id, node, &mut roles)
            } else {
                let below = &self.nodes[&node.children.0[0]].children.0;
                open.extend(below.iter().rev().map(|child| (child.as_str(), Some(index))));
                TaskBody::Abstract(Method::of(TaskOrder::Sequential, vec![]))
            };
            self.order.push(id);
            match TaskId::new(names.next(&node.name)) {
                Ok(id) => tasks.push(TaskNode { id, body }),
                Err(error) => {
                    self.report(id, error);
                    let id = TaskId::new(format!("unnamed-{index}")).expect("consists of characters allowed in a slug");
                    tasks.push(TaskNode { id, body });
                }
            }
        }
        let mut mission = Mission {
            name: self.options.name.clone(),
            roles,
            ensembles: vec![],
            energy_max: None,
            tasks,
            results: BTreeMap::new(),
        };
        mission.set_domains(self.domain);
        self.check_people(&mission);
        self.check_parameters(&mission);
        mission
    }

    fn check_people(&mut self, mission: &Mission) {
        if self.options.people.len() > ROLES_MAX {
            let kind = MissionErrorKind::TooManyRoles { found: self.options.people.len(), max: ROLES_MAX };
            return self.problems.push(MissionDiagnostic { path: "people".to_owned(), kind });
        }
        for agent in self.options.people.iter().filter(|agent| !mission.roles.contains_key(*agent)) {
            let allowed = AllowedNames::suggest_for(agent.as_str(), mission.roles.keys());
            let kind = IhtnError::NoSuchAgent { allowed }.into();
            self.problems.push(MissionDiagnostic { path: format!("people/{agent}"), kind });
        }
    }

    /// Checks the parameters of the tasks here, where the problem can name the node of the file.
    fn check_parameters(&mut self, mission: &Mission) {
        for (index, task) in mission.tasks.iter().enumerate() {
            let TaskBody::Elementary(spec) = &task.body else { continue };
            let id = self.order[index];
            for kind in check_task(mission, spec, self.domain) {
                self.report_unfit(id, &self.nodes[id], kind);
            }
        }
    }

    fn action(&mut self, id: &'a str, node: &'a FlatNode, roles: &mut BTreeMap<RoleId, Role>) -> TaskBody {
        let (objects, agents): (Vec<&String>, Vec<&String>) =
            node.agents.0.iter().partition(|agent| self.is_object(agent));
        if agents.is_empty() {
            self.report(id, IhtnError::NoAgent);
        }
        let mut own = Vec::new();
        for agent in agents {
            match RoleId::new(agent.as_str()) {
                Ok(role) => {
                    let kind = if self.people.contains(&role) { RoleKind::Unmanaged } else { RoleKind::Managed };
                    roles.insert(role.clone(), Role::of(kind));
                    own.push(role);
                }
                Err(error) => self.report(id, error),
            }
        }
        let (task_type, mut parameters) = match self.type_of(&node.name) {
            Some(found) => found,
            None => {
                let allowed = AllowedNames::suggest_for(&node.name, self.domain.task_types());
                self.report_unfit(id, node, MissionErrorKind::UnknownType { task_type: node.name.clone(), allowed });
                return TaskBody::Abstract(Method::of(TaskOrder::Sequential, vec![]));
            }
        };
        let mut reaches = BTreeMap::new();
        let schema = self.domain.get(&task_type).expect("types are taken from the domain");
        if let Some((name, place)) = self.location(id, node, &task_type, schema) {
            if self.domain.ihtn_names().reaching.contains(&task_type) {
                reaches.insert("location".to_owned(), place.clone());
            }
            parameters.insert(name, place);
        }
        if let several @ [_, _, ..] = &node.locations.0[..] {
            let places: Vec<String> = several.iter().map(|location| self.place(location)).collect();
            let given = Numbered { kind: NumberedKind::Location, values: &places, schema };
            self.numbered(id, node, &given, &mut parameters);
        }
        let objects: Vec<String> = objects.into_iter().cloned().collect();
        let given = Numbered { kind: NumberedKind::Object, values: &objects, schema };
        self.numbered(id, node, &given, &mut parameters);
        let around = self.nodes.get(&node.parent).map_or(&[][..], |method| &method.agents.0);
        let mut others = around.iter().filter(|agent| !node.agents.0.contains(agent) && !self.is_object(agent));
        if let (Some(other), None) = (others.next(), others.next()) {
            let of_roles = schema.parameters.iter().filter(|(_, parameter)| parameter.kind == ValueKind::Role);
            for (name, _) in of_roles {
                parameters.entry(name.clone()).or_insert_with(|| other.clone());
            }
        }
        TaskBody::Elementary(TaskSpec { parameters, reaches, ..TaskSpec::of(task_type, own) })
    }

    /// Returns the task type of an action's name, and the parameter given by its suffix.
    fn type_of(&self, name: &str) -> Option<(TaskType, BTreeMap<String, String>)> {
        let known = |name: &str| match self.domain.ihtn_names().actions.get(name) {
            Some(alias) => Some(alias.clone()).filter(|alias| self.domain.get(alias).is_some()),
            None => TaskType::new(name).ok().filter(|own| self.domain.get(own).is_some()),
        };
        if let Some(task_type) = known(name) {
            return Some((task_type, BTreeMap::new()));
        }
        name.match_indices('-').find_map(|(dash, _)| {
            let (task_type, suffix) = (known(&name[..dash])?, &name[dash + 1..]);
            let schema = self.domain.get(&task_type)?;
            let mut choices = schema.parameters.iter().filter(|(_, parameter)| match &parameter.kind {
                ValueKind::OneOf(words) => words.contains(suffix),
                ValueKind::Place
                | ValueKind::Role
                | ValueKind::Seconds
                | ValueKind::Number(_)
                | ValueKind::Integer(_)
                | ValueKind::Bool
                | ValueKind::Text => false,
            });
            match (choices.next(), choices.next()) {
                (Some((parameter, _)), None) => Some((task_type, [(parameter.clone(), suffix.to_owned())].into())),
                _ => None,
            }
        })
    }

    fn is_object(&self, agent: &str) -> bool {
        self.domain.ihtn_names().objects.contains(agent)
    }

    /// Returns the place that a location stands for.
    fn place(&self, location: &str) -> String {
        self.domain.ihtn_names().places.get(location).map_or_else(|| location.to_owned(), ToString::to_string)
    }

    /// Returns the parameter of the location, if the action has a single location.
    fn location(
        &mut self,
        id: &str,
        node: &'a FlatNode,
        task_type: &TaskType,
        schema: &TaskSchema,
    ) -> Option<(String, String)> {
        let [location] = &node.locations.0[..] else { return None };
        let places = || schema.parameters.iter().filter(|(_, parameter)| parameter.kind == ValueKind::Place);
        match places().find(|(_, parameter)| parameter.required).or_else(|| places().next()) {
            Some((name, _)) => Some((name.clone(), self.place(location))),
            None => {
                let (location, task_type) = (location.clone(), task_type.to_string());
                self.report_unfit(id, node, IhtnError::UnusedLocation { location, task_type });
                None
            }
        }
    }

    /// Adds the parameters of several locations, or of objects. The form has no names for them, so
    /// their order decides, and the parameters are numbered.
    fn numbered(
        &mut self,
        id: &str,
        node: &'a FlatNode,
        given: &Numbered<'_>,
        parameters: &mut BTreeMap<String, String>,
    ) {
        for (number, value) in (1..).zip(given.values) {
            let name = given.kind.parameter(number, given.values.len());
            if given.schema.parameters.get(&name).is_some_and(|parameter| parameter.kind == given.kind.value_kind()) {
                parameters.insert(name, value.clone());
                continue;
            }
            let of_kind = given.schema.parameters.iter().filter(|(_, own)| own.kind == given.kind.value_kind());
            let allowed = AllowedNames::suggest_for(&name, of_kind.map(|(name, _)| name));
            let (kind, value) = (given.kind.as_str(), value.clone());
            self.report_unfit(id, node, IhtnError::Unnumbered { value, name, kind, allowed });
        }
    }
}

/// Values of an action that become numbered parameters.
struct Numbered<'a> {
    kind: NumberedKind,
    values: &'a [String],
    schema: &'a TaskSchema,
}

/// Kind of numbered parameters.
#[derive(Clone, Copy, PartialEq, Eq)]
enum NumberedKind {
    Location,
    Object,
}

impl NumberedKind {
    fn parameter(self, number: usize, count: usize) -> String {
        match self {
            NumberedKind::Object if count == 1 => OBJECT.to_owned(),
            NumberedKind::Object => format!("{OBJECT}_{number}"),
            NumberedKind::Location => format!("{LOCATION}_{number}"),
        }
    }

    fn as_str(self) -> &'static str {
        match self {
            NumberedKind::Object => "text",
            NumberedKind::Location => "place",
        }
    }

    fn value_kind(self) -> ValueKind {
        match self {
            NumberedKind::Object => ValueKind::Text,
            NumberedKind::Location => ValueKind::Place,
        }
    }
}

/// Name of the parameter for an object. Several objects have the names `object_1`, `object_2`, ….
pub(super) const OBJECT: &str = "object";
/// Start of the names of the parameters for several locations: `location_1`, `location_2`, ….
pub(super) const LOCATION: &str = "location";

/// Assigns unique names. A numbered name never equals the own name of another node.
struct Names<'a> {
    own: BTreeSet<&'a str>,
    assigned: BTreeMap<&'a str, u32>,
}

impl<'a> Names<'a> {
    fn of(nodes: &'a BTreeMap<String, FlatNode>) -> Self {
        Self { own: nodes.values().map(|node| node.name.as_str()).collect(), assigned: BTreeMap::new() }
    }

    fn next(&mut self, name: &'a str) -> String {
        let number = self.assigned.entry(name).or_insert(0);
        loop {
            *number += 1;
            if *number == 1 {
                return name.to_owned();
            }
            let numbered = format!("{name}-{number}");
            if !self.own.contains(numbered.as_str()) {
                return numbered;
            }
        }
    }
}
