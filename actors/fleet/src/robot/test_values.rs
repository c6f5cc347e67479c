//! Values for the unit tests of the robot.

use super::active_plan::{ActivePlan, PlanStart};
use super::checkpoint::Checkpoint;
use consort_protocol::knowledge::{Attributes, Availability, RobotKnowledge};
use consort_protocol::lease::{Award, Epoch};
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, NodeTime, SharePerSecond};
use consort_skills::actions::GoalId;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

pub(super) fn at(ms: u64) -> NodeTime {
    NodeTime::default() + Duration::from_millis(ms)
}

/// Returns the record of a free robot with a full battery and no skills.
pub(crate) fn idle_robot() -> RobotKnowledge {
    RobotKnowledge {
        skills: BTreeSet::new(),
        attributes: Attributes::default(),
        place: "Dock".parse().unwrap(),
        pose: Pose::default(),
        battery: BatteryShare::FULL,
        discharge: SharePerSecond::new(0.001).unwrap(),
        useful_charge: BatteryShare::new(0.1).unwrap(),
        speed: None,
        availability: Availability::Free,
        estimator: "standard".to_owned(),
        charging: None,
    }
}

/// Returns an award of role `r1` to robot `ada`. Its plan drives, sends a signal to the arm, and
/// drives again.
pub(super) fn award(index: u64) -> Award {
    let task = |id: &str, after: &[u32]| -> Value {
        let spec = json!({ "type": "drive", "roles": ["r1"], "attempts": 2 });
        json!({ "action": { "Task": { "id": id, "spec": spec } }, "after": after })
    };
    let signal = json!({ "kind": "done", "task": "go", "from": "r1", "to": "arm" });
    let steps = [task("go", &[]), json!({ "action": { "Send": signal }, "after": [0] }), task("return", &[1])];
    Award {
        mission: "m-1".parse().unwrap(),
        role: "r1".parse().unwrap(),
        robot: "ada".parse().unwrap(),
        epoch: Epoch { term: 1, index },
        plan: serde_json::from_value(json!({ "role": "r1", "steps": steps })).unwrap(),
        holders: BTreeMap::new(),
    }
}

/// Returns the plan of an award, started or continued from a checkpoint.
pub(super) fn started(award: Award, restored: Option<Checkpoint>) -> ActivePlan {
    let (recorded, holders) = (BTreeSet::new(), award.holders.clone());
    let start = PlanStart { award, recorded: &recorded, holders, restored, next_goal: GoalId(100) };
    let (active, failure) = ActivePlan::start(start).unwrap();
    assert_eq!(failure, None);
    active
}
