//! The skill library: behavior trees by task type.
//!
//! ```
//! use consort_protocol::ids::TaskType;
//! use consort_protocol::mission::TaskSpec;
//! use consort_skills::actions::{Goal, GoalId, GoalStatus, RobotActions, Telemetry};
//! use consort_skills::environment::Environment;
//! use consort_skills::library::{SkillLibrary, SkillStatus};
//! use consort_skills::skill::SkillContext;
//!
//! /// A robot that completes every goal at once.
//! #[derive(Default)]
//! struct InstantRobot(Vec<Goal>);
//!
//! impl RobotActions for InstantRobot {
//!     fn send_goal(&mut self, goal: Goal) -> GoalId {
//!         self.0.push(goal);
//!         GoalId(self.0.len() as u64)
//!     }
//!     fn status(&self, _: GoalId) -> Option<GoalStatus> {
//!         Some(GoalStatus::succeeded())
//!     }
//!     fn cancel(&mut self, _: GoalId) {}
//!     fn telemetry(&self) -> Option<&Telemetry> {
//!         None
//!     }
//! }
//!
//! let library = SkillLibrary::standard(Environment::new());
//! let mut task = TaskSpec::of(TaskType::new("operate_drawer")?, vec!["r1".parse()?]);
//! let error = library.load(&task, &SkillContext::default()).err().map(|error| error.to_string());
//! assert!(error.is_some_and(|error| error.starts_with("operate_drawer needs the parameter `action`")));
//!
//! task.parameters.insert("action".to_owned(), "open".to_owned());
//! let mut skill = library.load(&task, &SkillContext::default())?;
//! let mut robot = InstantRobot::default();
//! while skill.tick(&mut robot) == SkillStatus::Running {}
//! assert_eq!(robot.0[0].parameters["action"], "open");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use crate::actions::{ErrorCode, RobotActions};
use crate::bt::xml::read_xml;
use crate::bt::{
    BlackboardError, Blueprint, NodeSpec, NodeStatus, PortType, Registry, RegistryError, Tree, TreeError, TreeInput,
    TreeSpec, Value,
};
use crate::environment::Environment;
use crate::names::join_names;
use crate::skill::{KnownValues, SkillContext, StatedQuestion, TaskContext, register_leaves, stated_questions};
use consort_protocol::cause::CauseClass;
use consort_protocol::ids::{ActionName, TaskType};
use consort_protocol::mission::{DomainReference, OtherDomain, TaskSpec};
use consort_protocol::scalar::Scalar;
use consort_protocol::units::WorldTime;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Skills by task type. Built once when a node starts, then shared.
pub struct SkillLibrary {
    environment: Environment,
    registry: Registry<TaskContext>,
    skills: BTreeMap<TaskType, Skill>,
    cancel_times: BTreeMap<ActionName, Duration>,
}

/// A skill.
struct Skill {
    tree: TreeSpec,
    blueprint: Blueprint<TaskContext>,
    declared: DeclaredBy,
}

/// What a domain file declares about a skill besides its tree.
#[derive(Debug, Clone, Default)]
pub(crate) struct DeclaredBy {
    /// Results of the task: the values of the keys of the main tree with these names, when the tree has
    /// succeeded.
    pub(crate) results: BTreeSet<String>,
    /// The domain; `None` for a skill without a file.
    pub(crate) domain: Option<DomainReference>,
}

/// A skill cannot be started. No goal was sent to the robot.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SkillError {
    /// The task was made with another content of the domain file.
    #[error(transparent)]
    OtherDomain(#[from] OtherDomain),
    /// No skill exists for the task type.
    #[error("there is no skill for {task_type}; skills exist for {known}")]
    NoSkill {
        /// The type of the task.
        task_type: TaskType,
        /// The task types with skills, as text.
        known: String,
    },
    /// The task lacks a parameter that the skill needs.
    #[error("{task_type} needs the parameter `{parameter}` ({wanted}); the task gives {given}")]
    MissingParameter {
        /// The type of the task.
        task_type: TaskType,
        /// The missing parameter.
        parameter: String,
        /// The type of the parameter.
        wanted: PortType,
        /// The parameters of the task, as text.
        given: String,
    },
    /// A parameter has the wrong type or value.
    #[error("{task_type}: {source}")]
    Parameter {
        /// The type of the task.
        task_type: TaskType,
        /// Cause, and the allowed values.
        source: BlackboardError,
    },
}

