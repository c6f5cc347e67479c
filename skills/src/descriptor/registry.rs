//! The descriptors that a robot has, and pricing a whole local plan with them.

use super::{
    EstimateContext, EstimateError, FixedDuration, NavigationDescriptor, PathDescriptor, RequestedDuration,
    STEP_DURATION_S, SkillDescriptor,
};
use crate::environment::Environment;
use consort_protocol::auction::BidPart;
use consort_protocol::ids::{TaskId, TaskType};
use consort_protocol::mission::TaskSpec;
use consort_protocol::plan::{LocalPlan, Signal, StepAction, StepIndex};
use consort_protocol::units::Seconds;
use std::collections::BTreeMap;

/// Skill descriptors by task type, not yet put into a place.
#[derive(Default)]
pub struct DescriptorRegistry {
    descriptors: BTreeMap<TaskType, Box<dyn SkillDescriptor>>,
    margin_sds: f64,
}

/// Prices local plans, in a place it knows.
pub struct Estimator {
    descriptors: BTreeMap<TaskType, Box<dyn SkillDescriptor>>,
    margin_sds: f64,
    environment: Environment,
    send: TaskType,
    wait: TaskType,
}

/// What a whole plan takes.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanBudget {
    /// The price of every step, messages included, in the order of the plan.
    pub parts: Vec<BidPart>,
    /// The charge to have for all of it, as a share of a full battery: what the steps use by estimate, and as many standard
    /// deviations of that sum more as [`DescriptorRegistry::cautious`] asked for.
    pub energy: f64,
}

/// What one skill's descriptor lacks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MissingRequirement {
    /// The skill.
    pub skill: TaskType,
    /// The kind of environment descriptor.
    pub requires: &'static str,
}

/// The environment lacks what descriptors need. The node cannot start like this.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ResolveError {
    /// Every lack, in the order of the skills' names.
    pub missing: Vec<MissingRequirement>,
    /// What the environment has, in words.
    pub known: String,
}

impl std::fmt::Display for ResolveError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let lacks = self.missing.iter().map(|lack| format!("{} needs `{}`", lack.skill, lack.requires));
        let lacks: Vec<String> = lacks.collect();
        write!(f, "the environment lacks descriptors: {}; it has {}", lacks.join(", "), self.known)
    }
}

impl std::error::Error for ResolveError {}

/// Why a plan cannot be priced.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("step {step} ({task}): {source}")]
pub struct PriceError {
    /// Which step of the plan.
    pub step: StepIndex,
    /// Its task, or the task that its message is about.
    pub task: TaskId,
    /// What is wrong.
    pub source: EstimateError,
}

const SEND: &str = "send_message";
const WAIT: &str = "wait_message";

/// The skills of the standard set that take [`STEP_TIME_S`].
const FIXED: [&str; 11] = [
    "approach_person",
    "authenticate_person",
    "operate_drawer",
    "approach_robot",
    "pick_up",
    "deposit",
    "grasp",
    "dock",
    "undock",
    SEND,
    WAIT,
];

fn own(name: &str) -> TaskType {
    TaskType::new(name).expect("the names of our own skills are slugs")
}

impl DescriptorRegistry {
    /// No descriptors.
    pub fn new() -> DescriptorRegistry {
        DescriptorRegistry::default()
    }

    /// The descriptors of the skills that come with the library, and of the two messages.
    pub fn standard() -> DescriptorRegistry {
        let time = Seconds::new(STEP_DURATION_S).expect("two seconds are a duration");
        let registry = DescriptorRegistry::new()
            .with(NavigationDescriptor::new(own("navigation")))
            .with(PathDescriptor::new(own("follow_path")))
            .with(RequestedDuration::new(own("wait")));
        FIXED.into_iter().fold(registry, |registry, name| registry.with(FixedDuration::new(own(name), time)))
    }

