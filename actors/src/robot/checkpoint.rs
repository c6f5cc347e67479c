//! What a robot writes into its notebook about the role it holds.

use super::sequencer::AlternativeProgress;
use consort_protocol::codec::{self, CodecError};
use consort_protocol::ids::RobotId;
use consort_protocol::lease::Award;
use consort_protocol::plan::{StepAction, StepIndex};
use consort_skills::actions::GoalId;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// First byte of a page. Raised when a page is laid out anew: a robot that was brought to another release has then
/// forgotten its role, and says so.
const VERSION: u8 = 2;

/// How far a robot has come with an award. What it has said to others is in `ended`: messages are steps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    /// What it holds.
    pub award: Award,
    /// Steps that have ended.
    pub ended: BTreeSet<StepIndex>,
    /// Alternatives that were tried or are under way.
    pub alternatives: AlternativeProgress,
    /// This and later goals of the body belong to what has not ended.
    pub first_goal: GoalId,
}

/// Why a page cannot be taken up. The robot has forgotten what it held.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// Another release wrote it, or nobody of ours.
    #[error("laid out as version {found}, where this release reads {VERSION}")]
    Version {
        /// The first byte found.
        found: u8,
    },
    /// An empty page was never written by a robot.
    #[error("an empty page")]
    Empty,
    /// Not what a robot writes.
    #[error(transparent)]
    Malformed(#[from] CodecError),
    /// The notebook of another robot.
    #[error("written by {robot}")]
    OtherRobot {
        /// Who wrote it.
        robot: RobotId,
    },
}

impl Checkpoint {
    /// Whether one of these steps is a task that the page does not have as ended: then the body's latest goals may be of that
    /// one. (That a signal was heard is written down only with what follows.)
    pub fn misses_ended_task(&self, known: &BTreeSet<StepIndex>) -> bool {
        let is_task = |step: &&StepIndex| {
            let step = self.award.plan.steps.get(**step as usize);
            step.is_some_and(|step| matches!(step.action, StepAction::Task { .. }))
        };
        known.difference(&self.ended).any(|step| is_task(&step))
    }

    /// The page as bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = vec![VERSION];
        bytes.extend(codec::encode_record(self).expect("what came in messages fits a record"));
        bytes
    }

    /// What the bytes say.
    ///
    /// # Errors
    /// [`PageError`] when they are not a page of this robot.
    pub fn decode(bytes: &[u8], robot: &RobotId) -> Result<Checkpoint, CheckpointError> {
        match bytes {
            [] => Err(CheckpointError::Empty),
            [VERSION, rest @ ..] => {
                let page: Checkpoint = codec::decode_record(rest)?;
                if page.award.robot != *robot {
                    return Err(CheckpointError::OtherRobot { robot: page.award.robot });
                }
                Ok(page)
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

    fn page() -> Checkpoint {
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
        Checkpoint {
            award,
            ended: BTreeSet::from([0, 1]),
            alternatives: AlternativeProgress::default(),
            first_goal: GoalId(3),
        }
    }

    #[test]
    fn a_page_is_read_as_it_was_written() {
        let ada = "ada".parse().unwrap();
        assert_eq!(Checkpoint::decode(&page().encode(), &ada).unwrap(), page());
    }

    #[test]
    fn a_page_that_lacks_a_task_is_told_from_one_that_lacks_a_signal_that_was_heard() {
        let role = "r1";
        let signal = serde_json::json!({ "kind": "done", "task": "lift", "from": "arm", "to": role });
        let task = |id: &str| serde_json::json!({ "Task": { "id": id, "spec": { "type": id, "roles": [role] } } });
        let step = |action: serde_json::Value| serde_json::json!({ "action": action, "after": [] });
        let steps = [step(task("go")), step(serde_json::json!({ "Wait": signal })), step(task("take"))];
        let plan = serde_json::from_value(serde_json::json!({ "role": role, "steps": steps })).unwrap();
        let page = Checkpoint { award: Award { plan, ..page().award }, ended: BTreeSet::from([0]), ..page() };
        let lacks = |known: &[StepIndex]| page.misses_ended_task(&known.iter().copied().collect());
        assert_eq!([lacks(&[]), lacks(&[0]), lacks(&[0, 1]), lacks(&[0, 1, 2])], [false, false, false, true]);
    }

    #[test]
    fn what_is_no_page_of_this_robot_is_not_taken_up() {
        let read =
            |bytes: &[u8], robot: &str| Checkpoint::decode(bytes, &robot.parse().unwrap()).unwrap_err().to_string();
        let bytes = page().encode();
        assert_eq!(read(&[], "ada"), "an empty page");
        assert_eq!(read(&[9, 1, 2], "ada"), "laid out as version 9, where this release reads 2");
        assert_eq!(read(&bytes, "bob"), "written by ada");
        for length in 1..bytes.len() {
            assert!(Checkpoint::decode(&bytes[..length], &"ada".parse().unwrap()).is_err(), "the first {length} bytes");
        }
        assert!(Checkpoint::decode(&[bytes, vec![0]].concat(), &"ada".parse().unwrap()).is_err(), "a byte too many");
    }
}
