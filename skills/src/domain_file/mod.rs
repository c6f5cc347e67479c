//! Domain files: actions and task types as data.
//!
//! ```yaml
//! domain: plants
//! actions:                                     # what a driver performs
//!   water:
//!     description: waters the plant at the robot's place
//!     parameters: { litres: { type: number, unit: l, minimum: 0, maximum: 5 } }
//!     results: { poured: { type: number, unit: l } }
//!     feedback: { flow: { type: number, unit: l/min, minimum: 0, maximum: 9 } }
//!     simulate:
//!       duration_s: [6, 10]
//!       failure_rate: 0.02
//!       results: { poured: [0.4, 0.6] }
//!       effects: { tank_l: { add: -0.5 } }
//!   load:                                      # a goal that hands an item over
//!     hands_over: true
//!     cancel: { within_s: 1.5 }
//!     simulate: { moves: { from: table, to: container } }
//! readings:                                    # what a driver publishes
//!   tank_l: { type: number, unit: l, minimum: 0, maximum: 5, simulate: { value: 5 } }
//! tasks:                                       # what a mission contains
//!   water_plant:
//!     parameters: { litres: { type: number, unit: l, minimum: 0, maximum: 5 } }
//!     action: water                            # or `tree: water_plant.xml`
//!     estimate: { time_s: "4.0 + 2.0 * litres" }
//! ```
//!
//! The leaf of an action in a behavior tree has its name, and its parameters as ports:
//! `<water litres="{litres}"/>`. A reading is a condition of its name: `<tank_l minimum="0.5"/>`.
//! Missions in the flat iHTN form have only names; `ihtn` declares
//! which of them are people, objects, places and task types of other names. The [standard domain](crate::domain) is
//! such a file, too. A domain adds to it; it does not replace its actions and task types.

mod action_leaf;
mod content_hash;
mod distribution;
mod estimate;
mod expression;
mod form;
mod goal_problems;
mod reading_leaf;
mod reading_problems;
mod requirement;
mod scaffold;

pub use distribution::{Distribution, Exponential, Normal, SimulatedDuration};
pub use form::{
    ActionForm, Addition, CancelForm, DomainForm, EstimateForm, FailureForm, IhtnForm, ItemHolder, ParameterForm,
    ParameterKind, ReadingForm, RetryForm, SimulatedAction, SimulatedEffect, SimulatedMove, SimulatedReading,
    SimulatedResult, TaskForm,
};
pub use scaffold::{scaffold, scaffold_yaml};

use crate::bt::xml::read_xml;
use crate::bt::{NodeKind, NodeSpec, TreeError, TreeErrorKind, TreeSpec};
use crate::descriptor::DescriptorRegistry;
use crate::library::{DeclaredBy, SkillLibrary};
use crate::skill::ASK_PERSON;
use consort_protocol::ids::{ActionName, DomainId, TaskType};
use consort_protocol::mission::{DomainHash, DomainReference, IhtnNames, RESULTS_MAX, TaskSchema};
use consort_text::AllowedNames;
use content_hash::content_hash;
use estimate::DeclaredEstimate;
use goal_problems::{cancel_problem, feedback_problems, move_problems};
use reading_problems::{effect_problems, reading_problems, value_problem};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::time::Duration;

/// System of the simulator that plays people.
const PEOPLE: &str = "people";

/// A checked domain file.
#[derive(Debug, Clone)]
pub struct DomainFile {
    form: DomainForm,
    /// The behavior trees of the task types.
    trees: BTreeMap<TaskType, TreeSpec>,
    /// Readings of this domain and of those that it was checked with, by name.
    readings: BTreeMap<String, ParameterForm>,
    /// The task types with a tree in which an item may be handed over.
    handing_over: BTreeSet<TaskType>,
    /// Kinds of the goals that hand an item over in the simulator, by task type.
    handover_kinds: BTreeMap<TaskType, ActionName>,
    hash: DomainHash,
    /// The standard domain is part of the program, so its tasks do not refer to it.
    is_standard: bool,
}

