//! What happens, as it happens, in JSON, for people and programs to follow: each node tells it on a key of its own,
//! `consort/{fleet}/events/{node}`.

use crate::auction::{AuctionRecord, Bid};
use crate::ids::{ClusterId, EnsembleId, MissionId, NodeId, RobotId, RoleId, TaskId};
use crate::lease::{EndReason, Epoch};
use crate::ledger::MissionState;
use crate::message::FailureKind;
use crate::plan::Signal;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// One happening.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// Where it happened.
    pub node: NodeId,
    /// Counts the node's events since it started, from 1: a gap is a loss.
    pub sequence: u64,
    /// When, in milliseconds of the node's wall clock.
    pub at_ms: u64,
    /// What.
    #[serde(flatten)]
    pub kind: EventKind,
}

/// What can happen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum EventKind {
    /// A node began to coordinate.
    Elected {
        /// Its term.
        term: u64,
        /// Who keeps the ledger.
        voters: Vec<NodeId>,
    },
    /// A node no longer coordinates, or can no longer be sure that it does.
    SteppedDown {
        /// The term in which it did.
        term: u64,
    },
    /// Somebody coordinates another cluster under this fleet's name: two fleets were founded apart. They do not merge.
    Foreign {
        /// The cluster of the node that tells.
        cluster: ClusterId,
        /// The other one.
        foreign: ClusterId,
        /// A node of the other one.
        member: NodeId,
    },
    /// The coordinator changed who keeps the ledger.
    Voters {
        /// Who votes from now on.
        voters: Vec<NodeId>,
        /// What was changed, and why.
        reason: String,
    },
    /// The coordinator counts a node among an ensemble's members.
    Joined {
        /// The ensemble.
        ensemble: EnsembleId,
        /// The node.
        member: NodeId,
    },
    /// The coordinator no longer counts a node among an ensemble's members.
    Left {
        /// The ensemble.
        ensemble: EnsembleId,
        /// The node.
        member: NodeId,
        /// Why not.
        reason: String,
    },
    /// A mission was acknowledged.
    Submitted {
        /// The mission.
        mission: MissionId,
        /// Its parameters.
        parameters: BTreeMap<String, String>,
    },
    /// Members were asked for bids.
    Called {
        /// The mission.
        mission: MissionId,
        /// Its open roles.
        roles: Vec<RoleId>,
        /// Which round.
        round: u32,
        /// How many were asked.
        asked: usize,
    },
    /// A robot bid.
    Bid {
        /// The mission.
        mission: MissionId,
        /// Its bid, with its parts.
        bid: Bid,
    },
    /// An auction was closed; every answer is in the record.
    Closed {
        /// The mission.
        mission: MissionId,
        /// What was heard and decided.
        record: AuctionRecord,
    },
    /// Roles were given.
    Awarded {
        /// The mission.
        mission: MissionId,
        /// Who got which.
        holders: BTreeMap<RoleId, RobotId>,
        /// The award.
        epoch: Epoch,
        /// From the commit of the request to the commit of the award, in milliseconds.
        after_ms: Option<f64>,
    },
    /// A role's holder was given up.
    Released {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// Why.
        cause: String,
    },
    /// A mission's state changed.
    Mission {
        /// The mission.
        mission: MissionId,
        /// Its state.
        state: MissionState,
        /// When it was requested, in milliseconds of the wall clock of the coordinator of then.
        submitted_at_ms: u64,
    },
    /// A role's steps have ended.
    Progress {
        /// The mission.
        mission: MissionId,
        /// Steps ended, over all managed roles.
        done: usize,
        /// Steps in all.
        steps: usize,
    },
    /// A robot began its plan.
    Started {
        /// The mission.
        mission: MissionId,
        /// Its role.
        role: RoleId,
        /// The award.
        epoch: Epoch,
    },
    /// A task began.
    TaskBegan {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// The task.
        task: TaskId,
    },
    /// A task ended well.
    TaskEnded {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// The task.
        task: TaskId,
    },
    /// A task failed for good.
    TaskFailed {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// The task.
        task: TaskId,
        /// Why.
        cause: String,
    },
    /// A role told another.
    Sent {
        /// The mission.
        mission: MissionId,
        /// What.
        signal: Signal,
    },
    /// A role heard what it waited for.
    Heard {
        /// The mission.
        mission: MissionId,
        /// What.
        signal: Signal,
    },
    /// A robot stopped safely because its lease ran out.
    Suspended {
        /// The mission.
        mission: MissionId,
        /// Its role.
        role: RoleId,
    },
    /// A robot whose lease had run out went on.
    Resumed {
        /// The mission.
        mission: MissionId,
        /// Its role.
        role: RoleId,
    },
    /// A robot put its role down.
    Halted {
        /// The mission.
        mission: MissionId,
        /// Its role.
        role: RoleId,
        /// Why.
        reason: EndReason,
    },
    /// An attempt at a task failed; it is made again.
    TaskRetried {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// The task.
        task: TaskId,
        /// How often it was tried so far.
        attempt: u8,
        /// Why it failed.
        cause: String,
    },
    /// A task failed for good; the robot takes another way that its mission gives.
    Alternative {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// The task that failed.
        task: TaskId,
        /// The number of the alternative in the role's plan, from 0.
        alternative: usize,
        /// The tasks that are done instead.
        tasks: Vec<TaskId>,
        /// Why the task failed.
        cause: String,
    },
    /// A robot cannot carry its role to its end, and asks for another to take it.
    GaveUp {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// What kind of failure it is.
        kind: FailureKind,
        /// Why, in words.
        cause: String,
    },
    /// The battery will not last for the rest of the plan, and the robot goes on all the same: it may have something in its
    /// hands, and nobody is helped if it is left on the way.
    ChargeShort {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// The forecast, in words.
        cause: String,
    },
    /// Something said under an award that is no longer in force was not listened to.
    Outdated {
        /// The mission.
        mission: MissionId,
        /// What was said.
        signal: Signal,
        /// Under which award.
        epoch: Epoch,
        /// The latest award of that role which the hearer knows.
        known: Epoch,
        /// How often this has happened at this node since it started.
        count: u64,
    },
}

