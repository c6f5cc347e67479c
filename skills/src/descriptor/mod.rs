//! Skill descriptors: what a task would cost a robot, estimated by the robot itself (thesis 3.5.1).
//!
//! ```text
//!  DescriptorRegistry ──resolve(Environment)──▶ Estimator ──price(LocalPlan, Context)──▶ one BidPart per step
//! ```
//!
//! Tasks are chained: where one ends, the next begins. A descriptor may say how far off its estimate of energy may be; a
//! [cautious](DescriptorRegistry::cautious) robot then bids only if its battery lasts in all but the worst cases.
//!
//! ```
//! use consort_protocol::mission::TaskSpec;
//! use consort_protocol::units::{MetresPerSecond, Seconds, SharePerSecond};
//! use consort_skills::descriptor::{Context, DescriptorRegistry, FixedTime};
//! use consort_skills::environment::Environment;
//!
//! let estimator = DescriptorRegistry::new()
//!     .with(FixedTime::new("wave".parse()?, Seconds::new(4.0)?))
//!     .resolve(Environment::new())?;
//! let robot = Context {
//!     place: "Dock".parse()?,
//!     pose: None,
//!     speed: MetresPerSecond::new(0.5)?,
//!     discharge: SharePerSecond::new(0.001)?,
//!     closed: vec![],
//! };
//! let estimate = estimator.estimate(&TaskSpec::of("wave".parse()?, vec!["r1".parse()?]), &robot)?;
//! assert_eq!((estimate.time.get(), estimate.energy), (4.0, 0.004));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod fixed;
mod navigation;
mod path;
mod registry;

pub use fixed::{FixedDuration, RequestedDuration, STEP_DURATION_S};
pub use navigation::NavigationDescriptor;
pub use path::PathDescriptor;
pub use registry::{DescriptorRegistry, Estimator, MissingRequirement, PlanBudget, PriceError, ResolveError};

use crate::environment::{Environment, MissingDescriptor, RouteError};
use consort_protocol::ids::{PlaceId, TaskType};
use consort_protocol::mission::TaskSpec;
use consort_protocol::pose::Pose;
use consort_protocol::units::{MetresPerSecond, Seconds, SharePerSecond};

/// The robot that estimates, as it is when the task begins.
#[derive(Debug, Clone, PartialEq)]
pub struct EstimateContext {
    /// Where it is, or the place it passed last.
    pub place: PlaceId,
    /// Where exactly, for one that may be between two places; `None` at the place.
    pub pose: Option<Pose>,
    /// How fast it drives on average.
    pub speed: MetresPerSecond,
    /// How fast it empties its battery at work.
    pub discharge: SharePerSecond,
    /// The ways that it knows to be closed, each by its two ends.
    pub closed: Vec<(PlaceId, PlaceId)>,
}

/// What a task would cost.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// How long it takes.
    pub time: Seconds,
    /// Charge it uses, as a share of a full battery. It may exceed 1.
    pub energy: f64,
    /// How far that may be off: the standard deviation of what it turns out to be; 0 where nobody has looked.
    pub energy_sd: f64,
    /// Where it ends.
    pub ends_at: PlaceId,
}

impl Estimate {
    /// A task that takes this long at the robot's usual discharge, and ends at `place`.
    pub fn of_duration(time: Seconds, context: &EstimateContext, place: PlaceId) -> Estimate {
        Estimate { time, energy: context.discharge.over(time), energy_sd: 0.0, ends_at: place }
    }
}

/// Why a task cannot be estimated: the robot cannot bid for its role.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EstimateError {
    /// The task does not say what the estimate needs to know.
    #[error("the {task_type} task has no parameter `{parameter}`")]
    MissingParameter {
        /// The kind of task.
        task_type: TaskType,
        /// What it lacks.
        parameter: &'static str,
    },
    /// What the task says makes no sense.
    #[error("the {task_type} task has `{parameter}` = {value:?}: {problem}")]
    Parameter {
        /// The kind of task.
        task_type: TaskType,
        /// The parameter.
        parameter: &'static str,
        /// Its value.
        value: String,
        /// What is wrong with it.
        problem: String,
    },
    /// There is no way to where the task is.
    #[error(transparent)]
    Route(#[from] RouteError),
    /// The environment lacks what the estimate needs.
    #[error(transparent)]
    Environment(#[from] MissingDescriptor),
    /// Nobody can estimate such a task.
    #[error("no skill descriptor for {task_type}; there are some for {known}")]
    NoDescriptor {
        /// The kind of task.
        task_type: TaskType,
        /// What there is, in words.
        known: String,
    },
}

/// Estimates tasks of one type.
pub trait SkillDescriptor: Send + Sync {
    /// The type of task it estimates, which is also the skill's name.
    fn task_type(&self) -> &TaskType;

    /// The kinds of environment descriptor it needs: [`EnvironmentDescriptor::KIND`].
    ///
    /// [`EnvironmentDescriptor::KIND`]: crate::environment::EnvironmentDescriptor::KIND
    fn required_descriptors(&self) -> Vec<&'static str>;

    /// What `task` would cost the robot of `context`.
    ///
    /// # Errors
    /// [`EstimateError`] when it cannot be done or told; never a price of nothing.
    fn estimate(
        &self,
        task: &TaskSpec,
        context: &EstimateContext,
        environment: &Environment,
    ) -> Result<Estimate, EstimateError>;
}

/// A parameter that the estimate cannot do without.
fn parameter<'t>(task: &'t TaskSpec, name: &'static str) -> Result<&'t str, EstimateError> {
    let missing = || EstimateError::MissingParameter { task_type: task.task_type.clone(), parameter: name };
    task.parameters.get(name).map(String::as_str).ok_or_else(missing)
}

/// A parameter taken as something else than text.
fn parsed<T, E: ToString>(
    task: &TaskSpec,
    name: &'static str,
    parse: impl FnOnce(&str) -> Result<T, E>,
) -> Result<T, EstimateError> {
    let value = parameter(task, name)?;
    parse(value).map_err(|error| EstimateError::Parameter {
        task_type: task.task_type.clone(),
        parameter: name,
        value: value.to_owned(),
        problem: error.to_string(),
    })
}

#[cfg(test)]
mod tests;