/// A problem of a domain file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DomainProblem {
    /// The place in the file, as keys: `tasks.water_plant.action`; empty for a problem of a tree, which
    /// names its own file.
    pub place: String,
    /// The problem, and what is allowed.
    pub problem: String,
}

impl fmt::Display for DomainProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.place.as_str() {
            "" => f.write_str(&self.problem),
            place => write!(f, "{place}: {}", self.problem),
        }
    }
}

fn problem(place: impl Into<String>, problem: impl Into<String>) -> DomainProblem {
    DomainProblem { place: place.into(), problem: problem.into() }
}

impl DomainForm {
    /// Returns the names of the tree files, relative to the domain file.
    pub fn tree_files(&self) -> impl Iterator<Item = &str> {
        self.tasks.values().filter_map(|task| task.tree.as_deref())
    }
}

impl DomainFile {
    /// Checks a domain that adds to a library, and to the standard domain unless it is the standard domain.
    ///
    /// # Errors
    /// Every problem, in the order of the file.
    pub(crate) fn check_after(
        mut library: SkillLibrary,
        standard: Option<&DomainFile>,
        form: DomainForm,
        trees: &BTreeMap<String, String>,
        known: &[&DomainFile],
    ) -> Result<DomainFile, Vec<DomainProblem>> {
        let mut problems = vec![];
        for domain in known {
            domain.extend_library(&mut library).map_err(|problem| vec![problem])?;
        }
        let declared = known.iter().map(|domain| &domain.form).chain([&form]);
        let readings: BTreeMap<&str, &ReadingForm> =
            declared.flat_map(|form| &form.readings).map(|(name, reading)| (name.as_str(), reading)).collect();
        for (name, action) in &form.actions {
            problems.extend(action_problems(name, action));
            problems.extend(effect_problems(name, &action.simulate.effects, &readings));
            if let Err(error) = library.extend(|registry| action_leaf::register(registry, name, action)) {
                problems.push(problem(format!("actions.{name}"), error.to_string()));
            }
        }
        problems.extend(reading_problems(&form.readings, readings.len()));
        for (name, reading) in &form.readings {
            if let Err(error) = library.extend(|registry| reading_leaf::register(registry, name, &reading.value)) {
                problems.push(problem(format!("readings.{name}"), error.to_string()));
            }
        }
        let readings: BTreeMap<String, ParameterForm> =
            readings.into_iter().map(|(name, reading)| (name.to_owned(), reading.value.clone())).collect();
        let known_forms = standard.into_iter().chain(known.iter().copied()).map(|domain| &domain.form);
        let actions: BTreeMap<&ActionName, &ActionForm> =
            known_forms.chain([&form]).flat_map(|form| &form.actions).collect();
        let (mut checked, mut handing_over, mut handover_kinds) = (BTreeMap::new(), BTreeSet::new(), BTreeMap::new());
        for (name, task) in &form.tasks {
            problems.extend(task_problems(&form, standard, name, task, &readings));
            let declares = |domain: &&&DomainFile| domain.form.tasks.contains_key(name);
            if let Some(domain) = known.iter().find(declares) {
                problems.push(problem(
                    format!("tasks.{name}"),
                    format!("the domain {} has a task type of this name", domain.name()),
                ));
            }
            match tree_of(&form, name, task, trees) {
                Ok(Some(tree)) => {
                    let declared = || actions.iter().map(|(name, action)| (*name, *action));
                    let of_people = task.tree.as_ref().and_then(|_| action_of_people(&tree, declared()));
                    problems.extend(of_people.map(|error| problem("", error.to_string())));
                    if may_hand_over(&tree, declared()) {
                        handing_over.insert(name.clone());
                    }
                    handover_kinds.extend(handover_kind(&tree, declared()).map(|kind| (name.clone(), kind)));
                    match library.register_declared(name.clone(), &tree, declared_by(&form, task, None)) {
                        Ok(()) => {
                            checked.insert(name.clone(), tree);
                        }
                        Err(error) => problems.push(problem("", error.to_string())),
                    }
                }
                Ok(None) => {}
                Err(found) => problems.push(found),
            }
        }
        problems.extend(ihtn_problems(&form, standard, known));
        if !problems.is_empty() {
            return Err(problems);
        }
        let hash = content_hash(&form, trees);
        let (trees, is_standard) = (checked, standard.is_none());
        Ok(DomainFile { form, trees, readings, handing_over, handover_kinds, hash, is_standard })
    }

