//! Skill descriptors: what a task costs a robot (thesis 3.5, the estimating manager).
//!
//! Each prices one task type in a [`Context`]; where one task ends the next begins, so the [`Estimator`] prices a whole
//! local plan by handing the context on from step to step.

mod estimator;
mod fixed;
mod navigation;

pub use estimator::{DescriptorRegistry, Estimator, PriceError, ResolveError};
pub use fixed::{FixedTime, STEP_TIME};
pub use navigation::Navigation;

use crate::environment::{Environment, EnvironmentKind, NoRoute};
use consort_protocol::ids::{PlaceId, TaskType};
use consort_protocol::mission::TaskSpec;
use consort_protocol::units::{MetresPerSecond, Seconds, SharePerSecond};

/// The circumstances in which a robot would begin a task.
#[derive(Debug, Clone, PartialEq)]
pub struct Context {
    /// Where it would be.
    pub place: PlaceId,
    /// Its average speed.
    pub speed: MetresPerSecond,
    /// How fast work empties its battery.
    pub discharge: SharePerSecond,
}

/// What a task costs.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// How long it takes.
    pub time: Seconds,
    /// Charge it uses, as a share of a full battery. It may exceed 1.
    pub energy: f64,
    /// Where the robot is afterwards.
    pub place: PlaceId,
}

/// Why a task cannot be priced; then the robot cannot do it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum EstimateError {
    /// The mission leaves out what the skill needs to know.
    #[error("parameter `{parameter}` is missing")]
    Missing {
        /// Its name.
        parameter: &'static str,
    },
    /// The mission says something that the skill cannot use.
    #[error("parameter `{parameter}`: {problem}")]
    Parameter {
        /// Its name.
        parameter: &'static str,
        /// What is wrong with it.
        problem: String,
    },
    /// No way to get there.
    #[error(transparent)]
    NoRoute(#[from] NoRoute),
}

/// Prices the tasks of one type.
pub trait SkillDescriptor: Send + Sync {
    /// The task type.
    fn task_type(&self) -> TaskType;

    /// The environment descriptors it asks when it prices.
    fn needs(&self) -> &[EnvironmentKind] {
        &[]
    }

    /// What the task would cost. Only called with an environment that has all that it [`needs`](Self::needs).
    ///
    /// # Errors
    /// [`EstimateError`]: the robot cannot do it.
    fn estimate(
        &self,
        task: &TaskSpec,
        context: &Context,
        environment: &Environment,
    ) -> Result<Estimate, EstimateError>;
}