impl SkillLibrary {
    /// Creates a library without skills, with an environment for its leaves.
    pub fn empty(environment: Environment) -> SkillLibrary {
        SkillLibrary { environment, registry: Registry::new(), skills: BTreeMap::new(), cancel_times: BTreeMap::new() }
    }

    /// Creates a library without skills, with the leaves that are written in Rust.
    pub(crate) fn with_leaves(environment: Environment) -> SkillLibrary {
        let mut library = SkillLibrary::empty(environment);
        register_leaves(&mut library.registry).expect("their names are unique");
        library
    }

    /// Registers a skill, replacing any for the same task type. The task's parameters are set on
    /// the keys of the main tree with the same names. A key that the tree reads and never writes is
    /// a required parameter of the task.
    ///
    /// # Errors
    /// [`TreeError`] if the tree has a mistake. The library is unchanged.
    pub fn register(&mut self, task_type: TaskType, tree: &TreeSpec) -> Result<(), TreeError> {
        self.register_declared(task_type, tree, DeclaredBy::default())
    }

    /// Same as [`register`](Self::register), for a task type of a domain file.
    pub(crate) fn register_declared(
        &mut self,
        task_type: TaskType,
        tree: &TreeSpec,
        declared: DeclaredBy,
    ) -> Result<(), TreeError> {
        let blueprint = self.registry.check(tree)?;
        self.skills.insert(task_type, Skill { tree: tree.clone(), blueprint, declared });
        Ok(())
    }

    /// Registers a skill from the text of a file. `source` names the file in messages.
    ///
    /// # Errors
    /// [`TreeError`] as for [`register`](SkillLibrary::register), or if the text is not a tree
    /// file.
    pub fn register_xml(&mut self, task_type: TaskType, source: &str, xml: &str) -> Result<(), TreeError> {
        self.register(task_type, &read_xml(source, xml)?)
    }

    /// Lets every registered skill execute a leaf first, for example to inject faults.
    ///
    /// # Errors
    /// [`TreeError`] if there is no such leaf, or if it has ports without a default.
    pub fn precede_with(&mut self, leaf: &str) -> Result<(), TreeError> {
        for skill in self.skills.values_mut() {
            if let Some(root) = skill.tree.trees.remove(&skill.tree.main) {
                let mut sequence = NodeSpec::new("Sequence");
                sequence.children = vec![NodeSpec::new(leaf), root];
                skill.tree.trees.insert(skill.tree.main.clone(), sequence);
                skill.blueprint = self.registry.check(&skill.tree)?;
            }
        }
        Ok(())
    }

    /// Adds leaves for trees that are registered afterwards.
    ///
    /// # Errors
    /// [`RegistryError`] from `add`.
    pub fn extend(
        &mut self,
        add: impl FnOnce(&mut Registry<TaskContext>) -> Result<(), RegistryError>,
    ) -> Result<(), RegistryError> {
        add(&mut self.registry)
    }

