//! End states of trials (thesis 4.1.2).

use consort_protocol::ids::{RobotId, TaskType};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt;

/// End state of a trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EndState {
    /// The requested item reached its destination before any failure.
    Success,
    /// A robot began a task without the required skill.
    NoSkill,
    /// The charge of an assigned mobile robot fell below the limit.
    LowBattery,
    /// The limit of simulated time passed first.
    TimeoutSim,
    /// The limit of real time passed first.
    TimeoutWall,
}

impl EndState {
    /// All end states, success first.
    pub const ALL: [EndState; 5] =
        [EndState::Success, EndState::NoSkill, EndState::LowBattery, EndState::TimeoutSim, EndState::TimeoutWall];

    /// Returns the name used in files.
    pub const fn as_str(self) -> &'static str {
        match self {
            EndState::Success => "success",
            EndState::NoSkill => "no-skill",
            EndState::LowBattery => "low-battery",
            EndState::TimeoutSim => "timeout-sim",
            EndState::TimeoutWall => "timeout-wall",
        }
    }
}

impl fmt::Display for EndState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// Time limits of a trial, and its battery limit. The defaults are the published values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TrialLimits {
    /// Limit of simulated seconds after the request. Default 900.
    pub sim_s: f64,
    /// Limit of real seconds. Default 2700.
    pub wall_s: f64,
    /// Least charge of an assigned mobile robot as a share of a full battery; less is a failure.
    /// Default 0.05.
    pub battery_share: f64,
}

impl Default for TrialLimits {
    fn default() -> Self {
        TrialLimits { sim_s: 900.0, wall_s: 2700.0, battery_share: 0.05 }
    }
}

/// The charge of a mobile robot during its assignment.
#[derive(Debug, Clone, PartialEq)]
pub struct BatteryFacts {
    /// The robot.
    pub robot: RobotId,
    /// Lowest charge, as a share of a full battery.
    pub lowest_share: f64,
    /// First time below the limit, in seconds of world time.
    pub below_at_s: Option<f64>,
}

/// Observations of a trial. Times are seconds of world time.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialFacts {
    /// Time of the mission request.
    pub requested_at_s: f64,
    /// Time at which the requested item reached its destination.
    pub delivered_at_s: Option<f64>,
    /// The first task begun without the skill: time, robot and task type.
    pub unskilled: Option<(f64, RobotId, TaskType)>,
    /// The mobile robots that were assigned.
    pub batteries: Vec<BatteryFacts>,
    /// End of the observation.
    pub ended_at_s: f64,
    /// Duration in real seconds.
    pub wall_s: f64,
}

/// Returns the end state of a trial and, for a success, the time to conclude in seconds. The first
/// event decides. Of events at the same instant a failure precedes the delivery, because a success
/// reaches its destination *before* a failure occurs. A mission that was given up has no event of
/// its own: it is a timeout, as in the published experiments.
pub fn classify(facts: &TrialFacts, limits: &TrialLimits) -> (EndState, Option<f64>) {
    let low = facts.batteries.iter().filter_map(|battery| battery.below_at_s).min_by(f64::total_cmp);
    let timeout = Some(facts.requested_at_s + limits.sim_s);
    let events = [
        (facts.unskilled.as_ref().map(|(at, ..)| *at), EndState::NoSkill),
        (low, EndState::LowBattery),
        (timeout, EndState::TimeoutSim),
        (facts.delivered_at_s, EndState::Success),
    ];
    let occurred = events.into_iter().filter_map(|(at, state)| Some((at?, state)));
    // Of events at the same time the first in the list is taken.
    let (at, state) = occurred.min_by(|(a, _), (b, _)| a.total_cmp(b)).expect("the list contains a timeout");
    match state {
        EndState::Success => (state, Some(at - facts.requested_at_s)),
        EndState::TimeoutSim if facts.ended_at_s < at && facts.wall_s >= limits.wall_s => (EndState::TimeoutWall, None),
        _ => (state, None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facts() -> TrialFacts {
        let (requested_at_s, ended_at_s) = (10.0, 910.0);
        TrialFacts { requested_at_s, delivered_at_s: None, unskilled: None, batteries: vec![], ended_at_s, wall_s: 1.0 }
    }

    fn low(at: f64) -> BatteryFacts {
        BatteryFacts { robot: RobotId::new("r1").unwrap(), lowest_share: 0.04, below_at_s: Some(at) }
    }

    fn classified(facts: TrialFacts) -> (EndState, Option<f64>) {
        classify(&facts, &TrialLimits::default())
    }

    #[test]
    fn the_first_event_decides() {
        let delivered = TrialFacts { delivered_at_s: Some(300.0), ..facts() };
        assert_eq!(classified(delivered.clone()), (EndState::Success, Some(290.0)));
        assert_eq!(
            classified(TrialFacts { batteries: vec![low(299.0)], ..delivered.clone() }),
            (EndState::LowBattery, None)
        );
        assert_eq!(
            classified(TrialFacts { batteries: vec![low(300.0)], ..delivered.clone() }),
            (EndState::LowBattery, None)
        );
        let later = TrialFacts { batteries: vec![low(301.0)], ..delivered.clone() };
        assert_eq!(classified(later), (EndState::Success, Some(290.0)));
        let unskilled = Some((20.0, RobotId::new("r1").unwrap(), TaskType::new("navigation").unwrap()));
        assert_eq!(
            classified(TrialFacts { unskilled, batteries: vec![low(30.0)], ..delivered }),
            (EndState::NoSkill, None)
        );
    }

    #[test]
    fn a_late_or_abandoned_mission_is_a_timeout() {
        assert_eq!(classified(TrialFacts { delivered_at_s: Some(911.0), ..facts() }), (EndState::TimeoutSim, None));
        assert_eq!(classified(TrialFacts { ended_at_s: 60.0, ..facts() }), (EndState::TimeoutSim, None));
        let stuck = TrialFacts { ended_at_s: 60.0, wall_s: 2700.0, ..facts() };
        assert_eq!(classified(stuck), (EndState::TimeoutWall, None));
    }
}
