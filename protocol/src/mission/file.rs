//! Mission files: a mission with its parameters left open, as people write it, in YAML or JSON.
//!
//! ```yaml
//! mission: inspect-room              # the name of the kind of mission: a slug
//! title: Look after one room         # for people; optional
//! parameters:                        # what a request fills in; optional
//!   room: { kind: place, default: IC Room 6, description: which room }
//! roles:                             # who takes part; at least one is managed
//!   r1: { kind: managed }
//!   nurse: { kind: unmanaged, description: on duty in the room }
//! root:                              # an abstract task: `task`, `method`, `tasks`
//!   task: inspect
//!   method: sequential               # or `unordered`
//!   tasks:
//!     # an elementary task: `task`, `type`, `roles`, and where needed `parameters` and `reaches`
//!     - { task: navto_room, type: navigation, roles: [r1], parameters: { to: "${room}" }, reaches: { location: "${room}" } }
//!     - { task: meet, type: wait, roles: [r1, nurse], parameters: { seconds: "5" } }   # two roles: a joint task
//! ```
//!
//! An elementary task may say more:
//!
//! - `acquires: { sample: r1 }`: once it has ended, `r1` has the sample; `releases: [sample]`: nobody of the mission has.
//!   Tasks that touch one item must be in a definite order. The ledger knows from this what a lost robot carries.
//! - `attempts: 3`: how often its skill is tried before the task has failed; 1 to 10, 2 if nothing is said.
//! - where it takes a person (`approach_person`, `authenticate_person`, `deposit`), `parameters: { patience: "300" }`: how many
//!   seconds it waits, at each attempt, for one who has left; 120 if nothing is said.
//!
//! A role may say `on_loss: restart`: if its holder is lost after others have acted on its work, and has no item in its
//! hands, another begins it from the beginning. Without it such a mission fails.
//!
//! Beside `root` a file may have a `recovery`, of the same shape: what is done instead if a robot is lost that has, or may
//! have, an item. Its roles are declared with the others, and robots are sought anew for all that take part in it. Its
//! tasks have names of their own. In its `parameters` and `reaches`, `${lost.item}`, `${lost.robot}` and `${lost.place}`
//! stand for what was lost, who had it, and where that robot was last known to be. A robot that is lost in turn, with nothing in
//! its hands, is replaced; with an item, or if the branch cannot be carried out, the mission needs a person.
//!
//! An abstract task may have `alternatives`: other methods, each `{ method: sequential, tasks: [ elementary tasks ] }`,
//! tried in the order of the file when a task of its own method has failed for good. They are *local*: all tasks of the
//! method and of its alternatives are done by one managed role alone, and none touches an item.
//!
//! A parameter's `kind` is `place`, `seconds` or `text`; without a `default` a request must give it. `${name}` stands
//! for its value, within the values of `parameters` and `reaches` only; `$$` stands for a dollar sign. What was put
//! in is never searched again, so a value cannot smuggle in another.
//!
//! Files may come from anyone. Text is limited in size before it is read and in depth while it is read; YAML anchors,
//! aliases, merge keys and further documents are refused, as no mission needs them and a few of them make
//! gigabytes.

use super::domain::{Domain, ValueKind};
use super::lost::{self, Lost};
use super::model::{
    ATTEMPTS, ATTEMPTS_MAX, Body, Method, Mission, OnLoss, Order, OtherMethod, Role, RoleKind, TaskIndex, TaskNode,
    TaskSpec,
};
use super::problem::{Allowed, Fault, MissionErrors, Problem};
use super::validate::TASKS_MAX;
use crate::ids::{ItemId, NameError, RoleId, TaskId, TaskType};
use schemars::{JsonSchema, Schema, schema_for};
use serde::de::{Deserializer, Error as _, MapAccess, Unexpected, Visitor};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::marker::PhantomData;
use std::path::Path;

