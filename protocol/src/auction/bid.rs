//! Calls, bids and refusals as values, and the viability check of bids.

use super::charging_stop::ChargingStop;
use super::insertion::{Objective, PlannedRole, Timelines};
use crate::bounds::{self, ELEMENTS_MAX};
use crate::ids::{EnsembleId, ItemId, MissionId, PlaceId, RobotId, RoleId, TaskId, TaskType};
use crate::mission::{ENSEMBLES_MAX, ROLES_MAX};
use crate::plan::LocalPlan;
use crate::units::{BatteryShare, Energy, Seconds};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Round of bidding for the open roles of a mission.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
pub struct AuctionId {
    /// The mission.
    pub mission: MissionId,
    /// Term of the coordinator that sent the call.
    pub term: u64,
    /// Number of the round among the rounds of this coordinator for this mission, from 1.
    pub round: u32,
}

/// Call for bids from the coordinator to the members of ensembles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CallForBids {
    /// Round of the auction.
    pub auction: AuctionId,
    /// Ensembles whose members are invited. Empty: those of every ensemble.
    #[serde(deserialize_with = "bounds::collection::<_, _, ENSEMBLES_MAX>")]
    pub ensembles: Vec<EnsembleId>,
    /// Local plan of each open role.
    #[serde(deserialize_with = "bounds::collection::<_, _, ROLES_MAX>")]
    pub roles: BTreeMap<RoleId, LocalPlan>,
    /// Conditions on the robots, for the roles that have one.
    #[serde(deserialize_with = "bounds::collection::<_, _, ROLES_MAX>")]
    pub eligible: BTreeMap<RoleId, String>,
    /// Roles that may stay open: those of spread loops.
    #[serde(deserialize_with = "bounds::collection::<_, _, ROLES_MAX>")]
    pub spread: BTreeSet<RoleId>,
    /// Timelines of the robots, and the objective of bids.
    pub timelines: Timelines,
}

/// Replies of a robot to a call: a bid or a refusal for each role.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BidResponse {
    /// Robot that replies.
    pub robot: RobotId,
    /// Round that the robot replies to.
    pub auction: AuctionId,
    /// Replies in the order of the roles' names.
    #[serde(deserialize_with = "bounds::collection::<_, _, ROLES_MAX>")]
    pub replies: Vec<RoleReply>,
}

/// Reply of a robot for a single role.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RoleReply {
    /// The robot can take the role at this cost.
    Bid(Bid),
    /// The robot does not take the role, for this reason.
    Refusal(BidRefusal),
}

/// Bid of a robot for a single role.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Bid {
    /// Robot that bids.
    pub robot: RobotId,
    /// Role.
    pub role: RoleId,
    /// Time for the whole plan.
    pub time: Seconds,
    /// Charge needed, as a share of a full battery: the estimated use of all steps, plus a reserve
    /// if the robot has data on the error of its estimates. May exceed 1.
    pub energy: f64,
    /// Charge left afterwards, as a share of a full battery; negative if the battery would not
    /// last. With a planned stop at a charger it is too little: the charge that would be left without the stop.
    pub remaining: f64,
    /// Charge below which the robot is no longer useful, as stated by the robot.
    pub useful_charge: BatteryShare,
    /// Place where the plan starts.
    pub from: PlaceId,
    /// Age of the place and battery values, in milliseconds.
    pub age_ms: u64,
    /// Cost of each step.
    #[serde(deserialize_with = "bounds::collection::<_, _, ELEMENTS_MAX>")]
    pub parts: Vec<BidPart>,
    /// Role that the robot holds. The bid is for the time after its end.
    #[serde(default)]
    pub present: Option<PresentRole>,
    /// Position of the role in the timeline of the robot, if it states it.
    #[serde(default)]
    pub planned: Option<Box<PlannedRole>>,
}

/// Role that a robot holds while it bids for a role of another mission.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PresentRole {
    /// Mission of the role.
    pub mission: MissionId,
    /// The role.
    pub role: RoleId,
    /// Estimated time for its remaining tasks. It may have to wait for others besides.
    pub time: Seconds,
}

impl From<&PresentRole> for RefusalReason {
    fn from(present: &PresentRole) -> RefusalReason {
        RefusalReason::Busy { mission: present.mission.clone(), role: present.role.clone() }
    }
}

/// Cost of a single step of a local plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct BidPart {
    /// Index of the step.
    pub step: u32,
    /// Name of the task or of the signal.
    #[serde(deserialize_with = "bounds::text")]
    pub label: String,
    /// Skill that executes the step.
    pub skill: TaskType,
    /// Duration of the step.
    pub time: Seconds,
    /// Charge used, as a share of a full battery.
    pub energy: f64,
}

