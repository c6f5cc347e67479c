//! The skill library: by task type, the tree that realises it.
//!
//! ```
//! use consort_protocol::ids::TaskType;
//! use consort_protocol::mission::TaskSpec;
//! use consort_skills::actions::{Goal, GoalId, GoalStatus, RobotActions, Telemetry};
//! use consort_skills::environment::Environment;
//! use consort_skills::library::{SkillContext, SkillLibrary, SkillStatus};
//!
//! /// A body that does at once what it is told.
//! #[derive(Default)]
//! struct Quick(Vec<Goal>);
//!
//! impl RobotActions for Quick {
//!     fn send_goal(&mut self, goal: Goal) -> GoalId {
//!         self.0.push(goal);
//!         GoalId(self.0.len() as u64)
//!     }
//!     fn status(&self, _: GoalId) -> Option<GoalStatus> {
//!         Some(GoalStatus::Succeeded)
//!     }
//!     fn cancel(&mut self, _: GoalId) {}
//!     fn telemetry(&self) -> Option<&Telemetry> {
//!         None
//!     }
//! }
//!
//! let library = SkillLibrary::standard(Environment::new());
//! let mut task = TaskSpec::of(TaskType::new("operate_drawer")?, vec!["r1".parse()?]);
//! let wrong = library.load(&task, &SkillContext::default()).err().map(|error| error.to_string());
//! assert!(wrong.is_some_and(|error| error.starts_with("operate_drawer needs the parameter `action`")));
//!
//! task.parameters.insert("action".to_owned(), "open".to_owned());
//! let mut skill = library.load(&task, &SkillContext::default())?;
//! let mut body = Quick::default();
//! while skill.tick(&mut body) == SkillStatus::Running {}
//! assert_eq!(body.0, [Goal::OperateDrawer { open: true }]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use crate::actions::RobotActions;
use crate::bt::xml::read_xml;
use crate::bt::{
    BlackboardError, Blueprint, NodeStatus, PortType, Registry, RegistryError, Tree, TreeError, TreeInput, TreeSpec,
    Value, join_names,
};
use crate::environment::Environment;
use crate::skill::{STANDARD_SKILLS, TaskContext, register_shared_leaves};
use consort_protocol::ids::{RobotId, RoleId, TaskType};
use consort_protocol::mission::TaskSpec;
use consort_protocol::units::WorldTime;
use std::collections::BTreeMap;

/// What a skill is told of the mission when it is started.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SkillContext {
    /// Who holds the managed roles, this robot included.
    pub holders: BTreeMap<RoleId, RobotId>,
}

/// Skills by task type. Built once when a node starts, then shared.
pub struct SkillLibrary {
    environment: Environment,
    registry: Registry<TaskContext>,
    skills: BTreeMap<TaskType, Blueprint<TaskContext>>,
}

/// Why a skill cannot be started. The body was not asked for anything.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SkillError {
    /// Nothing realises such tasks.
    #[error("there is no skill for {task_type}; there are some for {known}")]
    NoSkill {
        /// The kind of task.
        task_type: TaskType,
        /// What there is, in words.
        known: String,
    },
    /// The task does not say what the skill needs to know.
    #[error("{task_type} needs the parameter `{parameter}` ({wanted}); the task gives {given}")]
    MissingParameter {
        /// The kind of task.
        task_type: TaskType,
        /// What it lacks.
        parameter: String,
        /// What would do.
        wanted: PortType,
        /// The parameters that it gives, in words.
        given: String,
    },
    /// A parameter is not what the skill takes.
    #[error("{task_type}: {source}")]
    Parameter {
        /// The kind of task.
        task_type: TaskType,
        /// What is wrong, and what is allowed.
        source: BlackboardError,
    },
}

impl SkillLibrary {
    /// A library without skills, whose leaves know this place.
    pub fn empty(environment: Environment) -> SkillLibrary {
        SkillLibrary { environment, registry: Registry::new(), skills: BTreeMap::new() }
    }

    /// The skills that come with Consort, in this place.
    pub fn standard(environment: Environment) -> SkillLibrary {
        let mut library = SkillLibrary::empty(environment);
        let own = "the leaves of our own skills have names of their own";
        register_shared_leaves(&mut library.registry).expect(own);
        for skill in &STANDARD_SKILLS {
            (skill.register_leaves)(&mut library.registry).expect(own);
        }
        for (task_type, tree) in SkillLibrary::standard_trees() {
            library.register(task_type, &tree).expect("our own trees load");
        }
        library
    }

    /// The trees of the skills that come with Consort, by task type: to build others on.
    pub fn standard_trees() -> BTreeMap<TaskType, TreeSpec> {
        let tree = |skill: &crate::skill::StandardSkill| {
            let task_type = TaskType::new(skill.task_type).expect("the names of our own skills are slugs");
            (task_type, read_xml(&format!("{}.xml", skill.task_type), skill.xml).expect("our own trees load"))
        };
        STANDARD_SKILLS.iter().map(tree).collect()
    }