/// Largest mission file, in bytes. Five hundred tasks with generous comments take a third of it.
pub const FILE_BYTES_MAX: usize = 256 * 1024;

/// How a mission file is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// JSON, as clients send it.
    Json,
    /// YAML, as people write it.
    Yaml,
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Format::Json => "JSON",
            Format::Yaml => "YAML",
        })
    }
}

impl Format {
    /// By the file's extension where it has one that says; else JSON if the text begins with a brace.
    pub fn of(path: Option<&Path>, text: &str) -> Self {
        match path.and_then(Path::extension).and_then(|extension| extension.to_str()) {
            Some("json") => Format::Json,
            Some("yaml" | "yml") => Format::Yaml,
            _ if text.trim_start_matches('\u{feff}').trim_start().starts_with('{') => Format::Json,
            _ => Format::Yaml,
        }
    }
}

/// Why a text is no mission file. Ordinary for files written by hand; nothing was taken over.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FileError {
    /// More text than any mission needs; none of it was read.
    #[error("the mission file has {bytes} bytes; at most {FILE_BYTES_MAX} are allowed")]
    TooLarge {
        /// Its size.
        bytes: usize,
    },
    /// Not the format, or not the fields.
    #[error("not a mission file in {format}: {message}")]
    Syntax {
        /// How it was read.
        format: Format,
        /// What the reader says, with line and column.
        message: String,
    },
    /// The mission's own name is none.
    #[error(transparent)]
    Name(#[from] NameError),
}

/// A mission file that was read: a mission for every choice of its parameters.
#[derive(Debug, Clone)]
pub struct MissionTemplate {
    name: TaskId,
    file: MissionFile,
}

/// What a request fills in.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TemplateParameter {
    /// What it is.
    pub kind: TemplateKind,
    /// Its value where a request gives none.
    #[serde(default)]
    pub default: Option<String>,
    /// What it means, for people.
    #[serde(default)]
    pub description: String,
}

/// What a mission's parameter is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum TemplateKind {
    /// A place on the map.
    Place,
    /// A time span in seconds.
    Seconds,
    /// Any text.
    Text,
}

impl TemplateKind {
    fn value_kind(self) -> ValueKind {
        match self {
            TemplateKind::Place => ValueKind::Place,
            TemplateKind::Seconds => ValueKind::Seconds,
            TemplateKind::Text => ValueKind::Text,
        }
    }
}

/// A mission as people write it.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct MissionFile {
    /// The name of the kind of mission.
    #[schemars(with = "TaskId")]
    mission: String,
    /// What it is about, for people.
    #[serde(default)]
    title: String,
    /// What a request fills in, by name.
    #[serde(default, deserialize_with = "each_key_once")]
    parameters: BTreeMap<String, TemplateParameter>,
    /// Who takes part, by name; at least one is managed.
    #[serde(deserialize_with = "each_key_once")]
    roles: BTreeMap<String, RoleFile>,
    /// What is done.
    root: TaskFile,
    /// What is done instead if a robot is lost that has an item, or may have one. Its tasks have names of their own; in its
    /// values `${lost.item}`, `${lost.robot}` and `${lost.place}` say what was lost.
    #[serde(default)]
    recovery: Option<TaskFile>,
}

/// A part in the mission.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct RoleFile {
    /// Whether a robot is sought for it.
    kind: RoleKind,
    /// What becomes of the mission if its holder is lost after others have acted on its work.
    #[serde(default)]
    on_loss: OnLoss,
    /// What it does, for people.
    #[serde(default, rename = "description")]
    _description: String,
}

