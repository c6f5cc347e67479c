//! Calls, bids and refusals as values, and when a bid is viable.

use crate::ids::{EnsembleId, ItemId, MissionId, PlaceId, RobotId, RoleId, TaskId, TaskType};
use crate::plan::LocalPlan;
use crate::units::{BatteryShare, Seconds};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// One round of bidding for the open roles of a mission.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct AuctionId {
    /// The mission.
    pub mission: MissionId,
    /// Term of the coordinator that calls.
    pub term: u64,
    /// Counts the rounds that this coordinator has called for this mission, from 1.
    pub round: u32,
}

/// The coordinator's question to the members of an ensemble.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CallForBids {
    /// Which round this is.
    pub auction: AuctionId,
    /// Whose members are asked.
    pub ensemble: EnsembleId,
    /// What each open role has to do.
    pub roles: BTreeMap<RoleId, LocalPlan>,
}

/// One robot's answers to a call: one for each role in it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BidResponse {
    /// Who answers.
    pub robot: RobotId,
    /// To which call.
    pub auction: AuctionId,
    /// In the order of the roles' names.
    pub replies: Vec<RoleReply>,
}

/// What a robot says to one role.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RoleReply {
    /// It would, at this price.
    Bid(Bid),
    /// It will not, for this reason.
    Refusal(BidRefusal),
}

/// A robot's price for one role.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Bid {
    /// Who bids.
    pub robot: RobotId,
    /// For which role.
    pub role: RoleId,
    /// Time for the whole plan.
    pub time: Seconds,
    /// Charge to have for it, as a share of a full battery: what the steps use by estimate, and a reserve if the robot knows
    /// how far its estimates are off. It may exceed 1.
    pub energy: f64,
    /// Charge left afterwards, as a share of a full battery; negative when it would not last.
    pub remaining: f64,
    /// Below this charge the robot is of no further use, by its own account.
    pub useful_charge: BatteryShare,
    /// Where it would start.
    pub from: PlaceId,
    /// How old its knowledge of that place and its battery is, in milliseconds.
    pub age_ms: u64,
    /// Step by step.
    pub parts: Vec<BidPart>,
}

/// The price of one step of a local plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BidPart {
    /// Which step.
    pub step: u32,
    /// The task's name, or the message's.
    pub label: String,
    /// What carries it out.
    pub skill: TaskType,
    /// How long it takes.
    pub time: Seconds,
    /// Charge it uses, as a share of a full battery.
    pub energy: f64,
}

/// A robot's no to one role.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BidRefusal {
    /// Who refuses.
    pub robot: RobotId,
    /// Which role.
    pub role: RoleId,
    /// Why.
    pub reason: RefusalReason,
}

/// Why a robot will not, for programs and (through `Display`) for people.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[serde(rename_all = "snake_case")]
pub enum RefusalReason {
    /// It lacks skills that the role needs.
    #[error("lacks {}", list(.skills))]
    MissingSkills {
        /// Which, in the order of their names.
        skills: Vec<TaskType>,
    },
    /// It holds another role.
    #[error("busy as {role} of {mission}")]
    Busy {
        /// The mission it is at work for.
        mission: MissionId,
        /// Its role there.
        role: RoleId,
    },
    /// Its own estimator could not price a task (no route, unknown place, …).
    #[error("cannot do {task}: {problem}")]
    NotFeasible {
        /// The task.
        task: TaskId,
        /// What the estimator said.
        problem: String,
    },
    /// It cannot move: its battery ran out, or its body does not answer.
    #[error("out of service: {problem}")]
    OutOfService {
        /// What is the matter.
        problem: String,
    },
    /// By what it knows of itself, it is not a member of the ensemble that was called.
    #[error("not a member of {ensemble}: {why}")]
    NotMember {
        /// The ensemble.
        ensemble: EnsembleId,
        /// What the predicate said.
        why: String,
    },
    /// It has something of a mission that waits for a person. Said by the coordinator.
    #[error("has the {item} of {mission}, which needs rescue")]
    HandsFull {
        /// What it has, or may have.
        item: ItemId,
        /// The mission that waits.
        mission: MissionId,
    },
    /// It had the role in this mission and failed. Said by the coordinator.
    #[error("failed at it before: {cause}")]
    Excluded {
        /// Why it was taken from the robot.
        cause: String,
    },
    /// It was asked and did not answer in time. Said by the coordinator on its behalf.
    #[error("no answer within {window_ms} ms")]
    Silent {
        /// How long was waited.
        window_ms: u64,
    },
}

impl RefusalReason {
    /// Whether asking again in this mission is in vain: nothing that the robot does meanwhile changes its answer.
    pub fn is_permanent(&self) -> bool {
        match self {
            RefusalReason::MissingSkills { .. }
            | RefusalReason::NotFeasible { .. }
            | RefusalReason::Excluded { .. } => true,
            RefusalReason::Busy { .. }
            | RefusalReason::OutOfService { .. }
            | RefusalReason::NotMember { .. }
            | RefusalReason::HandsFull { .. }
            | RefusalReason::Silent { .. } => false,
        }
    }
}

fn list(skills: &[TaskType]) -> String {
    skills.iter().map(TaskType::as_str).collect::<Vec<_>>().join(", ")
}

/// What every bid must keep to. Fleet-wide.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BidLimits {
    /// Longest time a plan may take; `None` for no limit.
    pub time: Option<Seconds>,
    /// Charge that must be left above this. Default 0.05: below it a robot stops dead.
    pub charge_min: BatteryShare,
}

impl Default for BidLimits {
    fn default() -> Self {
        BidLimits { time: None, charge_min: BatteryShare::new(0.05).expect("0.05 is a share") }
    }
}

impl BidLimits {
    /// What must be left of the battery of a robot with this useful charge.
    pub fn charge_floor(&self, useful_charge: BatteryShare) -> BatteryShare {
        if useful_charge > self.charge_min { useful_charge } else { self.charge_min }
    }
}

/// Why a bid cannot be taken although it was made.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(rename_all = "snake_case")]
pub enum ViabilityError {
    /// It would take too long.
    #[error("{time:.1} is longer than the limit of {limit:.1}")]
    TooSlow {
        /// The bid's time.
        time: Seconds,
        /// The limit.
        limit: Seconds,
    },
    /// Too little charge would be left.
    #[error("{:.1} % charge left is not above {:.1} %", .remaining * 100.0, .floor.get() * 100.0)]
    LowCharge {
        /// What would be left, as a share; negative when the battery would not last.
        remaining: f64,
        /// What it has to exceed.
        floor: BatteryShare,
    },
}

impl Bid {
    /// Whether the bid may be taken: within the time limit, and with more charge left than both the fleet's minimum and
    /// the robot's own useful level.
    ///
    /// # Errors
    /// [`Unviable`] says which bound it misses and by how much.
    pub fn check_viable(&self, limits: &BidLimits) -> Result<(), ViabilityError> {
        if let Some(limit) = limits.time.filter(|limit| self.time > *limit) {
            return Err(ViabilityError::TooSlow { time: self.time, limit });
        }
        let floor = limits.charge_floor(self.useful_charge);
        if self.remaining > floor.get() {
            Ok(())
        } else {
            Err(ViabilityError::LowCharge { remaining: self.remaining, floor })
        }
    }
}
