//! Mission of a valid tree of a flat iHTN.

use super::IhtnOptions;
use super::form::{FlatNode, NodeType, diagnostic};
use crate::ids::{RoleId, TaskId, TaskType};
use crate::mission::diagnostic::{IhtnError, MissionDiagnostic, MissionErrorKind};
use crate::mission::domain::{Domain, TaskSchema, ValueKind};
use crate::mission::model::{Method, Mission, Role, RoleKind, TaskBody, TaskIndex, TaskNode, TaskOrder, TaskSpec};
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
    let mut builder = Builder { nodes, options, domain, problems: Vec::new() };
    let mission = builder.mission(root);
    match builder.problems.is_empty() {
        true => Ok(mission),
        false => Err(builder.problems),
    }
}

struct Builder<'a> {
    nodes: &'a BTreeMap<String, FlatNode>,
    options: &'a IhtnOptions,
    domain: &'a Domain,
    problems: Vec<MissionDiagnostic>,
}

impl<'a> Builder<'a> {
    fn report(&mut self, id: &str, kind: impl Into<MissionErrorKind>) {
        self.problems.push(diagnostic(self.nodes, id, kind));
    }

    fn mission(&mut self, root: &'a str) -> Mission {
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
            match TaskId::new(names.next(&node.name)) {
                Ok(id) => tasks.push(TaskNode { id, body }),
                Err(error) => {
                    self.report(id, error);
                    let id = TaskId::new(format!("unnamed-{index}")).expect("consists of characters allowed in a slug");
                    tasks.push(TaskNode { id, body });
                }
            }
        }
        for agent in self.options.unmanaged.iter().filter(|agent| !roles.contains_key(*agent)) {
            let allowed = AllowedNames::suggest_for(agent.as_str(), roles.keys());
            let kind = IhtnError::NoSuchAgent { allowed }.into();
            self.problems.push(MissionDiagnostic { path: format!("roles/{agent}"), kind });
        }
        Mission { name: self.options.name.clone(), roles, tasks }
    }

    fn action(&mut self, id: &str, node: &FlatNode, roles: &mut BTreeMap<RoleId, Role>) -> TaskBody {
        let mut own = Vec::new();
        for agent in &node.agents.0 {
            match RoleId::new(&**agent) {
                Ok(role) => {
                    let unmanaged = self.options.unmanaged.contains(&role);
                    let kind = if unmanaged { RoleKind::Unmanaged } else { RoleKind::Managed };
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
                self.report(id, MissionErrorKind::UnknownType { task_type: node.name.clone(), allowed });
                return TaskBody::Abstract(Method::of(TaskOrder::Sequential, vec![]));
            }
        };
        let mut reaches = BTreeMap::new();
        let schema = self.domain.get(&task_type).expect("types are taken from the domain");
        if let Some((name, location)) = self.place(id, node, &task_type, schema) {
            if self.options.reaching.contains(&task_type) {
                reaches.insert("location".to_owned(), location.clone());
            }
            parameters.insert(name, location);
        }
        let around = self.nodes.get(&node.parent).map_or(&[][..], |method| &method.agents.0);
        let mut others = around.iter().filter(|agent| !node.agents.0.contains(agent));
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
        let known = |name: &str| match self.options.aliases.get(name) {
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

    /// Returns the parameter of the location, if the action has a location.
    fn place(
        &mut self,
        id: &str,
        node: &FlatNode,
        task_type: &TaskType,
        schema: &TaskSchema,
    ) -> Option<(String, String)> {
        let location = match &node.locations.0[..] {
            [] => return None,
            [location] => location.clone(),
            several => {
                self.report(id, IhtnError::SeveralLocations { found: several.len() });
                return None;
            }
        };
        let places = || schema.parameters.iter().filter(|(_, parameter)| parameter.kind == ValueKind::Place);
        match places().find(|(_, parameter)| parameter.required).or_else(|| places().next()) {
            Some((name, _)) => Some((name.clone(), location)),
            None => {
                self.report(id, IhtnError::UnusedLocation { location, task_type: task_type.to_string() });
                None
            }
        }
    }
}

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