    /// Returns the name of the domain.
    pub fn name(&self) -> &DomainId {
        &self.form.domain
    }

    /// Returns the name of the domain with the hash of its content.
    pub fn reference(&self) -> DomainReference {
        DomainReference { name: self.form.domain.clone(), hash: self.hash }
    }

    /// Returns the reference that tasks of this domain contain.
    fn tasks_reference(&self) -> Option<DomainReference> {
        (!self.is_standard).then(|| self.reference())
    }

    /// Returns the task types with their parameters, and whether they hand items over.
    pub fn task_types(&self) -> impl Iterator<Item = (TaskType, TaskSchema)> {
        self.form.tasks.iter().map(|(name, task)| {
            let schema = task.schema(action_of(&self.form, task), self.tasks_reference());
            (name.clone(), TaskSchema { hands_over: Some(self.handing_over.contains(name)), ..schema })
        })
    }

    /// Returns the meaning of names in flat iHTNs.
    pub fn ihtn_names(&self) -> IhtnNames {
        self.form.ihtn.clone().into()
    }

    /// Returns the names of the actions.
    pub fn actions(&self) -> impl Iterator<Item = &ActionName> {
        self.form.actions.keys()
    }

    /// Returns the actions with their parameters.
    pub fn action_forms(&self) -> impl Iterator<Item = (&ActionName, &ActionForm)> {
        self.form.actions.iter()
    }

    /// Returns the actions of robots that declare the time from the cancel of a goal to its end, with this time.
    pub fn cancel_times(&self) -> impl Iterator<Item = (&ActionName, Duration)> {
        let of_robots = self.form.actions.iter().filter(|(_, action)| !action.by_people);
        of_robots.filter_map(|(name, action)| {
            let CancelForm { within_s } = action.cancel.as_ref()?;
            Some((name, Duration::from_secs_f64(*within_s)))
        })
    }

    /// Returns the readings that drivers publish.
    pub fn reading_forms(&self) -> impl Iterator<Item = (&String, &ReadingForm)> {
        self.form.readings.iter()
    }

    /// Returns the behavior trees of the task types.
    pub fn trees(&self) -> impl Iterator<Item = &TreeSpec> {
        self.trees.values()
    }

    /// Returns the actions for the simulator: `simulate` contains all results.
    pub fn simulated_actions(&self) -> impl Iterator<Item = (ActionName, ActionForm)> {
        self.form.actions.iter().map(|(name, action)| (name.clone(), simulated(action)))
    }

    /// Returns the task types for simulated people, each with its action: `simulate` contains all results of
    /// the task. A task with a tree declares no time, so the simulator determines it. The kind is that of the goal with
    /// which a robot hands an item over in the task.
    pub fn simulated_tasks(&self) -> impl Iterator<Item = (TaskType, ActionForm)> {
        self.form.tasks.iter().map(|(name, task)| {
            let action = action_of(&self.form, task);
            let results = task.results(action).clone();
            let mut played = simulated(&ActionForm { results, ..action.cloned().unwrap_or_else(played_by_people) });
            played.simulate.goal_kind = self.handover_kinds.get(name).cloned();
            (name.clone(), played)
        })
    }