/// Estimate of the tasks of a role, without waits for other robots.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RoleEstimate {
    /// Time of the tasks.
    pub time: Seconds,
    /// Energy of the tasks.
    pub energy: Energy,
}

/// Refusal of a single role by a robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BidRefusal {
    /// Robot that refuses.
    pub robot: RobotId,
    /// Role refused.
    pub role: RoleId,
    /// Reason of the refusal.
    pub reason: RefusalReason,
}

/// Reason for a refusal, for programs and (through `Display`) for people.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema, thiserror::Error)]
#[serde(rename_all = "snake_case")]
pub enum RefusalReason {
    /// The robot lacks skills that the role needs.
    #[error("lacks {}", list(.skills))]
    MissingSkills {
        /// Missing skills, in the order of their names.
        #[serde(deserialize_with = "bounds::collection::<_, _, ELEMENTS_MAX>")]
        skills: Vec<TaskType>,
    },
    /// The robot holds another role.
    #[error("busy as {role} of {mission}")]
    Busy {
        /// Mission of that role.
        mission: MissionId,
        /// Role that it holds.
        role: RoleId,
    },
    /// The robot's estimator could not compute the cost of a task (no route, unknown place, …).
    #[error("cannot do {task}: {problem}")]
    NotFeasible {
        /// The task.
        task: TaskId,
        /// Error of the estimator.
        #[serde(deserialize_with = "bounds::text")]
        problem: String,
    },
    /// The robot cannot move: its battery is empty, or its driver does not respond.
    #[error("out of service: {problem}")]
    OutOfService {
        /// Description of the problem.
        #[serde(deserialize_with = "bounds::text")]
        problem: String,
    },
    /// The robot is not a member of any ensemble that was called, according to its own record.
    #[error("not a member of {why}")]
    NotMember {
        /// The ensembles, each with the condition that is false.
        #[serde(deserialize_with = "bounds::text")]
        why: String,
    },
    /// The robot does not meet the condition of the role on its robot.
    #[error("not eligible: {why}")]
    NotEligible {
        /// The condition, with the reason.
        #[serde(deserialize_with = "bounds::text")]
        why: String,
        /// True if nothing that the robot does changes it.
        permanent: bool,
    },
    /// Members of an ensemble that the mission names earlier can take all its roles. Set by the
    /// coordinator.
    #[error("members of {ensemble} come first")]
    NotPreferred {
        /// The ensemble.
        ensemble: EnsembleId,
    },
    /// The robot has an item of a mission that waits for a person. Set by the coordinator.
    #[error("has the {item} of {mission}, which needs intervention")]
    #[serde(alias = "hands_full")]
    CarriesItem {
        /// Item that it has, or may have.
        item: ItemId,
        /// Mission that waits.
        mission: MissionId,
    },
    /// The robot held this role of the mission and failed. Set by the coordinator.
    #[error("failed at it before: {cause}")]
    Excluded {
        /// Cause of the release.
        #[serde(deserialize_with = "bounds::text")]
        cause: String,
    },
    /// The robot was invited and did not reply in time. Set by the coordinator on its behalf.
    #[error("no reply within {window_ms} ms")]
    Silent {
        /// Time waited, in milliseconds.
        window_ms: u64,
    },
    /// After the role, the robot could not reach a charger with its reserve.
    #[error("could not reach a charger afterwards: {problem}")]
    ChargerOutOfReach {
        /// The nearest charger that it may use; `None` if there is no way to any of them.
        charger: Option<PlaceId>,
        /// Charge left there and the reserve, or the missing way.
        #[serde(deserialize_with = "bounds::text")]
        problem: String,
    },
}

impl RefusalReason {
    /// Shortens the text of the reason, as if it were received from another node.
    pub(super) fn limit_text(&mut self) {
        match self {
            RefusalReason::NotFeasible { problem: text, .. }
            | RefusalReason::OutOfService { problem: text }
            | RefusalReason::NotMember { why: text }
            | RefusalReason::NotEligible { why: text, .. }
            | RefusalReason::Excluded { cause: text }
            | RefusalReason::ChargerOutOfReach { problem: text, .. } => {
                bounds::limit_text(text, bounds::TEXT_BYTES_MAX);
            }
            RefusalReason::MissingSkills { .. }
            | RefusalReason::Busy { .. }
            | RefusalReason::CarriesItem { .. }
            | RefusalReason::NotPreferred { .. }
            | RefusalReason::Silent { .. } => {}
        }
    }