    /// The same descriptors with one more, in place of any for the same task type.
    pub fn with(mut self, descriptor: impl SkillDescriptor + 'static) -> DescriptorRegistry {
        self.descriptors.insert(descriptor.task_type().clone(), Box::new(descriptor));
        self
    }

    /// The same descriptors, with so many standard deviations of a plan's energy kept in reserve. The steps of a plan are
    /// taken to be off independently of one another, so that a long plan needs less of a reserve than its steps one by one.
    /// 1.28 is the 90 % quantile of what a plan takes, where that is about normal. Default 0: the mean.
    pub fn with_energy_margin(self, margin_sds: f64) -> DescriptorRegistry {
        DescriptorRegistry { margin_sds, ..self }
    }

    /// Puts the descriptors into a place, when the node starts.
    ///
    /// # Errors
    /// [`ResolveError`] names every skill and every kind of environment descriptor that it lacks.
    pub fn resolve(self, environment: Environment) -> Result<Estimator, ResolveError> {
        let lacks = self.descriptors.iter().flat_map(|(skill, descriptor)| {
            let lacking = descriptor.required_descriptors().into_iter().filter(|kind| !environment.contains(kind));
            lacking.map(|needs| MissingRequirement { skill: skill.clone(), requires: needs }).collect::<Vec<_>>()
        });
        let missing: Vec<MissingRequirement> = lacks.collect();
        if missing.is_empty() {
            let DescriptorRegistry { descriptors, margin_sds } = self;
            Ok(Estimator { descriptors, margin_sds, environment, send: own(SEND), wait: own(WAIT) })
        } else {
            Err(ResolveError { missing, known: crate::bt::join_names(environment.kinds()) })
        }
    }
}

impl Estimator {
    /// Prices every step of a plan, messages included, in the order of the plan: a robot does one thing at a time.
    ///
    /// # Errors
    /// [`PriceError`] names the first step that cannot be done, and why.
    pub fn price(&self, plan: &LocalPlan, context: &EstimateContext) -> Result<Vec<BidPart>, PriceError> {
        Ok(self.budget(plan, context)?.parts)
    }

    /// The same, and the charge that a robot should have before it promises to carry the plan out.
    ///
    /// # Errors
    /// [`PriceError`] names the first step that cannot be done, and why.
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
            // Whoever has been driven stands at a place.
            context.pose = context.pose.filter(|_| estimate.ends_at == context.place);
            context.place = estimate.ends_at;
        }
        let mean: f64 = parts.iter().map(|part| part.energy).sum();
        Ok(PlanBudget { parts, energy: mean + self.margin_sds * variance.sqrt() })
    }

    /// How many standard deviations of a plan's energy are kept in reserve.
    pub fn margin_sds(&self) -> f64 {
        self.margin_sds
    }

    /// Estimates one task.
    ///
    /// # Errors
    /// [`EstimateError`] when it cannot be done or told, or has no descriptor.
    pub fn estimate(&self, task: &TaskSpec, context: &EstimateContext) -> Result<super::Estimate, EstimateError> {
        match self.descriptors.get(&task.task_type) {
            Some(descriptor) => descriptor.estimate(task, context, &self.environment),
            None => Err(EstimateError::NoDescriptor {
                task_type: task.task_type.clone(),
                known: crate::bt::join_names(self.skills().map(TaskType::as_str)),
            }),
        }
    }

    /// What it can price, in the order of names.
    pub fn skills(&self) -> impl Iterator<Item = &TaskType> {
        self.descriptors.keys()
    }

    /// The place it knows.
    pub fn environment(&self) -> &Environment {
        &self.environment
    }

    fn message<'s>(
        &self,
        skill: &TaskType,
        signal: &'s Signal,
        context: &EstimateContext,
    ) -> (&'s TaskId, Result<super::Estimate, EstimateError>, TaskType, String) {
        let spec = TaskSpec::of(skill.clone(), vec![signal.from.clone()]);
        (&signal.task, self.estimate(&spec, context), skill.clone(), signal.to_string())
    }
}
