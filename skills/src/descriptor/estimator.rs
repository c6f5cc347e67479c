//! From descriptors to the price of a plan.

use super::{Context, EstimateError, FixedTime, Navigation, STEP_TIME, SkillDescriptor};
use crate::environment::{Environment, EnvironmentKind};
use consort_protocol::auction::BidPart;
use consort_protocol::ids::{TaskId, TaskType};
use consort_protocol::plan::{LocalPlan, Signal, StepAction};
use consort_protocol::units::Seconds;
use std::collections::{BTreeMap, BTreeSet};

/// The skill descriptors of an application, by task type.
#[derive(Default)]
pub struct DescriptorRegistry {
    descriptors: BTreeMap<TaskType, Box<dyn SkillDescriptor>>,
}

/// A skill descriptor asks for what the node does not have. Nothing was resolved.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}", .missing.iter().map(|(skill, kinds)| format!("skill {skill} needs {}", list(kinds))).collect::<Vec<_>>().join("; "))]
pub struct ResolveError {
    /// Which skill lacks which environment descriptors.
    pub missing: BTreeMap<TaskType, BTreeSet<EnvironmentKind>>,
}

fn list(kinds: &BTreeSet<EnvironmentKind>) -> String {
    kinds.iter().map(ToString::to_string).collect::<Vec<_>>().join(" and ")
}

/// A plan that cannot be priced; the robot cannot carry it out.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PriceError {
    /// No descriptor for a task.
    #[error("{task}: no estimate for tasks of type {task_type}; there are {known}")]
    NoDescriptor {
        /// The task.
        task: TaskId,
        /// Its type.
        task_type: TaskType,
        /// The types that there are descriptors for.
        known: String,
    },
    /// Its descriptor says that it cannot be done.
    #[error("{task}: {problem}")]
    NotFeasible {
        /// The task.
        task: TaskId,
        /// Why not.
        problem: EstimateError,
    },
}

impl PriceError {
    /// The task that cannot be priced.
    pub fn task(&self) -> &TaskId {
        match self {
            PriceError::NoDescriptor { task, .. } | PriceError::NotFeasible { task, .. } => task,
        }
    }
}

impl DescriptorRegistry {
    /// The descriptors that come with Consort: navigation by routes, all others at a fixed time.
    pub fn hospital() -> DescriptorRegistry {
        let mut registry = DescriptorRegistry::default();
        registry.register(Box::new(Navigation));
        for name in
            ["approach_person", "authenticate_person", "operate_drawer", "approach_robot", "pick_up", "deposit", "wait"]
        {
            registry.register(Box::new(FixedTime::of(TaskType::new(name).expect("a slug"))));
        }
        registry
    }

    /// Adds a descriptor; a former one for the same task type gives way.
    pub fn register(&mut self, descriptor: Box<dyn SkillDescriptor>) {
        self.descriptors.insert(descriptor.task_type(), descriptor);
    }

    /// Checks that the environment has all that the descriptors need.
    ///
    /// # Errors
    /// [`ResolveError`] names each skill and what it lacks.
    pub fn resolve(self, environment: Environment) -> Result<Estimator, ResolveError> {
        let there = environment.kinds();
        let lacks = |(skill, descriptor): (&TaskType, &Box<dyn SkillDescriptor>)| {
            let kinds: BTreeSet<_> = descriptor.needs().iter().filter(|kind| !there.contains(kind)).copied().collect();
            (!kinds.is_empty()).then(|| (skill.clone(), kinds))
        };
        let missing: BTreeMap<_, _> = self.descriptors.iter().filter_map(lacks).collect();
        if missing.is_empty() {
            Ok(Estimator { descriptors: self.descriptors, environment })
        } else {
            Err(ResolveError { missing })
        }
    }
}

/// Prices local plans.
pub struct Estimator {
    descriptors: BTreeMap<TaskType, Box<dyn SkillDescriptor>>,
    environment: Environment,
}

impl Estimator {
    /// What each step costs, in the order of the plan. Messages take [`STEP_TIME`] each, as in the published evaluation;
    /// the tasks cost what their descriptors say, each beginning where the former ends.
    ///
    /// # Errors
    /// [`PriceError`] for the first task that cannot be done.
    pub fn price(&self, plan: &LocalPlan, context: &Context) -> Result<Vec<BidPart>, PriceError> {
        let mut context = context.clone();
        let mut parts = Vec::with_capacity(plan.steps.len());
        for (step, action) in (0..).zip(plan.steps.iter().map(|step| &step.action)) {
            parts.push(match action {
                StepAction::Task { id, spec } => {
                    let descriptor =
                        self.descriptors.get(&spec.task_type).ok_or_else(|| self.unknown(id, &spec.task_type))?;
                    let estimate = descriptor
                        .estimate(spec, &context, &self.environment)
                        .map_err(|problem| PriceError::NotFeasible { task: id.clone(), problem })?;
                    context.place = estimate.place;
                    let (skill, time, energy) = (spec.task_type.clone(), estimate.time, estimate.energy);
                    BidPart { step, label: id.to_string(), skill, time, energy }
                }
                StepAction::Send(signal) => message(step, "send_message", signal, &context),
                StepAction::Wait(signal) => message(step, "wait_message", signal, &context),
            });
        }
        Ok(parts)
    }

    fn unknown(&self, task: &TaskId, task_type: &TaskType) -> PriceError {
        let known = self.descriptors.keys().map(TaskType::as_str).collect::<Vec<_>>().join(", ");
        PriceError::NoDescriptor { task: task.clone(), task_type: task_type.clone(), known }
    }
}

fn message(step: u32, skill: &str, signal: &Signal, context: &Context) -> BidPart {
    let time = Seconds::new(STEP_TIME).expect("a constant above 0");
    let skill = TaskType::new(skill).expect("a slug");
    BidPart { step, label: signal.to_string(), skill, time, energy: context.discharge.over(time) }
}