/// A task: abstract, with a `method` over `tasks`, or elementary, with a `type` and `roles`.
// Which of the two is told by its fields and judged when the mission is built, with its path.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(extend("oneOf" = [
    { "required": ["method", "tasks"], "not": { "anyOf": [{ "required": ["type"] }, { "required": ["roles"] }] } },
    { "required": ["type", "roles"], "not": { "anyOf": [{ "required": ["method"] }, { "required": ["tasks"] }] } },
]))]
struct TaskFile {
    /// Its name, unique within the mission.
    #[schemars(with = "TaskId")]
    task: String,
    /// Of an abstract task: whether its tasks depend on one another.
    #[serde(default)]
    method: Option<Order>,
    /// Of an abstract task: what it comes down to.
    #[serde(default)]
    tasks: Option<Vec<TaskFile>>,
    /// Of an elementary task: its type, which names the skill that does it.
    #[serde(default, rename = "type")]
    #[schemars(with = "Option<TaskType>")]
    task_type: Option<String>,
    /// Of an elementary task: who does it; several do it jointly.
    #[serde(default)]
    #[schemars(with = "Option<Vec<RoleId>>")]
    roles: Option<Vec<String>>,
    /// What the skill is told, by name. `${name}` stands for a parameter of the mission.
    #[serde(default, deserialize_with = "each_key_once")]
    parameters: BTreeMap<String, String>,
    /// What is so once the task has ended, as `location: ${room}`.
    #[serde(default, deserialize_with = "each_key_once")]
    reaches: BTreeMap<String, String>,
    /// Which role has which item once the task has ended.
    #[serde(default, deserialize_with = "each_key_once")]
    acquires: BTreeMap<String, String>,
    /// Items that nobody of the mission has any more once the task has ended.
    #[serde(default)]
    releases: Vec<String>,
    /// How often its skill is tried before the task has failed; 2 if nothing is said.
    #[serde(default, deserialize_with = "attempts")]
    #[schemars(range(min = 1, max = ATTEMPTS_MAX))]
    attempts: Option<u8>,
    /// Of an abstract task: other methods, tried in this order when a task of its own has failed for good. One managed role
    /// does all of them alone.
    #[serde(default)]
    alternatives: Vec<MethodFile>,
}

/// Another way to do an abstract task.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct MethodFile {
    /// `sequential`.
    method: Order,
    /// Elementary tasks.
    tasks: Vec<TaskFile>,
}

impl TaskFile {
    /// Whether it says what only an elementary task does.
    fn has_entries(&self) -> bool {
        let maps = [&self.parameters, &self.reaches, &self.acquires];
        maps.iter().any(|map| !map.is_empty()) || !self.releases.is_empty() || self.attempts.is_some()
    }
}

/// A map in which a key that stands twice is an error; JSON readers otherwise keep the last and say nothing.
pub(super) fn each_key_once<'de, D, V>(reader: D) -> Result<BTreeMap<String, V>, D::Error>
where
    D: Deserializer<'de>,
    V: Deserialize<'de>,
{
    struct OnceEach<V>(PhantomData<V>);
    impl<'de, V: Deserialize<'de>> Visitor<'de> for OnceEach<V> {
        type Value = BTreeMap<String, V>;
        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a map from names")
        }
        fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
            let mut found = BTreeMap::new();
            while let Some((key, value)) = map.next_entry::<String, V>()? {
                if found.contains_key(&key) {
                    return Err(A::Error::custom(format!("`{key}` stands here twice")));
                }
                found.insert(key, value);
            }
            Ok(found)
        }
    }
    reader.deserialize_map(OnceEach(PhantomData))
}

/// A number of attempts, or a word on what it should be. Whether it is one that is allowed is told later, with its task.
fn attempts<'de, D: Deserializer<'de>>(reader: D) -> Result<Option<u8>, D::Error> {
    struct Attempts;
    impl Visitor<'_> for Attempts {
        type Value = Option<u8>;
        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "a whole number of attempts from 1 to {ATTEMPTS_MAX}")
        }
        fn visit_u64<E: serde::de::Error>(self, number: u64) -> Result<Self::Value, E> {
            let number = u8::try_from(number).map_err(|_| E::invalid_value(Unexpected::Unsigned(number), &self))?;
            Ok(Some(number))
        }
        fn visit_i64<E: serde::de::Error>(self, number: i64) -> Result<Self::Value, E> {
            let positive = u64::try_from(number).map_err(|_| E::invalid_value(Unexpected::Signed(number), &self))?;
            self.visit_u64(positive)
        }
        fn visit_unit<E: serde::de::Error>(self) -> Result<Self::Value, E> {
            Ok(None)
        }
    }
    reader.deserialize_any(Attempts)
}

