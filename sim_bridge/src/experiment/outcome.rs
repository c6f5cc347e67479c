//! How a trial ended (thesis 4.1.2).

use consort_protocol::ids::{RobotId, TaskType};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt;

/// How a trial ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EndState {
    /// What was asked for reached its destination before any failure.
    Success,
    /// A robot began a task for which it lacks the skill.
    NoSkill,
    /// An assigned mobile robot's charge fell below the limit.
    LowBattery,
    /// The limit of simulated time passed first.
    TimeoutSim,
    /// The limit of real time passed first.
    TimeoutWall,
}

impl EndState {
    /// All of them, success first.
    pub const ALL: [EndState; 5] =
        [EndState::Success, EndState::NoSkill, EndState::LowBattery, EndState::TimeoutSim, EndState::TimeoutWall];

    /// As in files.
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

/// When a trial is cut, and what counts as low. The defaults are the published ones.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TrialLimits {
    /// Simulated seconds from the request on. Default 900.
    pub sim_s: f64,
    /// Real seconds. Default 2700.
    pub wall_s: f64,
    /// An assigned mobile robot with less charge than this share of a full battery has failed. Default 0.05.
    pub battery_share: f64,
}

impl Default for TrialLimits {
    fn default() -> Self {
        TrialLimits { sim_s: 900.0, wall_s: 2700.0, battery_share: 0.05 }
    }
}

/// The charge of a mobile robot while it was assigned.
#[derive(Debug, Clone, PartialEq)]
pub struct BatteryFacts {
    /// Which robot.
    pub robot: RobotId,
    /// The least it had, as a share of a full one.
    pub lowest_share: f64,
    /// When it first had less than the limit, in seconds of world time.
    pub below_at_s: Option<f64>,
}

/// What was seen of a trial. Times are seconds of world time.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialFacts {
    /// When the mission was asked for.
    pub requested_at_s: f64,
    /// When what was asked for reached its destination.
    pub delivered_at_s: Option<f64>,
    /// Who first began a task without the skill, and when.
    pub unskilled: Option<(f64, RobotId, TaskType)>,
    /// The mobile robots that were assigned.
    pub batteries: Vec<BatteryFacts>,
    /// When nobody looked any longer.
    pub ended_at_s: f64,
    /// Real seconds that it took.
    pub wall_s: f64,
}

/// How a trial ended, and the time to conclude in seconds, which only a success has. The first event decides; at one
/// instant a failure comes before the delivery, for a success reaches its destination *before* a failure occurs. A
/// mission that was given up has no event: it is a timeout, as in the published rig.
pub fn classify(facts: &TrialFacts, limits: &TrialLimits) -> (EndState, Option<f64>) {
    let low = facts.batteries.iter().filter_map(|battery| battery.below_at_s).min_by(f64::total_cmp);
    let timeout = Some(facts.requested_at_s + limits.sim_s);
    let events = [
        (facts.unskilled.as_ref().map(|(at, ..)| *at), EndState::NoSkill),
        (low, EndState::LowBattery),
        (timeout, EndState::TimeoutSim),
        (facts.delivered_at_s, EndState::Success),
    ];
    let seen = events.into_iter().filter_map(|(at, state)| Some((at?, state)));
    // Of equal ones the first is taken.
    let (at, state) = seen.min_by(|(a, _), (b, _)| a.total_cmp(b)).expect("there is always a timeout");
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

    fn ends(facts: TrialFacts) -> (EndState, Option<f64>) {
        classify(&facts, &TrialLimits::default())
    }

    #[test]
    fn the_first_event_decides() {
        let delivered = TrialFacts { delivered_at_s: Some(300.0), ..facts() };
        assert_eq!(ends(delivered.clone()), (EndState::Success, Some(290.0)));
        assert_eq!(ends(TrialFacts { batteries: vec![low(299.0)], ..delivered.clone() }), (EndState::LowBattery, None));
        assert_eq!(ends(TrialFacts { batteries: vec![low(300.0)], ..delivered.clone() }), (EndState::LowBattery, None));
        let later = TrialFacts { batteries: vec![low(301.0)], ..delivered.clone() };
        assert_eq!(ends(later), (EndState::Success, Some(290.0)));
        let unskilled = Some((20.0, RobotId::new("r1").unwrap(), TaskType::new("navigation").unwrap()));
        assert_eq!(ends(TrialFacts { unskilled, batteries: vec![low(30.0)], ..delivered }), (EndState::NoSkill, None));
    }

    #[test]
    fn what_is_late_or_given_up_is_a_timeout() {
        assert_eq!(ends(TrialFacts { delivered_at_s: Some(911.0), ..facts() }), (EndState::TimeoutSim, None));
        assert_eq!(ends(TrialFacts { ended_at_s: 60.0, ..facts() }), (EndState::TimeoutSim, None));
        let stuck = TrialFacts { ended_at_s: 60.0, wall_s: 2700.0, ..facts() };
        assert_eq!(ends(stuck), (EndState::TimeoutWall, None));
    }
}
