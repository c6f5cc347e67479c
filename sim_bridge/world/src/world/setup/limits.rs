//! Durations of actions, and limits of a world.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Durations of actions, in seconds of world time. The defaults are those of the published
/// estimates: 2 s for each step that is not a drive. People take from 2 to 4 s. The timeouts and
/// the memory of robots are guesses too.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Durations {
    /// Approaching a person.
    pub approach_person_s: f64,
    /// Authenticating a person.
    pub authenticate_person_s: f64,
    /// Opening or closing a drawer.
    pub operate_drawer_s: f64,
    /// Approaching a robot.
    pub approach_robot_s: f64,
    /// Taking an object from a drawer.
    pub pick_up_s: f64,
    /// Putting an object down.
    pub deposit_s: f64,
    /// Connecting to a charger, or disconnecting.
    pub dock_s: f64,
    /// Shortest handover by a person.
    pub person_min_s: f64,
    /// Longest handover by a person.
    pub person_max_s: f64,
    /// Time for which a robot waits before a door that admits no robot. After it, the robot regards
    /// the lane as blocked.
    pub door_timeout_s: f64,
    /// Time for which a robot remembers a blocked lane. After it, the robot tries the lane again.
    pub closure_memory_s: f64,
}

impl Default for Durations {
    fn default() -> Self {
        Self {
            approach_person_s: 2.0,
            authenticate_person_s: 2.0,
            operate_drawer_s: 2.0,
            approach_robot_s: 2.0,
            pick_up_s: 2.0,
            deposit_s: 2.0,
            dock_s: 2.0,
            person_min_s: 2.0,
            person_max_s: 4.0,
            door_timeout_s: 120.0,
            closure_memory_s: 300.0,
        }
    }
}

/// Limits of a world's memory and numbers. Larger limits cost only memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct WorldLimits {
    /// Greatest number of robots, of people, and of samples.
    pub entities_max: usize,
    /// Greatest number of open person requests. As many ended requests are kept to recognise
    /// repetitions.
    pub person_requests_max: usize,
    /// Capacity of a drawer, in samples.
    pub drawer_slots: usize,
    /// Number of ended goals kept per robot, with their status.
    pub ended_goals_kept: usize,
    /// Number of transfers kept per sample, and of entries in the event log until it is drained.
    /// The oldest are dropped first.
    pub history_kept: usize,
}

impl Default for WorldLimits {
    fn default() -> Self {
        Self {
            entities_max: 10_000,
            person_requests_max: 10_000,
            drawer_slots: 1,
            ended_goals_kept: 64,
            history_kept: 4_096,
        }
    }
}