fn yaml_options() -> serde_saphyr::Options {
    serde_saphyr::options! {
        budget: serde_saphyr::budget! {
            max_aliases: 0,
            max_anchors: 0,
            max_depth: 128,
            flow_nesting_limit: 128,
            max_documents: 1,
            max_nodes: 50_000,
            max_events: 100_000,
            max_merge_keys: 0,
        },
        merge_keys: serde_saphyr::options::MergeKeyPolicy::Error,
    }
}

impl MissionTemplate {
    /// Reads a mission file. Tasks, roles and parameters are judged by [`MissionTemplate::instantiate`].
    ///
    /// ```
    /// use consort_protocol::mission::{Domain, Format, MissionTemplate};
    ///
    /// let file = r#"{ "mission": "go", "roles": { "r1": { "kind": "managed" } },
    ///     "root": { "task": "go", "type": "navigate", "roles": ["r1"], "parameters": { "to": "Dock" } } }"#;
    /// let template = MissionTemplate::parse(file, Format::Json)?;
    /// let wrong = template.instantiate(&Default::default(), &Domain::hospital()).unwrap_err().to_string();
    /// assert!(wrong.contains("unknown task type `navigate`") && wrong.ends_with("did you mean `navigation`?"), "{wrong}");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`FileError`] says where the text is not of the documented form.
    pub fn parse(text: &str, format: Format) -> Result<Self, FileError> {
        if text.len() > FILE_BYTES_MAX {
            return Err(FileError::TooLarge { bytes: text.len() });
        }
        let text = text.trim_start_matches('\u{feff}');
        let syntax = |message: String| FileError::Syntax { format, message };
        let file: MissionFile = match format {
            Format::Json => serde_json::from_str(text).map_err(|error| syntax(error.to_string()))?,
            Format::Yaml => {
                serde_saphyr::from_str_with_options(text, yaml_options()).map_err(|error| syntax(error.to_string()))?
            }
        };
        Ok(Self { name: TaskId::new(&*file.mission)?, file })
    }

    /// The form of a mission file, as a JSON Schema. What it cannot say, as which task types there are, [`instantiate`] does.
    ///
    /// [`instantiate`]: MissionTemplate::instantiate
    pub fn schema() -> Schema {
        schema_for!(MissionFile)
    }

    /// The name of the kind of mission.
    pub fn name(&self) -> &TaskId {
        &self.name
    }

    /// What it is about, for people; may be empty.
    pub fn title(&self) -> &str {
        &self.file.title
    }

    /// What a request fills in.
    pub fn parameters(&self) -> &BTreeMap<String, TemplateParameter> {
        &self.file.parameters
    }

    /// The mission with its parameters filled in, checked against the domain; its recovery branch, too, is checked.
    ///
    /// # Errors
    /// [`MissionErrors`] lists every problem of the values given and of the file.
    pub fn instantiate(&self, given: &BTreeMap<String, String>, domain: &Domain) -> Result<Mission, MissionErrors> {
        self.instantiate_both(given, domain).map(|(mission, _)| mission)
    }

