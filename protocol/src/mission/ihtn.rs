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
//!   several), and is the reached state of `navigation`.
//! - A parameter of kind role takes the agent of the action's method that is not the action's own,
//!   if there is exactly 1 such agent: in a method of `r1` and `lab_arm`, `r1` approaches
//!   `lab_arm`.

use super::diagnostic::{AllowedNames, MissionDiagnostic, MissionErrorKind, MissionErrors};
use super::domain::{Domain, TaskSchema, ValueKind};
use super::file::{FILE_BYTES_MAX, unique_keys};
use super::model::{Method, Mission, Role, RoleKind, TaskBody, TaskIndex, TaskNode, TaskOrder, TaskSpec};
use super::validate::TASKS_MAX;
use crate::ids::{RoleId, TaskId, TaskType};
use serde::Deserialize;
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
}

/// Problem of a node of a flat iHTN. The path of the diagnostic names the node
/// (`node 12 (deposit)`).
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum IhtnError {
    /// The text is larger than any mission needs.
    #[error("the file has {bytes} bytes; at most {FILE_BYTES_MAX} are allowed")]
    TooLarge {
        /// Size of the file.
        bytes: usize,
    },
    /// The text is not JSON, or has wrong fields.
    #[error("not a flat iHTN: {message}")]
    Syntax {
        /// Message of the parser, with line and column.
        message: String,
    },
    /// No node has the parent `-1`.
    #[error("there is no root; the root has the parent \"-1\"")]
    NoRoot,
    /// Several nodes have the parent `-1`.
    #[error("several nodes have the parent \"-1\": {nodes}; exactly 1 node must be the root")]
    SeveralRoots {
        /// Ids of these nodes.
        nodes: String,
    },
    /// The root is not a task.
    #[error("the root is of type {found}; it must be a task")]
    RootNotTask {
        /// Type of the root.
        found: &'static str,
    },
    /// A parent does not exist.
    #[error("its parent {parent:?} does not exist")]
    NoSuchParent {
        /// Id of the parent.
        parent: String,
    },
    /// A parent does not list the node.
    #[error("its parent {parent:?} does not have it among its children")]
    NotAmongChildren {
        /// Id of the parent.
        parent: String,
    },
    /// A child does not exist.
    #[error("its child {child:?} does not exist")]
    NoSuchChild {
        /// Id of the child.
        child: String,
    },
    /// A child names another parent.
    #[error("its child {child:?} names the parent {parent:?}")]
    WrongParent {
        /// Id of the child.
        child: String,
        /// Parent that the child names.
        parent: String,
    },
    /// A child is listed twice.
    #[error("lists the child {child:?} twice")]
    ChildTwice {
        /// Id of the child.
        child: String,
    },
    /// A node is its own ancestor.
    #[error("is its own ancestor: {cycle}")]
    Cycle {
        /// Ids along the cycle; the first and the last are equal.
        cycle: String,
    },
    /// A child has a type that is not allowed there.
    #[error("is of type {parent} and has {child:?} of type {found}; allowed: {takes}")]
    WrongType {
        /// Type of the node.
        parent: &'static str,
        /// Id of the child.
        child: String,
        /// Type of the child.
        found: &'static str,
        /// Allowed children, as text.
        takes: &'static str,
    },
    /// A task has no method or several.
    #[error("has {found} methods; in an instantiated network a task has exactly 1")]
    NotOneMethod {
        /// Number found.
        found: usize,
    },
    /// An agent is not listed at the parent.
    #[error("its agent `{agent}` is not among the agents of its parent")]
    AgentNotInParent {
        /// Agent.
        agent: String,
    },
    /// An action has several locations.
    #[error("has {found} locations; an action has at most 1")]
    SeveralLocations {
        /// Number found.
        found: usize,
    },
    /// The task type has no parameter for the location.
    #[error("has the location {location:?}, but `{task_type}` has no parameter for a place")]
    UnusedLocation {
        /// Location.
        location: String,
        /// Task type.
        task_type: String,
    },
    /// An agent of [`IhtnOptions::unmanaged`] has no action.
    #[error("is listed as unmanaged, but has no action in the file; {allowed}")]
    NoSuchAgent {
        /// Agents with actions.
        allowed: AllowedNames,
    },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum NodeType {
    Task,
    Method,
    Action,
}

impl NodeType {
    fn as_str(self) -> &'static str {
        match self {
            NodeType::Task => "task",
            NodeType::Method => "method",
            NodeType::Action => "action",
        }
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FlatNode {
    name: String,
    #[serde(rename = "type")]
    node_type: NodeType,
    parent: String,
    #[serde(default)]
    agents: ListOrEmpty,
    #[serde(default)]
    locations: ListOrEmpty,
    #[serde(default)]
    children: ListOrEmpty,
}

/// List, or a text that is `""` for an empty list and otherwise the only entry.
#[derive(Debug, Default, Deserialize)]
#[serde(from = "ListForm")]
struct ListOrEmpty(Vec<String>);

#[derive(Deserialize)]
#[serde(untagged, expecting = "a list of texts, or a text")]
enum ListForm {
    Text(String),
    List(Vec<String>),
}

impl From<ListForm> for ListOrEmpty {
    fn from(form: ListForm) -> Self {
        match form {
            ListForm::Text(text) if text.is_empty() => Self(vec![]),
            ListForm::Text(text) => Self(vec![text]),
            ListForm::List(list) => Self(list),
        }
    }
}

#[derive(Deserialize)]
#[serde(transparent)]
struct FlatFile(#[serde(deserialize_with = "unique_keys")] BTreeMap<String, FlatNode>);

const NO_PARENT: &str = "-1";

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
    let mut import = Import { nodes: &nodes, options, domain, problems: Vec::new() };
    let root = import.find_tree();
    MissionErrors::ok_if_empty(&options.name, std::mem::take(&mut import.problems))?;
    let mission = import.mission(root.expect("a valid tree has a root"));
    MissionErrors::ok_if_empty(&options.name, import.problems)?;
    mission.check(domain)?;
    Ok(mission)
}

struct Import<'a> {
    nodes: &'a BTreeMap<String, FlatNode>,
    options: &'a IhtnOptions,
    domain: &'a Domain,
    problems: Vec<MissionDiagnostic>,
}

impl<'a> Import<'a> {
    fn report(&mut self, id: &str, kind: impl Into<MissionErrorKind>) {
        let name = self.nodes.get(id).map_or("?", |node| &node.name);
        self.problems.push(MissionDiagnostic { path: format!("node {id} ({name})"), kind: kind.into() });
    }

    fn report_for_file(&mut self, kind: IhtnError) {
        self.problems.push(MissionDiagnostic { path: "file".to_owned(), kind: kind.into() });
    }

    /// Checks that the nodes form a tree of alternating types, and returns its root.
    fn find_tree(&mut self) -> Option<&'a str> {
        let nodes = self.nodes;
        let roots: Vec<&str> =
            nodes.iter().filter(|(_, node)| node.parent == NO_PARENT).map(|(id, _)| id.as_str()).collect();
        match roots[..] {
            [] => self.report_for_file(IhtnError::NoRoot),
            [root] if nodes[root].node_type != NodeType::Task => {
                self.report(root, IhtnError::RootNotTask { found: nodes[root].node_type.as_str() });
            }
            [_] => {}
            _ => self.report_for_file(IhtnError::SeveralRoots { nodes: roots.join(", ") }),
        }
        for (id, node) in nodes {
            self.check_parent(id, node);
            self.check_children(id, node);
        }
        self.find_cycles();
        roots.first().copied()
    }

    fn check_parent(&mut self, id: &str, node: &FlatNode) {
        if node.parent == NO_PARENT {
            return;
        }
        let Some(parent) = self.nodes.get(&node.parent) else {
            return self.report(id, IhtnError::NoSuchParent { parent: node.parent.clone() });
        };
        if !parent.children.0.iter().any(|child| child == id) {
            self.report(id, IhtnError::NotAmongChildren { parent: node.parent.clone() });
        }
        for agent in node.agents.0.iter().filter(|agent| !parent.agents.0.contains(agent)) {
            self.report(id, IhtnError::AgentNotInParent { agent: agent.clone() });
        }
    }

    fn check_children(&mut self, id: &str, node: &FlatNode) {
        let takes = match node.node_type {
            NodeType::Task => "1 method",
            NodeType::Method => "tasks and actions",
            NodeType::Action => "no children",
        };
        let mut seen = BTreeSet::new();
        for name in &node.children.0 {
            let Some(child) = self.nodes.get(name) else {
                self.report(id, IhtnError::NoSuchChild { child: name.clone() });
                continue;
            };
            if !seen.insert(name) {
                self.report(id, IhtnError::ChildTwice { child: name.clone() });
            } else if child.parent != id {
                self.report(id, IhtnError::WrongParent { child: name.clone(), parent: child.parent.clone() });
            }
            let fits = match node.node_type {
                NodeType::Task => child.node_type == NodeType::Method,
                NodeType::Method => child.node_type != NodeType::Method,
                NodeType::Action => false,
            };
            if !fits {
                let (parent, found) = (node.node_type.as_str(), child.node_type.as_str());
                self.report(id, IhtnError::WrongType { parent, child: name.clone(), found, takes });
            }
        }
        match node.node_type {
            NodeType::Task if node.children.0.len() != 1 => {
                self.report(id, IhtnError::NotOneMethod { found: node.children.0.len() });
            }
            NodeType::Method if node.children.0.is_empty() => self.report(id, MissionErrorKind::EmptyMethod),
            NodeType::Task | NodeType::Method | NodeType::Action => {}
        }
    }

    /// Follows the parents of each node: in a tree every path ends at the root, otherwise a path
    /// reaches its start again.
    fn find_cycles(&mut self) {
        let mut rooted: BTreeSet<&str> = BTreeSet::new();
        let nodes = self.nodes;
        for start in nodes.keys() {
            let mut trail: Vec<&str> = Vec::new();
            let mut at = start.as_str();
            while let Some(node) = nodes.get(at) {
                if rooted.contains(at) {
                    break;
                }
                if let Some(first) = trail.iter().position(|id| *id == at) {
                    let mut cycle = trail[first..].to_vec();
                    cycle.push(at);
                    cycle.reverse();
                    self.report(at, IhtnError::Cycle { cycle: cycle.join(" > ") });
                    break;
                }
                trail.push(at);
                at = &node.parent;
            }
            rooted.extend(trail);
        }
    }

    /// Builds the mission of a valid tree.
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
        self.place(id, node, &task_type, schema, &mut parameters, &mut reaches);
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
                ValueKind::Place | ValueKind::Role | ValueKind::Seconds | ValueKind::Text => false,
            });
            match (choices.next(), choices.next()) {
                (Some((parameter, _)), None) => Some((task_type, [(parameter.clone(), suffix.to_owned())].into())),
                _ => None,
            }
        })
    }

    fn place(
        &mut self,
        id: &str,
        node: &FlatNode,
        task_type: &TaskType,
        schema: &TaskSchema,
        parameters: &mut BTreeMap<String, String>,
        reaches: &mut BTreeMap<String, String>,
    ) {
        let location = match &node.locations.0[..] {
            [] => return,
            [location] => location,
            several => return self.report(id, IhtnError::SeveralLocations { found: several.len() }),
        };
        let places = || schema.parameters.iter().filter(|(_, parameter)| parameter.kind == ValueKind::Place);
        match places().find(|(_, parameter)| parameter.required).or_else(|| places().next()) {
            Some((name, _)) => drop(parameters.insert(name.clone(), location.clone())),
            None => {
                let (location, task_type) = (location.clone(), task_type.to_string());
                return self.report(id, IhtnError::UnusedLocation { location, task_type });
            }
        }
        if task_type.as_str() == "navigation" {
            reaches.insert("location".to_owned(), location.clone());
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

#[cfg(test)]
mod tests {
    use super::*;

    fn options() -> IhtnOptions {
        IhtnOptions {
            name: TaskId::new("trial").unwrap(),
            unmanaged: [RoleId::new("ann").unwrap()].into(),
            aliases: [("navto".to_owned(), TaskType::new("navigation").unwrap())].into(),
        }
    }

    /// A fetch by r1, to which Ann adds an item.
    fn nodes() -> serde_json::Value {
        serde_json::json!({
            "0": { "name": "Fetch", "type": "task", "parent": "-1", "agents": ["r1", "ann", "idler"], "children": ["1"] },
            "1": { "name": "m", "type": "method", "parent": "0", "agents": ["r1", "ann"], "children": ["2", "3", "4", "5"] },
            "2": { "name": "navto", "type": "action", "parent": "1", "locations": ["Ward"], "agents": ["r1"], "children": "" },
            "3": { "name": "operate_drawer-open", "type": "action", "parent": "1", "locations": "", "agents": ["r1"], "children": "" },
            "4": { "name": "deposit", "type": "action", "parent": "1", "locations": "", "agents": ["ann"], "children": "" },
            "5": { "name": "navto", "type": "action", "parent": "1", "locations": ["Laboratory"], "agents": ["r1"], "children": "" },
        })
    }

    fn import(nodes: &serde_json::Value) -> Result<Mission, Vec<String>> {
        import_ihtn(&nodes.to_string(), &options(), &Domain::hospital())
            .map_err(|errors| errors.diagnostics.iter().map(ToString::to_string).collect())
    }

    #[test]
    fn gaps_of_the_form_are_filled_by_rules() {
        let mission = import(&nodes()).unwrap();
        let tasks: Vec<String> = mission
            .elementary()
            .iter()
            .map(|(id, spec)| format!("{id} {} {:?} {:?}", spec.task_type, spec.parameters, spec.reaches))
            .collect();
        assert_eq!(
            tasks,
            [
                r#"navto navigation {"to": "Ward"} {"location": "Ward"}"#,
                r#"operate_drawer-open operate_drawer {"action": "open"} {}"#,
                r#"deposit deposit {"into_role": "r1"} {}"#,
                r#"navto-2 navigation {"to": "Laboratory"} {"location": "Laboratory"}"#,
            ]
        );
        let roles: Vec<(&str, RoleKind)> = mission.roles.iter().map(|(id, role)| (id.as_str(), role.kind)).collect();
        assert_eq!(roles, [("ann", RoleKind::Unmanaged), ("r1", RoleKind::Managed)]);
        assert_eq!(mission.tasks[0].id.as_str(), "Fetch");
    }

    #[test]
    fn a_malformed_tree_is_reported_precisely() {
        type Change<'c> = &'c dyn Fn(&mut serde_json::Value);
        let cases: [(Change<'_>, &[&str]); 9] = [
            (
                &|n| n["1"]["children"] = ["2", "3", "4", "5", "9"].into(),
                &["node 1 (m): its child \"9\" does not exist"],
            ),
            (
                &|n| n["1"]["children"] = ["2", "3", "4"].into(),
                &["node 5 (navto): its parent \"1\" does not have it among its children"],
            ),
            (
                &|n| n["5"]["parent"] = "0".into(),
                &[
                    "node 1 (m): its child \"5\" names the parent \"0\"",
                    "node 5 (navto): its parent \"0\" does not have it among its children",
                ],
            ),
            (
                &|n| n["5"]["parent"] = "-1".into(),
                &[
                    "file: several nodes have the parent \"-1\": 0, 5; exactly 1 node must be the root",
                    "node 1 (m): its child \"5\" names the parent \"-1\"",
                ],
            ),
            (
                &|n| {
                    n["0"]["parent"] = "1".into();
                    n["0"]["agents"] = ["r1", "ann"].into();
                    n["1"]["children"] = ["0", "2", "3", "4", "5"].into();
                },
                &[
                    "file: there is no root; the root has the parent \"-1\"",
                    "node 0 (Fetch): is its own ancestor: 0 > 1 > 0",
                ],
            ),
            (
                &|n| n["0"]["children"] = "".into(),
                &[
                    "node 0 (Fetch): has 0 methods; in an instantiated network a task has exactly 1",
                    "node 1 (m): its parent \"0\" does not have it among its children",
                ],
            ),
            (
                &|n| n["3"]["name"] = "operate_drawer-slam".into(),
                &["node 3 (operate_drawer-slam): unknown task type `operate_drawer-slam`; allowed: approach_person, \
                   approach_robot, authenticate_person, carry, deposit, disinfect, dock, follow_path, grasp, navigation, \
                   operate_door, operate_drawer, pick_up, undock, wait; did you mean `operate_drawer`?"],
            ),
            (
                &|n| n["3"]["locations"] = "Ward".into(),
                &[
                    "node 3 (operate_drawer-open): has the location \"Ward\", but `operate_drawer` has no parameter for \
                   a place",
                ],
            ),
            (
                &|n| n["4"]["agents"] = ["bob"].into(),
                &["node 4 (deposit): its agent `bob` is not among the agents of its parent"],
            ),
        ];
        for (change, expected) in cases {
            let mut nodes = nodes();
            change(&mut nodes);
            assert_eq!(import(&nodes).unwrap_err(), expected);
        }
    }

    #[test]
    fn a_repeated_node_is_rejected() {
        let text = nodes().to_string().replacen("\"1\":", "\"0\":", 1);
        let error = import_ihtn(&text, &options(), &Domain::hospital()).unwrap_err().to_string();
        assert!(error.contains("the key `0` occurs twice"), "{error}");
    }

    #[test]
    fn only_agents_with_actions_may_be_unmanaged() {
        let mut options = options();
        options.unmanaged = [RoleId::new("an").unwrap()].into();
        let error = import_ihtn(&nodes().to_string(), &options, &Domain::hospital()).unwrap_err().to_string();
        assert!(error.contains("roles/an: is listed as unmanaged") && error.contains("did you mean `ann`?"), "{error}");
    }
}
