//! The side of the skills: telemetry and actions of a robot.

use super::goal::{Goal, GoalId, GoalResult, GoalStatus};
use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, WorldTime};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// State report of a robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Telemetry {
    /// Time, on the world's clock.
    pub time: WorldTime,
    /// Pose.
    pub pose: Pose,
    /// Current place, or the last place passed.
    pub place: PlaceId,
    /// State of charge.
    pub battery: BatteryShare,
    /// False once the battery has fallen below the stopping share and the robot can no longer move.
    pub able: bool,
    /// Lanes that the robot has found closed, or that were reported to it as closed: each once, by
    /// its two ends. The list is incomplete, and old entries expire, since a lane may be open
    /// again.
    pub closed: Vec<(PlaceId, PlaceId)>,
}

/// The actions of a robot, as its skills use them. Calls never block: results appear in
/// [`status`](RobotActions::status) later.
pub trait RobotActions {
    /// Sends a goal.
    fn send_goal(&mut self, goal: Goal) -> GoalId;

    /// Returns the status of a goal; `None` for a goal that was never sent, or ended long ago.
    fn status(&self, goal: GoalId) -> Option<GoalStatus>;

    /// Requests the cancelation of a goal. Its status becomes [`GoalStatus::Canceled`] when the
    /// robot stands still.
    fn cancel(&mut self, goal: GoalId);

    /// Returns the latest report of the robot; `None` before the first.
    fn telemetry(&self) -> Option<&Telemetry>;

    /// Consumes a completion of this goal by an earlier attempt at the same task: an attempt that
    /// was interrupted, or ended by a crash of the robot program without receiving the result.
    /// Returns its result once for each completion, otherwise `None`. Called for goals that are not
    /// [repeatable](Goal::is_repeatable). An implementation without memory returns `None`.
    fn take_completed(&mut self, goal: &Goal) -> Option<GoalResult> {
        let _ = goal;
        None
    }
}
