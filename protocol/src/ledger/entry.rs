//! What the ledger keeps of each mission.

use crate::auction::AuctionRecord;
use crate::ids::{MissionId, RequestId, RobotId, RoleId};
use crate::lease::{Epoch, Holding};
use crate::mission::{Mission, RoleKind};
use crate::plan::{Division, LocalPlan, StepAction, StepIndex};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// A mission as it was asked for: checked and divided.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Submission {
    /// The client's name for the request: sent twice, it is answered twice and done once.
    pub request: RequestId,
    /// What is to be done.
    pub mission: Mission,
    /// By whom and in step with whom; proven free of deadlock before it was submitted.
    pub division: Division,
    /// What the client gave for the mission's parameters, to show.
    pub parameters: BTreeMap<String, String>,
    /// When it was submitted: milliseconds on the accepting coordinator's wall clock, to show; nothing is decided by it.
    pub at_ms: u64,
}

/// A mission in the ledger.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MissionEntry {
    /// Its id.
    pub id: MissionId,
    /// Its place among all missions ever submitted, from 1: the order in which they are served.
    pub number: u64,
    /// What was asked.
    pub submission: Submission,
    /// How it stands.
    pub state: MissionState,
    /// Its roles, the unmanaged ones too.
    pub roles: BTreeMap<RoleId, RoleEntry>,
    /// The latest auction held for it.
    pub auction: Option<AuctionRecord>,
}

/// How a mission stands.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MissionState {
    /// Some managed role is open.
    Pending,
    /// All managed roles are held or ended.
    Running,
    /// Carried out.
    Completed,
    /// Given up.
    Failed {
        /// Why, in words.
        cause: String,
    },
    /// Withdrawn.
    Canceled {
        /// On whose word.
        by: String,
    },
}

impl MissionState {
    /// Whether nothing more will come of the mission.
    pub fn is_end(&self) -> bool {
        match self {
            MissionState::Pending | MissionState::Running => false,
            MissionState::Completed | MissionState::Failed { .. } | MissionState::Canceled { .. } => true,
        }
    }

    /// One word for it.
    pub fn word(&self) -> &'static str {
        match self {
            MissionState::Pending => "pending",
            MissionState::Running => "running",
            MissionState::Completed => "completed",
            MissionState::Failed { .. } => "failed",
            MissionState::Canceled { .. } => "canceled",
        }
    }
}

/// How a role stands.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RoleEntry {
    /// Whether a robot fills it.
    pub kind: RoleKind,
    /// Open, awarded, active or ended.
    pub phase: RolePhase,
    /// Who has it; stays after the end, to show who did it.
    pub holder: Option<Holder>,
    /// Steps of its local plan that have ended.
    pub ended: BTreeSet<StepIndex>,
}

/// How far the filling of a role has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RolePhase {
    /// Nobody has it.
    Open,
    /// Given to a robot that has not confirmed it yet.
    Awarded,
    /// Confirmed by its holder.
    Active,
    /// Carried out.
    Ended,
}

/// Who holds a role.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Holder {
    /// The robot.
    pub robot: RobotId,
    /// By which award.
    pub epoch: Epoch,
    /// In which life of the robot's node it confirmed; a later life knows nothing of the plan.
    pub incarnation: Option<u64>,
}

impl MissionEntry {
    /// The managed roles that nobody has, unless the mission has ended.
    pub fn open_roles(&self) -> BTreeSet<RoleId> {
        if self.state.is_end() {
            return BTreeSet::new();
        }
        let open = |(_, role): &(&RoleId, &RoleEntry)| role.kind == RoleKind::Managed && role.phase == RolePhase::Open;
        self.roles.iter().filter(open).map(|(id, _)| id.clone()).collect()
    }

    /// Who holds, or has carried out, the managed roles.
    pub fn holders(&self) -> BTreeMap<RoleId, RobotId> {
        let holder = |(id, role): (&RoleId, &RoleEntry)| Some((id.clone(), role.holder.as_ref()?.robot.clone()));
        self.roles.iter().filter_map(holder).collect()
    }

    /// The same with the awards.
    pub fn holdings(&self) -> BTreeMap<RoleId, Holding> {
        let holding = |holder: &Holder| Holding { robot: holder.robot.clone(), epoch: holder.epoch };
        let held = self.roles.iter().filter_map(|(id, role)| Some((id.clone(), holding(role.holder.as_ref()?))));
        held.collect()
    }

    /// A role's local plan.
    pub fn plan(&self, role: &RoleId) -> Option<&LocalPlan> {
        self.submission.division.plans.get(role)
    }

    /// Steps ended and steps in all, over all managed roles.
    pub fn progress(&self) -> (usize, usize) {
        let managed = self.roles.iter().filter(|(_, role)| role.kind == RoleKind::Managed);
        managed.fold((0, 0), |(done, all), (id, role)| {
            (done + role.ended.len(), all + self.plan(id).map_or(0, |plan| plan.steps.len()))
        })
    }

    /// Whether something that the role did has been told to others, so that it cannot simply be begun anew elsewhere: by
    /// its own account, or because somebody who waited for it has gone on.
    pub(super) fn has_told(&self, teller: &RoleId) -> bool {
        self.roles.iter().any(|(id, role)| {
            let steps = self.plan(id).map_or(&[][..], |plan| &plan.steps);
            role.ended.iter().filter_map(|step| steps.get(*step as usize)).any(|step| match &step.action {
                StepAction::Send(_) => id == teller,
                StepAction::Wait(signal) => signal.from == *teller,
                StepAction::Task { .. } => false,
            })
        })
    }
}
