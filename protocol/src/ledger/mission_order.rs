//! Changes of missions that people request.

use super::submission::Priority;
use crate::auction::RobotRestriction;
use crate::ids::{ItemId, MissionId, PlaceId, RobotId, RoleId, TaskId};
use crate::lease::Epoch;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// Change of an active mission.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum MissionChange {
    /// Serve it with this priority from now on.
    SetPriority(Priority),
    /// Give a role to another robot.
    Reassign {
        /// The role.
        role: RoleId,
        /// Robot that gets it; `None` for any but the present one.
        to: Option<RobotId>,
        /// The other robot may repeat tasks that have ended.
        repeat: bool,
    },
    /// Restrict a role that waits to a robot.
    Pin {
        /// The role.
        role: RoleId,
        /// The robot; `None` to end the order about the role.
        robot: Option<RobotId>,
    },
}

/// Cancelation of several missions.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct MissionCancelation {
    /// The missions, each with the last known places of its robots.
    pub missions: BTreeMap<MissionId, BTreeMap<RobotId, PlaceId>>,
}

/// Order of a person about a role.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RoleOrder {
    /// Robots that may get the role.
    pub restriction: RobotRestriction,
    /// Present until the holder has returned the role.
    pub pending: Option<RoleReturn>,
}

/// Return of a role that its robot holds.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RoleReturn {
    /// Epoch of the award.
    pub epoch: Epoch,
    /// The next robot may repeat tasks that have ended.
    pub repeat: bool,
    /// Person that requests it.
    pub by: String,
}

impl fmt::Display for RoleOrder {
    /// Writes the order as the state of the role: `reassigned from amber; its robot returns it`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let returns = if self.pending.is_some() { "; its robot returns it" } else { "" };
        write!(f, "{}{returns}", self.restriction)
    }
}

/// Reason for which a role is not reassigned or pinned.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum ReassignProblem {
    /// People perform it.
    #[error("is a role of people")]
    People,
    /// It has ended.
    #[error("has ended")]
    Ended,
    /// It is open already, and no robot is named.
    #[error("has no robot; name the robot that should get it")]
    NoHolder,
    /// Another robot holds it.
    #[error("is held by {robot}; reassign it instead")]
    Held {
        /// Its robot.
        robot: RobotId,
    },
    /// The named robot holds it, or will get it.
    #[error("belongs to {robot} already")]
    SameRobot {
        /// The robot.
        robot: RobotId,
    },
    /// Its robot has an item.
    #[error("cannot leave {robot}, which has, or may have, the {item}")]
    Custody {
        /// Its robot.
        robot: RobotId,
        /// The item.
        item: ItemId,
    },
    /// Other roles have been signalled about its work.
    #[error("cannot start again, because other roles have acted on its work")]
    ActedUpon,
    /// Tasks of the role have ended.
    #[error(
        "has ended tasks, which another robot would repeat: {}; `repeat` permits it",
        .tasks.iter().map(TaskId::as_str).collect::<Vec<_>>().join(", ")
    )]
    TasksEnded {
        /// The tasks.
        tasks: Vec<TaskId>,
    },
}
