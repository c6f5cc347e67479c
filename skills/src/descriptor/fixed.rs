//! Tasks with a duration that does not depend on the robot's position.

use super::estimate::{Estimate, EstimateContext, EstimateError, SkillDescriptor};
use crate::environment::Environment;
use consort_protocol::ids::TaskType;
use consort_protocol::mission::TaskSpec;
use consort_protocol::units::Seconds;

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

    fn grows_with_drives(&self) -> bool {
        true
    }

    fn estimate(&self, _: &TaskSpec, context: &EstimateContext, _: &Environment) -> Result<Estimate, EstimateError> {
        Ok(Estimate::of_duration(self.time, context, context.place.clone()))
    }
}