    /// Checks whether the robot does not suit the role, whatever else it does: it would refuse the role at its turn, too.
    pub fn is_unsuited(&self) -> bool {
        matches!(
            self,
            RefusalReason::MissingSkills { .. }
                | RefusalReason::NotFeasible { .. }
                | RefusalReason::NotMember { .. }
                | RefusalReason::NotEligible { .. }
        )
    }

    /// Checks whether the refusal is permanent for this mission: nothing that the robot does
    /// meanwhile changes it.
    pub fn is_permanent(&self) -> bool {
        match self {
            RefusalReason::MissingSkills { .. }
            | RefusalReason::NotFeasible { .. }
            | RefusalReason::Excluded { .. } => true,
            RefusalReason::NotEligible { permanent, .. } => *permanent,
            RefusalReason::Busy { .. }
            | RefusalReason::OutOfService { .. }
            | RefusalReason::NotMember { .. }
            | RefusalReason::NotPreferred { .. }
            | RefusalReason::CarriesItem { .. }
            | RefusalReason::Silent { .. }
            | RefusalReason::ChargerOutOfReach { .. } => false,
        }
    }
}

pub(super) fn list(skills: &[TaskType]) -> String {
    skills.iter().map(TaskType::as_str).collect::<Vec<_>>().join(", ")
}

/// Limits for every bid. Fleet-wide.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BidLimits {
    /// Maximum time of a plan; `None` for no limit.
    pub time: Option<Seconds>,
    /// Minimum charge left; a bid must leave more. Default 0.05: below it a robot stops.
    pub charge_min: BatteryShare,
}

impl Default for BidLimits {
    fn default() -> Self {
        BidLimits { time: None, charge_min: BatteryShare::new(0.05).expect("0.05 is a share") }
    }
}

impl BidLimits {
    /// Returns the minimum charge left for a robot with this useful charge.
    pub fn charge_floor(&self, useful_charge: BatteryShare) -> BatteryShare {
        if useful_charge > self.charge_min { useful_charge } else { self.charge_min }
    }
}

/// Error: a bid is outside the limits.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema, thiserror::Error)]
#[serde(rename_all = "snake_case")]
pub enum ViabilityError {
    /// The plan would take too long.
    #[error("{time:.1} is longer than the limit of {limit:.1}")]
    TooSlow {
        /// Time of the bid.
        time: Seconds,
        /// The limit.
        limit: Seconds,
    },
    /// Too little charge would be left.
    #[error("{:.1} % charge left is not above {:.1} %", .remaining * 100.0, .floor.get() * 100.0)]
    LowCharge {
        /// Charge left, as a share; negative if the battery would not last.
        remaining: f64,
        /// Minimum that it must exceed.
        floor: BatteryShare,
    },
}

/// Maximum cost of a bid: sums of such costs are exact.
const COST_MAX: f64 = 1e15;

/// Returns the cost of a time in seconds and an energy in full batteries, from 0 to the maximum.
pub(super) fn bounded_cost(objective: Objective, time_s: f64, energy: f64) -> f64 {
    let cost = objective.cost(time_s, energy);
    if cost.is_nan() { COST_MAX } else { cost.clamp(0.0, COST_MAX) }
}

impl Bid {
    /// Returns the estimate of the tasks of the role.
    pub fn estimate(&self) -> RoleEstimate {
        RoleEstimate { time: self.parts.iter().map(|part| part.time).sum(), energy: Energy::of_share(self.energy) }
    }

    /// Returns the stop at a charger that the robot plans before the role.
    pub fn charging_stop(&self) -> Option<&ChargingStop> {
        self.planned.as_ref()?.charging.as_ref()
    }

    /// Returns the marginal cost of the bid: its time, the delay of the promised roles after it, and its energy with that
    /// of the additional drives.
    pub(super) fn cost(&self, objective: Objective) -> f64 {
        let planned = self.planned.as_ref();
        let (delay_s, detour) = planned.map_or((0.0, 0.0), |planned| (planned.delay_sum_s(), planned.detour_energy));
        bounded_cost(objective, self.time.get() + delay_s, self.energy + detour)
    }

    /// Checks the bid against the limits: the time limit, and a remaining charge above both the
    /// fleet's minimum and the robot's own useful charge.
    ///
    /// # Errors
    /// [`ViabilityError`] states the limit that the bid violates, and by how much.
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