    /// Adds a skill, in place of any for the same task type. The task's parameters are set on the keys of the main
    /// tree that bear their names; a key that the tree reads and nothing writes is a parameter the task must have.
    ///
    /// # Errors
    /// [`TreeError`] where the tree has a mistake; the library is unchanged.
    pub fn register(&mut self, task_type: TaskType, tree: &TreeSpec) -> Result<(), TreeError> {
        let blueprint = self.registry.check(tree)?;
        self.skills.insert(task_type, blueprint);
        Ok(())
    }

    /// Adds a skill from a file's text; `source` names the file in messages.
    ///
    /// # Errors
    /// [`TreeError`] as for [`register`](SkillLibrary::register), or where the text is not a tree file.
    pub fn register_xml(&mut self, task_type: TaskType, source: &str, xml: &str) -> Result<(), TreeError> {
        self.register(task_type, &read_xml(source, xml)?)
    }

    /// Adds leaves for trees that are registered afterwards.
    ///
    /// # Errors
    /// [`RegistryError`] as `add` gives it.
    pub fn extend(
        &mut self,
        add: impl FnOnce(&mut Registry<TaskContext>) -> Result<(), RegistryError>,
    ) -> Result<(), RegistryError> {
        add(&mut self.registry)
    }

    /// The leaves there are.
    pub fn registry(&self) -> &Registry<TaskContext> {
        &self.registry
    }

    /// The task types there are skills for, in the order of their names.
    pub fn task_types(&self) -> impl Iterator<Item = &TaskType> {
        self.skills.keys()
    }

    /// The parameters that tasks of a type may or must have; `None` where there is no skill for it.
    pub fn parameters(&self, task_type: &TaskType) -> Option<&[TreeInput]> {
        self.skills.get(task_type).map(Blueprint::inputs)
    }

    /// Makes a skill ready for a task. Parameters that its tree does not name are left aside: they are for others.
    ///
    /// # Errors
    /// [`SkillError`] where there is no such skill, or the task's parameters are not what it takes.
    pub fn load(&self, task: &TaskSpec, context: &SkillContext) -> Result<ActiveSkill, SkillError> {
        let task_type = &task.task_type;
        let Some(blueprint) = self.skills.get(task_type) else {
            let known = join_names(self.task_types().map(TaskType::as_str));
            return Err(SkillError::NoSkill { task_type: task_type.clone(), known });
        };
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
        Ok(ActiveSkill { tree, now: WorldTime::ZERO, ended: None })
    }
}

/// How far a skill has come.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SkillStatus {
    /// Tick again: when something is heard of the body, and at [`ActiveSkill::wake_at`].
    Running,
    /// The task is done.
    Succeeded,
    /// The task is not done, and will not be.
    Failed {
        /// Why, for people: the leaf that failed last, and the body's own words where there are any.
        cause: String,
    },
}

/// A skill at work on one task.
pub struct ActiveSkill {
    tree: Tree,
    /// The body's latest time.
    now: WorldTime,
    ended: Option<SkillStatus>,
}

impl ActiveSkill {
    /// Passes control to the tree once. A skill that has ended stays ended. A panic in a leaf passes through.
    pub fn tick(&mut self, actions: &mut dyn RobotActions) -> SkillStatus {
        if let Some(ended) = &self.ended {
            return ended.clone();
        }
        self.look(actions);
        let status = match self.tree.tick(actions, self.now) {
            NodeStatus::Running => return SkillStatus::Running,
            NodeStatus::Success => SkillStatus::Succeeded,
            NodeStatus::Failure => {
                let cause = self.tree.cause().map_or("it failed without a cause".to_owned(), ToString::to_string);
                SkillStatus::Failed { cause }
            }
        };
        self.ended = Some(status.clone());
        status
    }

    /// Stops what is under way: its goal is canceled. A later tick starts the skill afresh from where the body is then.
    pub fn halt(&mut self, actions: &mut dyn RobotActions) {
        self.look(actions);
        self.tree.halt(actions, self.now);
    }

    /// When the skill asks to be ticked even if nothing is heard of the body before; set by the latest tick.
    pub fn wake_at(&self) -> Option<WorldTime> {
        self.tree.wake_at()
    }

    /// Whether the body has let go of every goal that this skill canceled, so that another skill can send its own.
    pub fn cancels_complete(&self, actions: &dyn RobotActions) -> bool {
        self.tree.cancels_complete(actions)
    }

    fn look(&mut self, actions: &dyn RobotActions) {
        if let Some(telemetry) = actions.telemetry() {
            self.now = telemetry.time;
        }
    }
}
