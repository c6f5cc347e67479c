//! Estimates of tasks, and the interface of the descriptors that make them.

use crate::environment::{Environment, MissingDescriptor, RouteError, SpeedLimits};
use consort_protocol::ids::{PlaceId, TaskType};
use consort_protocol::knowledge::Attributes;
use consort_protocol::mission::{OtherDomain, TaskSpec};
use consort_protocol::pose::Pose;
use consort_protocol::scalar::Scalar;
use consort_protocol::units::{MetresPerSecond, Seconds, SharePerSecond};
use std::collections::BTreeMap;

/// State of the estimating robot at the start of the task.
#[derive(Debug, Clone, PartialEq)]
pub struct EstimateContext {
    /// Current place, or the last place passed.
    pub place: PlaceId,
    /// Exact pose, if the robot may be between two places; `None` at the place.
    pub pose: Option<Pose>,
    /// Average speed.
    pub speed: MetresPerSecond,
    /// Discharge rate with an active goal.
    pub discharge: SharePerSecond,
    /// Known closed lanes, each by its two ends; a place twice is a closed place.
    pub closed: Vec<(PlaceId, PlaceId)>,
    /// Speed limits of people.
    pub limits: SpeedLimits,
    /// Attributes of the robot.
    pub attributes: Attributes,
    /// Latest readings of its driver, by name. `None` where they do not count: the robot has the task already, or its
    /// driver is not known.
    pub readings: Option<BTreeMap<String, Scalar>>,
}

impl EstimateContext {
    /// Returns a robot at a place of an open map, without attributes.
    pub fn at(place: PlaceId, speed: MetresPerSecond, discharge: SharePerSecond) -> EstimateContext {
        EstimateContext {
            place,
            pose: None,
            speed,
            discharge,
            closed: vec![],
            limits: SpeedLimits::default(),
            attributes: Attributes::default(),
            readings: None,
        }
    }
}

/// Estimated cost of a task.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Duration.
    pub time: Seconds,
    /// Energy, as a share of a full battery. It may exceed 1.
    pub energy: f64,
    /// Standard deviation of the energy; 0 if it is not known.
    pub energy_sd: f64,
    /// Place at the end of the task.
    pub ends_at: PlaceId,
}

impl Estimate {
    /// Creates an estimate from a duration at the robot's usual discharge rate, ending at `place`.
    pub fn of_duration(time: Seconds, context: &EstimateContext, place: PlaceId) -> Estimate {
        Estimate { time, energy: context.discharge.over(time), energy_sd: 0.0, ends_at: place }
    }
}

/// A task cannot be estimated, so the robot cannot bid for its role.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EstimateError {
    /// The task lacks a parameter that the estimate needs.
    #[error("the {task_type} task has no parameter `{parameter}`")]
    MissingParameter {
        /// The type of the task.
        task_type: TaskType,
        /// The missing parameter.
        parameter: String,
    },
    /// A parameter of the task is invalid.
    #[error("the {task_type} task has `{parameter}` = {value:?}: {problem}")]
    Parameter {
        /// The type of the task.
        task_type: TaskType,
        /// The parameter.
        parameter: String,
        /// Its value.
        value: String,
        /// Cause.
        problem: String,
    },
    /// An expression of a domain file has no valid value.
    #[error("the estimate of {task_type}: {problem}")]
    Expression {
        /// The type of the task.
        task_type: TaskType,
        /// Cause.
        problem: String,
    },
    /// The robot lacks what the task needs, according to the domain file.
    #[error("{task_type} requires `{condition}`, which {problem}")]
    Requirement {
        /// The type of the task.
        task_type: TaskType,
        /// The condition.
        condition: String,
        /// `is false`, or the reason for which it has no value.
        problem: String,
        /// True if the readings of the robot, which may change, decide about the condition.
        may_change: bool,
    },
    /// The task was made with another content of the domain file.
    #[error(transparent)]
    OtherDomain(#[from] OtherDomain),
    /// There is no route to the place of the task.
    #[error(transparent)]
    Route(#[from] RouteError),
    /// The environment lacks a descriptor that the estimate needs.
    #[error(transparent)]
    Environment(#[from] MissingDescriptor),
    /// No skill descriptor exists for the task type.
    #[error("no skill descriptor for {task_type}; descriptors exist for {known}")]
    NoDescriptor {
        /// The type of the task.
        task_type: TaskType,
        /// The task types with descriptors, as text.
        known: String,
    },
}

/// Estimates the tasks of a type.
pub trait SkillDescriptor: Send + Sync {
    /// The estimated task type, which is also the skill's name.
    fn task_type(&self) -> &TaskType;

    /// The required kinds of environment descriptor: [`EnvironmentDescriptor::KIND`].
    ///
    /// [`EnvironmentDescriptor::KIND`]: crate::environment::EnvironmentDescriptor::KIND
    fn required_descriptors(&self) -> Vec<&'static str>;

    /// Checks whether a task states its own duration, so that no calibration corrects it.
    fn is_given(&self) -> bool {
        false
    }

    /// Returns the parameter with the destination, if a task is a drive to a place and nothing else.
    fn destination(&self) -> Option<&str> {
        None
    }

    /// Checks whether the task is possible after a shorter drive too, and costs no more then. An estimate on the shortest routes is then
    /// a lower bound; auctions of large fleets ask all robots that may do other tasks.
    fn grows_with_drives(&self) -> bool {
        false
    }

    /// Returns the multiple of the robot's discharge rate at which a task uses energy; `None` if the energy does not
    /// follow from the duration.
    fn discharge_multiple(&self) -> Option<f64> {
        Some(1.0)
    }

    /// Estimates the cost of `task` for the robot of `context`.
    ///
    /// # Errors
    /// [`EstimateError`] if the task is impossible or cannot be estimated; never an estimate of
    /// zero instead.
    fn estimate(
        &self,
        task: &TaskSpec,
        context: &EstimateContext,
        environment: &Environment,
    ) -> Result<Estimate, EstimateError>;
}