    /// Adds the leaves of the actions and of the readings, and the trees of the task types to a library.
    ///
    /// # Errors
    /// The first problem: another domain has a leaf or a node of the same name.
    pub fn extend_library(&self, library: &mut SkillLibrary) -> Result<(), DomainProblem> {
        for (name, action) in &self.form.actions {
            let added = library.extend(|registry| action_leaf::register(registry, name, action));
            added.map_err(|error| problem(format!("actions.{name}"), error.to_string()))?;
        }
        library.declare_cancel_times(self.cancel_times());
        for (name, reading) in &self.form.readings {
            let added = library.extend(|registry| reading_leaf::register(registry, name, &reading.value));
            added.map_err(|error| problem(format!("readings.{name}"), error.to_string()))?;
        }
        for (name, tree) in &self.trees {
            let task = self.form.tasks.get(name);
            let declared = task.map(|task| declared_by(&self.form, task, self.tasks_reference())).unwrap_or_default();
            let added = library.register_declared(name.clone(), tree, declared);
            added.map_err(|error| problem("", error.to_string()))?;
        }
        Ok(())
    }

    /// Adds the estimates of the task types.
    #[must_use]
    pub fn extend_descriptors(&self, descriptors: DescriptorRegistry) -> DescriptorRegistry {
        self.form.tasks.iter().fold(descriptors, |descriptors, (name, task)| {
            match estimate_of(&self.form, name, task, &self.readings) {
                Ok(estimate) => descriptors.with(estimate.of_domain(self.tasks_reference())),
                Err(_) => descriptors, // a checked domain has none
            }
        })
    }
}

/// Returns the error of a tree file that contains an action that people perform.
pub fn action_of_people<'a>(
    tree: &TreeSpec,
    actions: impl IntoIterator<Item = (&'a ActionName, &'a ActionForm)>,
) -> Option<TreeError> {
    let by_people = actions.into_iter().filter(|(_, form)| form.by_people).map(|(name, _)| name.as_str()).collect();
    let node = tree.trees.values().find_map(|root| node_of(root, &by_people))?;
    let kind = Box::new(TreeErrorKind::ActionOfPeople { id: node.id.clone() });
    Some(TreeError { source: tree.source.clone(), line: node.line, node: None, kind })
}

/// Checks whether a robot may hand an item over in a tree, or a person whom it asks.
fn may_hand_over<'a>(tree: &TreeSpec, actions: impl IntoIterator<Item = (&'a ActionName, &'a ActionForm)>) -> bool {
    let moving = moving_actions(actions).map(|(name, _)| name.as_str()).chain([ASK_PERSON]).collect();
    tree.trees.values().any(|root| node_of(root, &moving).is_some())
}

/// Returns the kind of the first goal with which a system of the simulator hands an item over in a tree.
fn handover_kind<'a>(
    tree: &TreeSpec,
    actions: impl IntoIterator<Item = (&'a ActionName, &'a ActionForm)>,
) -> Option<ActionName> {
    let of_systems = moving_actions(actions).filter(|(_, form)| form.simulate.system.is_some());
    let kinds: BTreeMap<&str, &ActionName> =
        of_systems.map(|(name, form)| (name.as_str(), form.simulate.goal_kind.as_ref().unwrap_or(name))).collect();
    let ids = kinds.keys().copied().collect();
    let node = tree.trees.values().find_map(|root| node_of(root, &ids))?;
    kinds.get(node.id.as_str()).map(|kind| (*kind).clone())
}

/// Returns the actions with which robots may hand items over.
fn moving_actions<'a>(
    actions: impl IntoIterator<Item = (&'a ActionName, &'a ActionForm)>,
) -> impl Iterator<Item = (&'a ActionName, &'a ActionForm)> {
    actions.into_iter().filter(|(_, form)| !form.by_people && form.may_move_items())
}

/// Returns the first node with any of these ids.
fn node_of<'a>(node: &'a NodeSpec, ids: &BTreeSet<&str>) -> Option<&'a NodeSpec> {
    let is_action = node.kind != Some(NodeKind::SubTree) && ids.contains(node.id.as_str());
    if is_action { Some(node) } else { node.children.iter().find_map(|child| node_of(child, ids)) }
}