    /// The mission and its recovery branch, if it has one. What is told of the loss is filled in when there is one.
    ///
    /// # Errors
    /// As [`instantiate`](MissionTemplate::instantiate).
    pub fn instantiate_both(
        &self,
        given: &BTreeMap<String, String>,
        domain: &Domain,
    ) -> Result<(Mission, Option<Mission>), MissionErrors> {
        let mut building = Building { values: BTreeMap::new(), used: BTreeSet::new(), problems: Vec::new() };
        building.take_values(&self.file.parameters, given, domain);
        let mut mission = building.mission(&self.name, &self.file.roles, &self.file.root, "root");
        let mut recovery = self.file.recovery.as_ref().map(|root| {
            building.values.extend(lost::NAMES);
            building.mission(&self.name, &self.file.roles, root, "recovery")
        });
        building.find_unused(&self.file.parameters);
        let mut problems = building.problems;
        let unwritten = !problems.is_empty();
        let place = |problem: &Problem| match &problem.fault {
            Fault::UnknownPlace { place, .. } => Some(place.clone()),
            _ => None,
        };
        let astray: BTreeSet<String> = problems.iter().filter_map(place).collect();
        let mut found = vec![];
        if let Some(recovery) = &mut recovery {
            part_roles(&mut mission, recovery);
            found = branch_problems(&mission, recovery, domain);
        }
        found.splice(0..0, mission.check(domain).err().into_iter().flat_map(|errors| errors.problems));
        // Where something could not be put in, what is missing for that reason is no problem of its own.
        let own = |problem: &Problem| match &problem.fault {
            Fault::NoRole { .. } | Fault::IdleRole | Fault::MissingParameter { .. } => !unwritten,
            Fault::BadValue { .. } | Fault::EmptyMethod | Fault::NoManagedRole => !unwritten,
            // Told once, of the request, and not of every task that goes there.
            Fault::UnknownPlace { place, .. } => !astray.contains(place),
            _ => true,
        };
        problems.extend(found.into_iter().filter(own));
        MissionErrors::unless_none(&self.name, problems)?;
        Ok((mission, recovery))
    }
}

/// Leaves to each branch the roles that do something in it; to the mission also those that do nothing in either.
fn part_roles(mission: &mut Mission, recovery: &mut Mission) {
    let busy = |mission: &Mission| -> BTreeSet<RoleId> {
        mission.elementary().into_iter().flat_map(|(_, spec)| spec.roles.clone()).collect()
    };
    let (own, others) = (busy(mission), busy(recovery));
    mission.roles.retain(|role, _| own.contains(role) || !others.contains(role));
    recovery.roles.retain(|role, _| others.contains(role));
}

/// What is wrong with a recovery branch.
fn branch_problems(mission: &Mission, recovery: &Mission, domain: &Domain) -> Vec<Problem> {
    let filled = Lost::for_instance(domain).fill_mission(recovery.clone()).expect("all of it is known");
    let of_branch = |Problem { path, fault }: Problem| match path.strip_prefix("root") {
        Some(below) => Problem { path: format!("recovery{below}"), fault },
        None => Problem { path: format!("recovery: {path}"), fault },
    };
    let mut found: Vec<Problem> =
        filled.check(domain).err().into_iter().flat_map(|errors| errors.problems).map(of_branch).collect();
    let names: BTreeSet<&TaskId> = mission.task_names().collect();
    for task in recovery.task_names().filter(|task| names.contains(task)) {
        let fault = Fault::DuplicateId { first: format!("root/…/{task}") };
        found.push(Problem { path: format!("recovery/…/{task}"), fault });
    }
    if mission.elementary().iter().all(|(_, spec)| spec.acquires.is_empty()) {
        found.push(Problem { path: "recovery".to_owned(), fault: Fault::NothingToLose });
    }
    found
}

/// A mission under construction.
struct Building<'a> {
    values: BTreeMap<&'a str, &'a str>,
    used: BTreeSet<&'a str>,
    problems: Vec<Problem>,
}

impl<'a> Building<'a> {
    fn problem(&mut self, path: &str, fault: Fault) {
        self.problems.push(Problem { path: path.to_owned(), fault });
    }

