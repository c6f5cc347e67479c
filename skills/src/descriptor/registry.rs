//! The descriptors of a robot, and the pricing of local plans with them.

use super::estimate::{Estimate, EstimateContext, EstimateError, SkillDescriptor};
use super::fixed::{FixedDuration, STEP_DURATION_S};
use crate::environment::Environment;
use crate::names::join_names;
use consort_protocol::auction::BidPart;
use consort_protocol::ids::{PlaceId, TaskId, TaskType};
use consort_protocol::mission::TaskSpec;
use consort_protocol::plan::{LocalPlan, Signal, StepAction, StepIndex};
use consort_protocol::units::Seconds;
use std::collections::BTreeMap;

/// Skill descriptors by task type, before they are combined with an environment.
#[derive(Default)]
pub struct DescriptorRegistry {
    descriptors: BTreeMap<TaskType, Box<dyn SkillDescriptor>>,
    margin_sds: f64,
}

/// Prices local plans in an environment.
pub struct Estimator {
    descriptors: BTreeMap<TaskType, Box<dyn SkillDescriptor>>,
    margin_sds: f64,
    environment: Environment,
    send: TaskType,
    wait: TaskType,
}

/// Cost of a whole plan.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanBudget {
    /// The price of every step, messages included, in the order of the plan.
    pub parts: Vec<BidPart>,
    /// Required charge as a share of a full battery: the estimated energy of all steps, plus the
    /// standard deviations of that sum that `DescriptorRegistry::with_energy_margin` sets.
    pub energy: f64,
    /// Place at which the plan ends.
    pub ends_at: PlaceId,
}

/// An environment descriptor that a skill lacks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MissingRequirement {
    /// The skill.
    pub skill: TaskType,
    /// The kind of environment descriptor.
    pub requires: &'static str,
}

/// The environment lacks descriptors. The node cannot start.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ResolveError {
    /// All missing descriptors, in the order of the skills' names.
    pub missing: Vec<MissingRequirement>,
    /// The descriptors of the environment, as text.
    pub known: String,
}

impl std::fmt::Display for ResolveError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let missing_descriptors =
            self.missing.iter().map(|missing| format!("{} needs `{}`", missing.skill, missing.requires));
        let missing_descriptors: Vec<String> = missing_descriptors.collect();
        write!(f, "the environment lacks descriptors: {}; it has {}", missing_descriptors.join(", "), self.known)
    }
}

impl std::error::Error for ResolveError {}

/// A plan cannot be priced.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("step {step} ({task}): {source}")]
pub struct PriceError {
    /// The step of the plan.
    pub step: StepIndex,
    /// Its task, or the task of its message.
    pub task: TaskId,
    /// Cause.
    pub source: EstimateError,
}

/// Version of this program's estimators, as nodes publish it. It changes with the estimators'
/// results, and not with each release: bids of two releases in a fleet must be comparable.
pub const ESTIMATOR_VERSION: &str = "standard-1";

const SEND: &str = "send_message";
const WAIT: &str = "wait_message";

fn task_type_named(name: &str) -> TaskType {
    TaskType::new(name).expect("names of standard skills are slugs")
}

impl DescriptorRegistry {
    /// Creates an empty registry.
    pub fn new() -> DescriptorRegistry {
        DescriptorRegistry::default()
    }

    /// Creates the descriptors of the two message steps.
    pub(crate) fn of_messages() -> DescriptorRegistry {
        let time = Seconds::new(STEP_DURATION_S).expect("two seconds are a duration");
        let messages = [SEND, WAIT].map(|name| FixedDuration::new(task_type_named(name), time));
        messages.into_iter().fold(DescriptorRegistry::new(), DescriptorRegistry::with)
    }

    /// Adds a descriptor, replacing any for the same task type.
    pub fn with(mut self, descriptor: impl SkillDescriptor + 'static) -> DescriptorRegistry {
        self.descriptors.insert(descriptor.task_type().clone(), Box::new(descriptor));
        self
    }

    /// Returns the multiple of a robot's discharge rate at which the tasks of each type use energy, for the types
    /// whose energy follows from their duration.
    pub fn discharge_multiples(&self) -> BTreeMap<TaskType, f64> {
        let descriptors = self.descriptors.iter();
        descriptors.filter_map(|(skill, each)| Some((skill.clone(), each.discharge_multiple()?))).collect()
    }

    /// Replaces each descriptor.
    pub(super) fn map(
        mut self,
        replace: impl Fn(Box<dyn SkillDescriptor>) -> Box<dyn SkillDescriptor>,
    ) -> DescriptorRegistry {
        let replaced = self.descriptors.into_iter().map(|(name, descriptor)| (name, replace(descriptor)));
        self.descriptors = replaced.collect();
        self
    }

    /// Sets an energy reserve in standard deviations of a plan's energy. The errors of a plan's
    /// steps are assumed to be independent, so a long plan needs less reserve than its steps
    /// separately. 1.28 is the 90 % quantile of a plan's energy if it is about normally
    /// distributed. Default: 0, the mean.
    pub(crate) fn with_energy_margin(self, margin_sds: f64) -> DescriptorRegistry {
        DescriptorRegistry { margin_sds, ..self }
    }