fn ihtn_problems(form: &DomainForm, standard: Option<&DomainFile>, known: &[&DomainFile]) -> Vec<DomainProblem> {
    let mut problems = vec![];
    for agent in form.ihtn.people.iter().filter(|agent| form.ihtn.objects.contains(agent.as_str())) {
        problems.push(problem(format!("ihtn.people.{agent}"), "an agent is either a person or an object"));
    }
    let others = standard.into_iter().chain(known.iter().copied());
    let task_types: BTreeSet<&TaskType> =
        others.flat_map(|domain| domain.form.tasks.keys()).chain(form.tasks.keys()).collect();
    let named = form.ihtn.actions.iter().map(|(name, task_type)| (format!("actions.{name}"), task_type));
    let reaching = form.ihtn.reaching.iter().map(|task_type| ("reaching".to_owned(), task_type));
    for (key, task_type) in named.chain(reaching).filter(|(_, task_type)| !task_types.contains(task_type)) {
        let allowed = AllowedNames::suggest_for(task_type.as_str(), task_types.iter().copied());
        problems.push(problem(format!("ihtn.{key}"), format!("unknown task type {task_type}; {allowed}")));
    }
    problems
}

fn action_problems(name: &ActionName, action: &ActionForm) -> Vec<DomainProblem> {
    let place = format!("actions.{name}");
    let mut problems = parameter_problems(&place, &action.parameters);
    for (name, _) in action.parameters.iter().filter(|(_, parameter)| parameter.kind == ParameterKind::Points) {
        problems
            .push(problem(format!("{place}.parameters.{name}"), "`points` are for tasks; an action has `waypoints`"));
    }
    if let Some(RetryForm { timeout_s, .. }) = action.retry
        && !(0.0..=f64::MAX).contains(&timeout_s)
    {
        problems.push(problem(format!("{place}.retry.timeout_s"), "allowed are seconds of 0 or more"));
    }
    if action.discharge.is_some_and(|multiple| !(0.0..=f64::MAX).contains(&multiple)) {
        problems.push(problem(format!("{place}.discharge"), "allowed is a multiple of 0 or more"));
    }
    problems.extend(cancel_problem(&place, action));
    problems.extend(move_problems(&place, action));
    problems.extend(result_problems(&place, &action.results));
    problems.extend(feedback_problems(&place, action));
    for (result, simulated) in &action.simulate.results {
        let wrong = match action.results.get(result) {
            Some(form) => value_problem("result", form, simulated),
            None => Some(format!("no such result; {}", AllowedNames::suggest_for(result, action.results.keys()))),
        };
        problems.extend(wrong.map(|wrong| problem(format!("{place}.simulate.results.{result}"), wrong)));
    }
    for name in action.results.keys().filter(|name| action.parameters.contains_key(*name)) {
        problems.push(problem(format!("{place}.results.{name}"), "a parameter has the same name"));
    }
    for reason in action.failures.keys().filter(|reason| !is_name(reason)) {
        problems.push(problem(format!("{place}.failures.{reason}"), NAME_ALLOWED));
    }
    for reason in action.simulate.failures.keys().filter(|reason| !action.failures.contains_key(*reason)) {
        let known = AllowedNames::suggest_for(reason, action.failures.keys());
        problems.push(problem(format!("{place}.simulate.failures.{reason}"), format!("no such failure; {known}")));
    }
    if action.simulate.goal_kind.is_some() && action.simulate.system.is_none() {
        problems
            .push(problem(format!("{place}.simulate.as"), "`as` is a kind of goals of a `system`, which is missing"));
    }
    let SimulatedAction { duration_s, failure_rate, ref failures, .. } = action.simulate;
    problems.extend(duration_s.problem().map(|allowed| problem(format!("{place}.simulate.duration_s"), allowed)));
    let declared = failures.iter().map(|(reason, share)| (format!("failures.{reason}"), *share));
    let shares: Vec<(String, f64)> = [("failure_rate".to_owned(), failure_rate)].into_iter().chain(declared).collect();
    for (key, _) in shares.iter().filter(|(_, share)| !(0.0..=1.0).contains(share)) {
        problems.push(problem(format!("{place}.simulate.{key}"), "allowed is a share from 0 to 1"));
    }
    let sum: f64 = shares.iter().map(|(_, share)| share).sum();
    if sum > 1.0 + 1e-9 {
        problems.push(problem(
            format!("{place}.simulate"),
            format!("the shares of failures add up to {sum}; at most 1 is allowed"),
        ));
    }
    problems
}

