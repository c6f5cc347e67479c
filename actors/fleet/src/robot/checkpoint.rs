//! The checkpoint of a robot: its award and its progress.

use super::sequencer::OwnProgress;
use consort_protocol::codec::{self, CodecError};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::lease::Award;
use consort_protocol::plan::{StepAction, StepIndex};
use consort_skills::actions::GoalId;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// First byte of an encoded checkpoint. Raised with each change of the layout: after an upgrade the
/// robot cannot restore its role, and reports that it has lost it.
const VERSION: u8 = 3;

/// Progress of a robot with an award. Signals sent are contained in `ended`, because sending a
/// signal is a step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    /// The held award.
    pub award: Award,
    /// Progress in its plan.
    pub own: OwnProgress,
    /// This goal of the driver and all later goals belong to steps that have not ended.
    pub first_goal: GoalId,
    /// Place that the robot left for an assembly place, and where the plan goes on.
    pub left: Option<PlaceId>,
}

/// The checkpoint cannot be restored. The robot has lost its role.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// The first byte names another version: another release wrote the checkpoint, or another
    /// program.
    #[error("layout version {found}; this release reads {VERSION}")]
    Version {
        /// First byte found.
        found: u8,
    },
    /// A robot never writes an empty checkpoint.
    #[error("an empty checkpoint")]
    Empty,
    /// The bytes are not an encoded checkpoint.
    #[error(transparent)]
    Malformed(#[from] CodecError),
    /// The checkpoint belongs to another robot.
    #[error("written by {robot}")]
    OtherRobot {
        /// Robot named in the checkpoint.
        robot: RobotId,
    },
}

impl Checkpoint {
    /// Checks whether `recorded` contains a task that has not ended in this checkpoint: the
    /// driver's latest goals may then belong to that task. (A received signal is stored only
    /// together with the step that follows it.)
    pub fn misses_ended_task(&self, recorded: &BTreeSet<StepIndex>) -> bool {
        let is_task = |step: &&StepIndex| {
            let step = self.award.plan.steps.get(**step as usize);
            step.is_some_and(|step| matches!(step.action, StepAction::Task { .. }))
        };
        recorded.difference(&self.own.ended).any(|step| is_task(&step))
    }

    /// Returns the encoded checkpoint.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = vec![VERSION];
        bytes.extend(codec::encode_record(self).expect("the content of messages fits a record"));
        bytes
    }

    /// Decodes a checkpoint of `robot`.
    ///
    /// # Errors
    /// [`CheckpointError`] if the bytes are not a checkpoint of this robot.
    pub fn decode(bytes: &[u8], robot: &RobotId) -> Result<Checkpoint, CheckpointError> {
        match bytes {
            [] => Err(CheckpointError::Empty),
            [VERSION, rest @ ..] => {
                let checkpoint: Checkpoint = codec::decode_record(rest)?;
                if checkpoint.award.robot != *robot {
                    return Err(CheckpointError::OtherRobot { robot: checkpoint.award.robot });
                }
                Ok(checkpoint)
            }
            [found, ..] => Err(CheckpointError::Version { found: *found }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::lease::Epoch;
    use consort_protocol::plan::LocalPlan;

    fn own(ended: &[StepIndex]) -> OwnProgress {
        OwnProgress { ended: ended.iter().copied().collect(), ..OwnProgress::default() }
    }

    fn checkpoint() -> Checkpoint {
        let role: consort_protocol::ids::RoleId = "r1".parse().unwrap();
        let plan: LocalPlan = serde_json::from_value(serde_json::json!({ "role": role, "steps": [] })).unwrap();
        let award = Award {
            mission: "m-1".parse().unwrap(),
            role,
            robot: "ada".parse().unwrap(),
            epoch: Epoch { term: 2, index: 7 },
            plan,
            holders: std::collections::BTreeMap::new(),
        };
        Checkpoint { award, own: own(&[0, 1]), first_goal: GoalId(3), left: Some("Ward".parse().unwrap()) }
    }

    #[test]
    fn a_checkpoint_survives_encoding() {
        let ada = "ada".parse().unwrap();
        assert_eq!(Checkpoint::decode(&checkpoint().encode(), &ada).unwrap(), checkpoint());
    }

    #[test]
    fn a_missing_task_is_distinguished_from_a_missing_signal() {
        let role = "r1";
        let signal = serde_json::json!({ "kind": "done", "task": "lift", "from": "arm", "to": role });
        let task = |id: &str| serde_json::json!({ "Task": { "id": id, "spec": { "type": id, "roles": [role] } } });
        let step = |action: serde_json::Value| serde_json::json!({ "action": action, "after": [] });
        let steps = [step(task("go")), step(serde_json::json!({ "Wait": signal })), step(task("take"))];
        let plan = serde_json::from_value(serde_json::json!({ "role": role, "steps": steps })).unwrap();
        let checkpoint = Checkpoint { award: Award { plan, ..checkpoint().award }, own: own(&[0]), ..checkpoint() };
        let misses = |recorded: &[StepIndex]| checkpoint.misses_ended_task(&recorded.iter().copied().collect());
        assert_eq!([misses(&[]), misses(&[0]), misses(&[0, 1]), misses(&[0, 1, 2])], [false, false, false, true]);
    }

    #[test]
    fn an_invalid_or_foreign_checkpoint_is_rejected() {
        let read =
            |bytes: &[u8], robot: &str| Checkpoint::decode(bytes, &robot.parse().unwrap()).unwrap_err().to_string();
        let bytes = checkpoint().encode();
        assert_eq!(read(&[], "ada"), "an empty checkpoint");
        assert_eq!(read(&[9, 1, 2], "ada"), "layout version 9; this release reads 3");
        assert_eq!(read(&bytes, "bob"), "written by ada");
        for length in 1..bytes.len() {
            assert!(Checkpoint::decode(&bytes[..length], &"ada".parse().unwrap()).is_err(), "the first {length} bytes");
        }
        assert!(Checkpoint::decode(&[bytes, vec![0]].concat(), &"ada".parse().unwrap()).is_err(), "a byte too many");
    }
}
