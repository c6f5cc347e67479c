//! Tasks with a duration that does not depend on the robot's position.

use super::estimate::{Estimate, EstimateContext, EstimateError, SkillDescriptor, parsed};
use crate::environment::Environment;
use consort_protocol::ids::TaskType;
use consort_protocol::mission::TaskSpec;
use consort_protocol::units::{Seconds, UnitError};
use std::num::ParseFloatError;

/// Duration in seconds of any step that is not a drive, messages included: the figure of the
/// published evaluation (replication package of the JSS 2022 article; thesis 4).
pub(super) const STEP_DURATION_S: f64 = 2.0;

/// A task with a fixed duration, at the robot's position.
#[derive(Debug, Clone)]
pub struct FixedDuration {
    task_type: TaskType,
    time: Seconds,
}

impl FixedDuration {
    /// Creates the descriptor of a task type.
    pub fn new(task_type: TaskType, time: Seconds) -> FixedDuration {
        FixedDuration { task_type, time }
    }
}

impl SkillDescriptor for FixedDuration {
    fn task_type(&self) -> &TaskType {
        &self.task_type
    }

    fn required_descriptors(&self) -> Vec<&'static str> {
        Vec::new()
    }

    fn estimate(&self, _: &TaskSpec, context: &EstimateContext, _: &Environment) -> Result<Estimate, EstimateError> {
        Ok(Estimate::of_duration(self.time, context, context.place.clone()))
    }
}

/// A task with the duration in its parameter `seconds`, at the robot's position.
#[derive(Debug, Clone)]
pub(super) struct RequestedDuration {
    task_type: TaskType,
}

impl RequestedDuration {
    /// Creates the descriptor of a task type.
    pub(super) fn new(task_type: TaskType) -> RequestedDuration {
        RequestedDuration { task_type }
    }
}

impl SkillDescriptor for RequestedDuration {
    fn task_type(&self) -> &TaskType {
        &self.task_type
    }

    fn required_descriptors(&self) -> Vec<&'static str> {
        Vec::new()
    }

    fn estimate(&self, task: &TaskSpec, context: &EstimateContext, _: &Environment) -> Result<Estimate, EstimateError> {
        let time = parsed(task, "seconds", parse_seconds)?;
        Ok(Estimate::of_duration(time, context, context.place.clone()))
    }
}

/// The text is not a duration.
#[derive(Debug, thiserror::Error)]
enum DurationError {
    #[error(transparent)]
    Number(#[from] ParseFloatError),
    #[error(transparent)]
    Range(#[from] UnitError),
}

fn parse_seconds(text: &str) -> Result<Seconds, DurationError> {
    Ok(Seconds::new(text.parse()?)?)
}