/// Returns the action with all its results and all its feedback in `simulate`.
fn simulated(action: &ActionForm) -> ActionForm {
    let mut complete = action.clone();
    for (name, result) in &action.results {
        complete.simulate.results.entry(name.clone()).or_insert_with(|| result.simulated());
    }
    for (name, value) in &action.feedback {
        complete.simulate.feedback.entry(name.clone()).or_insert_with(|| value.simulated());
    }
    complete
}

/// Returns the action of a task with a tree that a person does.
fn played_by_people() -> ActionForm {
    let simulate = SimulatedAction { system: Some(PEOPLE.to_owned()), ..SimulatedAction::default() };
    ActionForm { simulate, ..ActionForm::default() }
}

/// Returns the action of a task, if it has one of this domain.
fn action_of<'a>(form: &'a DomainForm, task: &TaskForm) -> Option<&'a ActionForm> {
    form.actions.get(task.action.as_ref()?)
}

fn declared_by(form: &DomainForm, task: &TaskForm, domain: Option<DomainReference>) -> DeclaredBy {
    DeclaredBy { results: task.results(action_of(form, task)).keys().cloned().collect(), domain }
}

fn result_problems(place: &str, results: &BTreeMap<String, ParameterForm>) -> Vec<DomainProblem> {
    let mut problems = returned_problems(&format!("{place}.results"), "a result", results);
    if results.len() > RESULTS_MAX {
        problems.push(problem(place, format!("{} results; at most {RESULTS_MAX} are allowed", results.len())));
    }
    problems
}

/// Returns the problems of values that a goal returns. `what` is the word for one of them.
fn returned_problems(place: &str, what: &str, values: &BTreeMap<String, ParameterForm>) -> Vec<DomainProblem> {
    let mut problems = value_problems(place, values.iter());
    for (name, value) in values {
        let place = format!("{place}.{name}");
        if value.kind == ParameterKind::Place || !value.kind.is_value() {
            problems.push(problem(&place, "allowed are seconds, number, integer, bool and text"));
        }
        if value.optional {
            problems.push(problem(&place, format!("{what} is not `optional`")));
        }
    }
    problems
}

fn parameter_problems(place: &str, parameters: &BTreeMap<String, ParameterForm>) -> Vec<DomainProblem> {
    value_problems(&format!("{place}.parameters"), parameters.iter())
}

fn value_problems<'a>(
    place: &str,
    values: impl Iterator<Item = (&'a String, &'a ParameterForm)>,
) -> Vec<DomainProblem> {
    let mut problems = vec![];
    for (name, parameter) in values {
        let place = format!("{place}.{name}");
        let is_number = matches!(parameter.kind, ParameterKind::Number | ParameterKind::Integer);
        let has_range = parameter.minimum.is_some() || parameter.maximum.is_some();
        if has_range && !is_number {
            problems.push(problem(&place, "only numbers and integers have a minimum or a maximum"));
        }
        if !parameter.one_of.is_empty() && parameter.kind != ParameterKind::Text {
            problems.push(problem(&place, "only texts have `one_of`"));
        }
        if parameter.minimum > parameter.maximum && parameter.maximum.is_some() {
            problems.push(problem(&place, "the minimum exceeds the maximum"));
        }
        if !is_name(name) {
            problems.push(problem(&place, NAME_ALLOWED));
        }
    }
    problems
}

const NAME_ALLOWED: &str = "allowed is a letter, followed by letters, digits and `_`";

fn is_name(name: &str) -> bool {
    let mut letters = name.chars();
    letters.next().is_some_and(|first| first.is_ascii_alphabetic())
        && letters.all(|letter| letter.is_ascii_alphanumeric() || letter == '_')
}