    /// Adds the time from the cancel of a goal to its end, for actions that declare it.
    pub(crate) fn declare_cancel_times<'a>(&mut self, times: impl Iterator<Item = (&'a ActionName, Duration)>) {
        self.cancel_times.extend(times.map(|(action, time)| (action.clone(), time)));
    }

    /// Returns the time from the cancel of a goal to its end, by action, for actions that declare it.
    pub fn cancel_times(&self) -> &BTreeMap<ActionName, Duration> {
        &self.cancel_times
    }

    /// The registered leaves.
    pub fn registry(&self) -> &Registry<TaskContext> {
        &self.registry
    }

    /// The task types with skills, in the order of their names.
    pub fn task_types(&self) -> impl Iterator<Item = &TaskType> {
        self.skills.keys()
    }

    /// Returns the required and optional parameters of a task type; `None` without a skill for it.
    pub fn parameters(&self, task_type: &TaskType) -> Option<&[TreeInput]> {
        self.skills.get(task_type).map(|skill| skill.blueprint.inputs())
    }

    /// Returns the questions to people in the tree of a task, with the values of the task's
    /// parameters. A parameter that is the result of an earlier task is not known yet.
    pub fn questions(&self, task: &TaskSpec) -> Vec<StatedQuestion> {
        let Some(skill) = self.skills.get(&task.task_type) else { return vec![] };
        let inputs = skill.blueprint.inputs().iter().map(|input| &input.key);
        let known = inputs.filter(|key| !task.inputs.contains_key(*key));
        let values: KnownValues = known.map(|key| (key.clone(), task.parameters.get(key).cloned())).collect();
        stated_questions(&skill.tree, &values)
    }

    /// Prepares a skill for a task. Parameters that its tree does not use are ignored: they are for
    /// others.
    ///
    /// # Errors
    /// [`SkillError`] if there is no such skill, or the task's parameters do not fit.
    pub fn load(&self, task: &TaskSpec, context: &SkillContext) -> Result<ActiveSkill, SkillError> {
        let task_type = &task.task_type;
        let Some(Skill { blueprint, declared: DeclaredBy { results, domain }, .. }) = self.skills.get(task_type) else {
            let known = join_names(self.task_types().map(TaskType::as_str));
            return Err(SkillError::NoSkill { task_type: task_type.clone(), known });
        };
        task.check_domain(domain.as_ref())?;
        let context = TaskContext { task: task.clone(), skill: context.clone(), environment: self.environment.clone() };
        let mut tree = blueprint.instantiate(&context);
        for input in blueprint.inputs() {
            match task.parameters.get(&input.key) {
                Some(text) => tree
                    .set(&input.key, Value::Text(text.clone()))
                    .map_err(|source| SkillError::Parameter { task_type: task_type.clone(), source })?,
                None if input.required => {
                    return Err(SkillError::MissingParameter {
                        task_type: task_type.clone(),
                        parameter: input.key.clone(),
                        wanted: input.port_type,
                        given: join_names(task.parameters.keys().map(String::as_str)),
                    });
                }
                None => {}
            }
        }
        Ok(ActiveSkill { tree, results: results.clone(), now: WorldTime::ZERO, ended: None })
    }
}

/// Status of a skill.
#[derive(Debug, Clone, PartialEq)]
pub enum SkillStatus {
    /// Tick again when the robot reports an event, and at an interval.
    Running,
    /// The task is complete, with its results. A result that the tree has not set is missing.
    Succeeded(BTreeMap<String, Scalar>),
    /// The task is not complete, and will not be.
    Failed {
        /// Cause for people: the leaf that failed last, with the robot's own message, if any.
        cause: String,
        /// Class of the cause.
        class: CauseClass,
    },
}

/// A skill that executes a task.
pub struct ActiveSkill {
    tree: Tree,
    results: BTreeSet<String>,
    /// Latest time reported by the robot.
    now: WorldTime,
    ended: Option<SkillStatus>,
}

impl ActiveSkill {
    /// Ticks the tree once. A skill that has ended keeps its status. A panic in a leaf passes
    /// through.
    pub fn tick(&mut self, actions: &mut dyn RobotActions) -> SkillStatus {
        if let Some(ended) = &self.ended {
            return ended.clone();
        }
        self.update_time(actions);
        let status = match self.tree.tick(actions, self.now) {
            NodeStatus::Running => return SkillStatus::Running,
            NodeStatus::Success | NodeStatus::Skipped => SkillStatus::Succeeded(self.results()),
            NodeStatus::Failure => {
                let found = self.tree.cause();
                let cause = found.map_or("the skill failed without a cause".to_owned(), ToString::to_string);
                let class = found.and_then(|cause| cause.error.as_ref()).map(|error| error.class);
                SkillStatus::Failed { cause, class: class.unwrap_or_default() }
            }
        };
        self.ended = Some(status.clone());
        status
    }

    /// Returns the code of the goal's failure that is the cause of the latest failure of a leaf; `None` if the cause is
    /// another one.
    pub fn failure_code(&self) -> Option<ErrorCode> {
        self.tree.cause()?.error.as_ref().map(|error| error.code)
    }

    fn results(&self) -> BTreeMap<String, Scalar> {
        let value = |name: &String| Some((name.clone(), Scalar::from(self.tree.value(name)?)));
        self.results.iter().filter_map(value).collect()
    }

    /// Halts the skill: its goal is canceled. A later tick starts the skill from the beginning, at
    /// the robot's position then.
    pub fn halt(&mut self, actions: &mut dyn RobotActions) {
        self.update_time(actions);
        self.tree.halt(actions, self.now);
    }

    /// Checks whether the robot has ended every goal that this skill canceled, so that another
    /// skill can send its own.
    pub fn cancels_complete(&self, actions: &dyn RobotActions) -> bool {
        self.tree.cancels_complete(actions)
    }

    fn update_time(&mut self, actions: &dyn RobotActions) {
        if let Some(telemetry) = actions.telemetry() {
            self.now = telemetry.time;
        }
    }
}