    /// Combines the descriptors with an environment, when the node starts.
    ///
    /// # Errors
    /// [`ResolveError`] with every skill and every kind of environment descriptor that is missing.
    pub fn resolve(self, environment: Environment) -> Result<Estimator, ResolveError> {
        let missing_descriptors = self.descriptors.iter().flat_map(|(skill, descriptor)| {
            let missing_kinds =
                descriptor.required_descriptors().into_iter().filter(|kind| !environment.contains(kind));
            missing_kinds.map(|needs| MissingRequirement { skill: skill.clone(), requires: needs }).collect::<Vec<_>>()
        });
        let missing: Vec<MissingRequirement> = missing_descriptors.collect();
        if missing.is_empty() {
            let DescriptorRegistry { descriptors, margin_sds } = self;
            Ok(Estimator {
                descriptors,
                margin_sds,
                environment,
                send: task_type_named(SEND),
                wait: task_type_named(WAIT),
            })
        } else {
            Err(ResolveError { missing, known: join_names(environment.kinds()) })
        }
    }
}

impl PlanBudget {
    /// Returns the time of the whole plan.
    pub fn time(&self) -> Seconds {
        self.parts.iter().map(|part| part.time).sum()
    }
}

impl Estimator {
    /// Prices every step of a plan, messages included, in the order of the plan: a robot executes a
    /// single step at a time.
    ///
    /// # Errors
    /// [`PriceError`] for the first impossible step.
    pub fn price(&self, plan: &LocalPlan, context: &EstimateContext) -> Result<Vec<BidPart>, PriceError> {
        Ok(self.budget(plan, context)?.parts)
    }

    /// Prices every step of a plan, and computes the charge that a robot should have before it
    /// commits to the plan.
    ///
    /// # Errors
    /// [`PriceError`] for the first impossible step.
    pub fn budget(&self, plan: &LocalPlan, context: &EstimateContext) -> Result<PlanBudget, PriceError> {
        let mut context = context.clone();
        let mut parts = Vec::with_capacity(plan.steps.len());
        let mut variance = 0.0;
        for (step, each) in (0..).zip(&plan.steps) {
            let (task, estimate, skill, label) = match &each.action {
                StepAction::Task { id, spec } => {
                    (id, self.estimate(spec, &context), spec.task_type.clone(), id.as_str().to_owned())
                }
                StepAction::Send(signal) => self.message(&self.send, signal, &context),
                StepAction::Wait(signal) => self.message(&self.wait, signal, &context),
            };
            let estimate = estimate.map_err(|source| PriceError { step, task: task.clone(), source })?;
            parts.push(BidPart { step, label, skill, time: estimate.time, energy: estimate.energy });
            variance += estimate.energy_sd * estimate.energy_sd;
            // After a drive the robot stands at a place.
            context.pose = context.pose.filter(|_| estimate.ends_at == context.place);
            context.place = estimate.ends_at;
        }
        let mean: f64 = parts.iter().map(|part| part.energy).sum();
        Ok(PlanBudget { parts, energy: mean + self.margin_sds * variance.sqrt(), ends_at: context.place })
    }

    /// Energy reserve in standard deviations of a plan's energy.
    pub fn margin_sds(&self) -> f64 {
        self.margin_sds
    }

    /// Returns the destination of a task that is a drive to a place and nothing else.
    pub fn destination(&self, task: &TaskSpec) -> Option<PlaceId> {
        let parameter = self.descriptors.get(&task.task_type)?.destination()?;
        task.parameters.get(parameter)?.parse().ok()
    }

    /// Checks whether the estimates of a plan on shorter routes are lower bounds.
    pub fn grows_with_drives(&self, plan: &LocalPlan) -> bool {
        let grows = |spec: &TaskSpec| self.descriptors.get(&spec.task_type).is_some_and(|it| it.grows_with_drives());
        plan.tasks().all(|(_, spec)| grows(spec))
    }

    /// Estimates a task.
    ///
    /// # Errors
    /// [`EstimateError`] if the task is impossible, cannot be estimated, or has no descriptor.
    pub fn estimate(&self, task: &TaskSpec, context: &EstimateContext) -> Result<Estimate, EstimateError> {
        match self.descriptors.get(&task.task_type) {
            Some(descriptor) => descriptor.estimate(task, context, &self.environment),
            None => Err(EstimateError::NoDescriptor {
                task_type: task.task_type.clone(),
                known: join_names(self.skills().map(TaskType::as_str)),
            }),
        }
    }

    /// The task types with descriptors, in the order of their names.
    pub fn skills(&self) -> impl Iterator<Item = &TaskType> {
        self.descriptors.keys()
    }

    /// The environment.
    pub fn environment(&self) -> &Environment {
        &self.environment
    }

    fn message<'s>(
        &self,
        skill: &TaskType,
        signal: &'s Signal,
        context: &EstimateContext,
    ) -> (&'s TaskId, Result<Estimate, EstimateError>, TaskType, String) {
        let spec = TaskSpec::of(skill.clone(), vec![signal.from.clone()]);
        (&signal.task, self.estimate(&spec, context), skill.clone(), signal.to_string())
    }
}
