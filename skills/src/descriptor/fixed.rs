//! Tasks that take the same time wherever and whoever.

use super::{Context, Estimate, EstimateError, SkillDescriptor};
use crate::environment::Environment;
use consort_protocol::ids::TaskType;
use consort_protocol::mission::TaskSpec;
use consort_protocol::units::Seconds;

/// Seconds that every step but navigation takes in the published evaluation.
pub const STEP_TIME: f64 = 2.0;

/// Prices a task type at a fixed time; energy is time × discharge rate, and the robot stays where it is.
#[derive(Debug, Clone)]
pub struct FixedTime {
    task_type: TaskType,
    time: Seconds,
}

impl FixedTime {
    /// Tasks of this type take [`STEP_TIME`].
    pub fn of(task_type: TaskType) -> FixedTime {
        FixedTime::taking(task_type, Seconds::new(STEP_TIME).expect("a constant above 0"))
    }

    /// Tasks of this type take this long.
    pub fn taking(task_type: TaskType, time: Seconds) -> FixedTime {
        FixedTime { task_type, time }
    }
}

impl SkillDescriptor for FixedTime {
    fn task_type(&self) -> TaskType {
        self.task_type.clone()
    }

    fn estimate(&self, _: &TaskSpec, context: &Context, _: &Environment) -> Result<Estimate, EstimateError> {
        let energy = context.discharge.over(self.time);
        Ok(Estimate { time: self.time, energy, place: context.place.clone() })
    }
}