impl EventKind {
    /// What kind of happening it is: the field `event` of its JSON.
    pub fn as_str(&self) -> &'static str {
        match self {
            EventKind::Elected { .. } => "elected",
            EventKind::SteppedDown { .. } => "stepped_down",
            EventKind::Foreign { .. } => "foreign",
            EventKind::Voters { .. } => "voters",
            EventKind::Joined { .. } => "joined",
            EventKind::Left { .. } => "left",
            EventKind::Submitted { .. } => "submitted",
            EventKind::Called { .. } => "called",
            EventKind::Bid { .. } => "bid",
            EventKind::Closed { .. } => "closed",
            EventKind::Awarded { .. } => "awarded",
            EventKind::Released { .. } => "released",
            EventKind::Mission { .. } => "mission",
            EventKind::Progress { .. } => "progress",
            EventKind::Started { .. } => "started",
            EventKind::TaskBegan { .. } => "task_began",
            EventKind::TaskEnded { .. } => "task_ended",
            EventKind::TaskFailed { .. } => "task_failed",
            EventKind::Sent { .. } => "sent",
            EventKind::Heard { .. } => "heard",
            EventKind::Suspended { .. } => "suspended",
            EventKind::Resumed { .. } => "resumed",
            EventKind::Halted { .. } => "halted",
            EventKind::TaskRetried { .. } => "task_retried",
            EventKind::Alternative { .. } => "alternative",
            EventKind::GaveUp { .. } => "gave_up",
            EventKind::ChargeShort { .. } => "charge_short",
            EventKind::Outdated { .. } => "outdated",
        }
    }

    /// The mission that it belongs to, if any.
    pub fn mission(&self) -> Option<&MissionId> {
        match self {
            EventKind::Submitted { mission, .. }
            | EventKind::Called { mission, .. }
            | EventKind::Bid { mission, .. }
            | EventKind::Closed { mission, .. }
            | EventKind::Awarded { mission, .. }
            | EventKind::Released { mission, .. }
            | EventKind::Mission { mission, .. }
            | EventKind::Progress { mission, .. }
            | EventKind::Started { mission, .. }
            | EventKind::TaskBegan { mission, .. }
            | EventKind::TaskEnded { mission, .. }
            | EventKind::TaskFailed { mission, .. }
            | EventKind::Sent { mission, .. }
            | EventKind::Heard { mission, .. }
            | EventKind::Suspended { mission, .. }
            | EventKind::Resumed { mission, .. }
            | EventKind::Halted { mission, .. }
            | EventKind::TaskRetried { mission, .. }
            | EventKind::Alternative { mission, .. }
            | EventKind::GaveUp { mission, .. }
            | EventKind::ChargeShort { mission, .. }
            | EventKind::Outdated { mission, .. } => Some(mission),
            EventKind::Elected { .. }
            | EventKind::SteppedDown { .. }
            | EventKind::Foreign { .. }
            | EventKind::Voters { .. }
            | EventKind::Joined { .. }
            | EventKind::Left { .. } => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_word_of_a_happening_is_that_of_its_json() {
        let mission: MissionId = "lab-samples-1".parse().unwrap();
        let (role, task): (RoleId, TaskId) = ("r1".parse().unwrap(), "go".parse().unwrap());
        let happenings = [
            EventKind::SteppedDown { term: 1 },
            EventKind::TaskBegan { mission: mission.clone(), role: role.clone(), task },
            EventKind::ChargeShort { mission, role, cause: String::new() },
        ];
        for what in happenings {
            assert_eq!(serde_json::to_value(&what).unwrap()["event"], what.as_str());
        }
    }
}
