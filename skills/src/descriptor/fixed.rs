//! Tasks whose time does not depend on where the robot is.

use super::{Context, Estimate, EstimateError, SkillDescriptor, parsed};
use crate::environment::Environment;
use consort_protocol::ids::TaskType;
use consort_protocol::mission::TaskSpec;
use consort_protocol::units::Seconds;

/// Seconds for any step that is not a drive, messages included: the figure of the published evaluation (replication
/// package of the JSS 2022 article; thesis 4).
pub const STEP_TIME_S: f64 = 2.0;

/// A task that always takes the same time, where the robot stands.
#[derive(Debug, Clone)]
pub struct FixedTime {
    task_type: TaskType,
    time: Seconds,
}

impl FixedTime {
    /// Every task of this type takes this long.
    pub fn new(task_type: TaskType, time: Seconds) -> FixedTime {
        FixedTime { task_type, time }
    }
}

impl SkillDescriptor for FixedTime {
    fn task_type(&self) -> &TaskType {
        &self.task_type
    }

    fn needs(&self) -> Vec<&'static str> {
        Vec::new()
    }

    fn estimate(&self, _: &TaskSpec, context: &Context, _: &Environment) -> Result<Estimate, EstimateError> {
        Ok(Estimate::lasting(self.time, context, context.place.clone()))
    }
}

/// A task that takes as long as its parameter `seconds` says, where the robot stands.
#[derive(Debug, Clone)]
pub struct StatedTime {
    task_type: TaskType,
}

impl StatedTime {
    /// Tasks of this type say how long they take.
    pub fn new(task_type: TaskType) -> StatedTime {
        StatedTime { task_type }
    }
}

impl SkillDescriptor for StatedTime {
    fn task_type(&self) -> &TaskType {
        &self.task_type
    }

    fn needs(&self) -> Vec<&'static str> {
        Vec::new()
    }

    fn estimate(&self, task: &TaskSpec, context: &Context, _: &Environment) -> Result<Estimate, EstimateError> {
        let time = parsed(task, "seconds", |text| {
            let number = text.parse::<f64>().map_err(|error| error.to_string())?;
            Seconds::new(number).map_err(|error| error.to_string())
        })?;
        Ok(Estimate::lasting(time, context, context.place.clone()))
    }
}