fn task_problems(
    form: &DomainForm,
    standard: Option<&DomainFile>,
    name: &TaskType,
    task: &TaskForm,
    readings: &BTreeMap<String, ParameterForm>,
) -> Vec<DomainProblem> {
    let place = format!("tasks.{name}");
    let mut problems = parameter_problems(&place, &task.parameters);
    for (name, _) in task.parameters.iter().filter(|(_, parameter)| parameter.kind.is_of_actions()) {
        let allowed = "allowed are place, role, seconds, number, integer, bool, text and points";
        problems.push(problem(format!("{place}.parameters.{name}"), allowed));
    }
    problems.extend(result_problems(&place, &task.results));
    if standard.is_some_and(|standard| standard.form.tasks.contains_key(name)) {
        problems.push(problem(&place, "the standard domain has a task type of this name"));
    }
    if task.action.is_some() == task.tree.is_some() {
        problems.push(problem(&place, "a task has either an `action` or a `tree`"));
    }
    if let Some(action) = &task.action {
        let at = format!("{place}.action");
        match form.actions.get(action) {
            None => {
                let known = AllowedNames::suggest_for(action.as_str(), form.actions.keys());
                problems.push(problem(at, format!("the domain declares no action {action}; {known}")));
            }
            Some(declared) => {
                let missing = declared.parameters.iter().filter(|(name, parameter)| {
                    !parameter.optional && task.parameters.get(*name).is_none_or(|own| own.optional)
                });
                for (parameter, _) in missing {
                    problems.push(problem(&at, format!("{action} needs the parameter `{parameter}` of the task")));
                }
            }
        }
    }
    if let Err(found) = estimate_of(form, name, task, readings) {
        problems.push(found);
    }
    problems
}

/// Returns the estimate of a task, or else the mean time of its action in the simulator.
fn estimate_of(
    form: &DomainForm,
    name: &TaskType,
    task: &TaskForm,
    readings: &BTreeMap<String, ParameterForm>,
) -> Result<DeclaredEstimate, DomainProblem> {
    let of_action = || {
        let action = form.actions.get(task.action.as_ref()?)?;
        Some(EstimateForm { time_s: format!("{:?}", action.simulate.mean_s()), energy: None, ends_at: None })
    };
    let Some(estimate) = task.estimate.clone().or_else(of_action) else {
        return Err(problem(format!("tasks.{name}.estimate"), "a task with a tree needs an estimate"));
    };
    let compiled = DeclaredEstimate::compile(name, task, &estimate)
        .map_err(|(key, found)| problem(format!("tasks.{name}.estimate.{key}"), found))?;
    let discharge = task.action.as_ref().and_then(|action| form.actions.get(action)?.discharge);
    let compiled = compiled.with_discharge(discharge.unwrap_or(1.0));
    match &task.requires {
        Some(condition) => {
            compiled.requiring(condition, readings).map_err(|found| problem(format!("tasks.{name}.requires"), found))
        }
        None => Ok(compiled),
    }
}

/// Returns the tree of a task; `None` if it has neither an action nor a tree.
fn tree_of(
    form: &DomainForm,
    name: &TaskType,
    task: &TaskForm,
    trees: &BTreeMap<String, String>,
) -> Result<Option<TreeSpec>, DomainProblem> {
    match (&task.action, &task.tree) {
        (Some(action), None) => {
            let parameters = form.actions.get(action).map(|declared| &declared.parameters);
            let shared = task.parameters.keys().filter(|name| parameters.is_some_and(|own| own.contains_key(*name)));
            let results = form.actions.get(action).map(|declared| &declared.results);
            let bound = shared.chain(results.into_iter().flat_map(BTreeMap::keys));
            let leaf = bound.fold(NodeSpec::new(action.as_str()), |leaf, name| leaf.port(name, &format!("{{{name}}}")));
            Ok(Some(TreeSpec::single(name.as_str(), leaf)))
        }
        (None, Some(file)) => {
            let text =
                trees.get(file).ok_or_else(|| problem(format!("tasks.{name}.tree"), format!("{file} is missing")))?;
            read_xml(file, text).map(Some).map_err(|error| problem("", error.to_string()))
        }
        (Some(_), Some(_)) | (None, None) => Ok(None),
    }
}

#[cfg(test)]
mod tests;
