//! Awards of roles, their epochs, and their ends.

use crate::ids::{MissionId, RobotId, RoleId};
use crate::plan::LocalPlan;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// Position of an award in the history of the fleet: term and index of its entry in the ledger.
/// Serves as a fencing token.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize, JsonSchema)]
pub struct Epoch {
    /// Term of the coordinator.
    pub term: u64,
    /// Index in the ledger's log.
    pub index: u64,
}

impl fmt::Display for Epoch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.term, self.index)
    }
}

/// Role awarded to a robot, with all data needed to start.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Award {
    /// The mission.
    pub mission: MissionId,
    /// The role in it.
    pub role: RoleId,
    /// Robot that gets the role.
    pub robot: RobotId,
    /// Epoch of this award.
    pub epoch: Epoch,
    /// Local plan to execute.
    pub plan: LocalPlan,
    /// Holders of the mission's managed roles.
    pub holders: BTreeMap<RoleId, RoleHolder>,
}

/// Holder of a role, and the epoch of its award. Signals sent under an older epoch are ignored.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RoleHolder {
    /// The robot.
    pub robot: RobotId,
    /// Epoch of the award.
    pub epoch: Epoch,
}

impl RoleHolder {
    /// Returns the robots without the epochs.
    pub fn robots(holders: &BTreeMap<RoleId, RoleHolder>) -> BTreeMap<RoleId, RobotId> {
        holders.iter().map(|(role, holder)| (role.clone(), holder.robot.clone())).collect()
    }
}

/// Reason for which a role ended without being completed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EndReason {
    /// The mission was canceled.
    Canceled,
    /// The mission failed elsewhere.
    Failed,
    /// The mission has ended.
    Over,
    /// A later award of the role has replaced the reported award.
    Replaced,
    /// The role was released; another robot will take it over.
    Released,
    /// The mission waits for a person, since a robot still has an item.
    #[serde(alias = "rescue")]
    NeedsIntervention,
}

/// Reason for which a robot declines an award.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum DeclineReason {
    /// The robot holds another role. A robot holds at most 1 role.
    #[error("holds {role} of {mission}")]
    Busy {
        /// Mission of the role that it holds.
        mission: MissionId,
        /// Role that it holds.
        role: RoleId,
    },
    /// The robot has received a later award of the same role; common when messages overtake each
    /// other.
    #[error("has already received epoch {known}")]
    Stale {
        /// Epoch of the later award.
        known: Epoch,
    },
    /// The award is for another robot.
    #[error("is not {robot}, to which the award was made")]
    WrongRobot {
        /// Robot named in the award.
        robot: RobotId,
    },
    /// The robot accepts no new role, since it is about to leave the fleet.
    #[error("is leaving the fleet")]
    Leaving,
}