    fn take_values(
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
                self.problem(&path, Fault::Substitution { text: name.clone(), problem });
            }
            match given.get(name).or(parameter.default.as_ref()) {
                Some(value) => {
                    if !kind.admits(value) {
                        let (name, value) = (name.clone(), value.chars().take(80).collect());
                        self.problem(&path, Fault::BadValue { name, value, kind: kind.to_string() });
                    } else if let Some(fault) = domain.misplaced(name, &kind, value) {
                        self.problem(&path, fault);
                    }
                    self.values.insert(name, value);
                }
                None => {
                    self.problem(&path, Fault::MissingGiven { kind: kind.to_string() });
                    self.values.insert(name, ""); // so that its uses are not reported as well
                }
            }
        }
        for name in given.keys().filter(|name| !declared.contains_key(*name)) {
            let allowed = Allowed::instead_of(name, declared.keys());
            self.problem(&format!("parameters/{name}"), Fault::UnknownGiven { allowed });
        }
    }

    fn find_unused(&mut self, declared: &BTreeMap<String, TemplateParameter>) {
        let unused: Vec<&String> = declared.keys().filter(|name| !self.used.contains(name.as_str())).collect();
        for name in unused {
            self.problem(&format!("parameters/{name}"), Fault::UnusedParameter { name: name.clone() });
        }
    }

    /// The name, or a stand-in and a problem.
    fn name<N>(&mut self, path: &str, name: Result<N, NameError>) -> Option<N> {
        name.map_err(|error| self.problem(path, error.into())).ok()
    }

    fn mission(
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
            if let Some(Body::Abstract(method)) = parent.map(|parent| &mut tasks[parent].body) {
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

    fn body(&mut self, node: &'a TaskFile, path: &str) -> Body {
        let problem = match (&node.method, &node.tasks, &node.task_type, &node.roles) {
            (Some(order), Some(_), None, None) if !node.has_entries() => {
                let alternatives = self.alternatives(node, path);
                return Body::Abstract(Method { order: *order, children: vec![], alternatives });
            }
            (None, None, Some(task_type), Some(roles)) if node.alternatives.is_empty() => {
                return match self.elementary(node, task_type, roles, path) {
                    Some(spec) => Body::Elementary(spec),
                    None => Body::Abstract(Method::of(Order::Sequential, vec![])),
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
        self.problem(path, Fault::Shape { problem: problem.to_owned() });
        Body::Abstract(Method::of(Order::Sequential, vec![]))
    }

    fn alternatives(&mut self, node: &'a TaskFile, path: &str) -> Vec<OtherMethod> {
        let mut alternatives = Vec::new();
        for (number, method) in (1..).zip(&node.alternatives) {
            let path = format!("{path}/alternative {number}");
            if method.method != Order::Sequential {
                let problem = "is an alternative, and the tasks of an alternative are `sequential`".to_owned();
                self.problem(&path, Fault::Shape { problem });
            }
            let mut tasks = Vec::new();
            for task in &method.tasks {
                let path = format!("{path}/{}", task.task);
                let id = self.name(&path, TaskId::new(&*task.task));
                let spec = match self.body(task, &path) {
                    Body::Elementary(spec) => Some(spec),
                    Body::Abstract(_) => {
                        if task.task_type.is_none() {
                            let problem = "stands in an alternative, where all tasks are elementary".to_owned();
                            self.problem(&path, Fault::Shape { problem });
                        }
                        None
                    }
                };
                tasks.extend(id.zip(spec));
            }
            alternatives.push(OtherMethod { tasks });
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

    fn substitute(&mut self, text: &'a str) -> Result<String, Fault> {
        let wrong = |problem: &str| Fault::Substitution { text: text.to_owned(), problem: problem.to_owned() };
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
                let allowed = Allowed::instead_of(name, self.values.keys());
                return Err(Fault::UnknownReference { name: name.to_owned(), allowed });
            };
            self.used.insert(name);
            filled.push_str(value);
            rest = after;
        }
        filled.push_str(rest);
        Ok(filled)
    }
}

#[cfg(test)]
mod more_tests;
#[cfg(test)]
mod tests;
