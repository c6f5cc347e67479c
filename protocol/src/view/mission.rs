//! Views of missions.

use super::{readable, readable_or_default};
use crate::auction::{AuctionRecord, ChargingStop, Explanation, RoleOfMission};
use crate::ids::{EnsembleId, MissionId, RequestId, RobotId, RoleId, TaskId, TaskType};
use crate::ledger::{Branch, HeldItem, MissionState, Priority, RolePhase, RoleRelease};
use crate::mission::{RoleKind, TaskNode, TaskOrder};
use crate::plan::StepIndex;
use crate::scalar::Scalar;
use crate::units::{Energy, EnergyLimit, Seconds};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A summary of all missions.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MissionsView {
    /// The missions in the order of submission.
    #[serde(deserialize_with = "readable")]
    pub missions: Vec<MissionSummary>,
}

/// Summary of a mission.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MissionSummary {
    /// Common part of all views of a mission.
    #[serde(flatten)]
    pub brief: MissionBrief,
    /// Reason for which the latest auction assigned no role; null if it did.
    // Recordings of earlier releases use the name `why_pending`.
    #[serde(default, alias = "why_pending")]
    pub pending_reason: Option<String>,
}

/// Common part of all views of a mission.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MissionBrief {
    /// Id of the mission.
    pub mission: MissionId,
    /// Number among all missions ever submitted, from 1; 0 if it is not known.
    #[serde(default)]
    pub number: u64,
    /// State of the mission.
    #[serde(flatten)]
    pub status: MissionStatus,
    /// Terms of the request.
    #[serde(flatten)]
    pub terms: RequestTerms,
    /// Progress of the roles.
    #[serde(flatten)]
    pub progress: MissionProgress,
    /// Results of the mission that are known, by name.
    #[serde(default)]
    pub result: BTreeMap<String, Scalar>,
}

/// State of a mission.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MissionStatus {
    /// Name of the state.
    #[serde(default)]
    pub state: MissionStateName,
    /// The state: its name, or an object with the name and its details.
    pub detail: MissionState,
    /// Branch that is executed.
    #[serde(default)]
    pub branch: Branch,
}

impl From<(&MissionState, Branch)> for MissionStatus {
    fn from((detail, branch): (&MissionState, Branch)) -> MissionStatus {
        MissionStatus { state: detail.into(), detail: detail.clone(), branch }
    }
}

/// Name of a mission's state.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MissionStateName {
    /// At least 1 managed role is open.
    #[default]
    Pending,
    /// All managed roles are held or ended.
    Running,
    /// Completed successfully.
    Completed,
    /// Failed.
    Failed,
    /// Canceled.
    Canceled,
    /// Failed or canceled while robots had items; a person closes it.
    #[serde(alias = "needs_rescue")]
    NeedsIntervention,
}

impl From<&MissionState> for MissionStateName {
    fn from(state: &MissionState) -> MissionStateName {
        match state {
            MissionState::Pending => MissionStateName::Pending,
            MissionState::Running => MissionStateName::Running,
            MissionState::Completed => MissionStateName::Completed,
            MissionState::Failed { .. } => MissionStateName::Failed,
            MissionState::Canceled { .. } => MissionStateName::Canceled,
            MissionState::NeedsIntervention { .. } => MissionStateName::NeedsIntervention,
        }
    }
}

/// Terms of a mission request.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct RequestTerms {
    /// Values of the parameters.
    pub parameters: BTreeMap<String, String>,
    /// Priority among waiting missions; higher is served first.
    pub priority: Priority,
    /// Time before which no robot gets a role and no person is asked, in milliseconds since 1970; null if
    /// there is none.
    pub not_before_at_ms: Option<u64>,
    /// Deadline in milliseconds since 1970; null if there is none.
    pub deadline_at_ms: Option<u64>,
    /// Bound on the energy of all its robots together, in full batteries; null if there is none.
    pub energy_max: Option<EnergyLimit>,
    /// Time of submission in milliseconds since 1970.
    pub submitted_at_ms: u64,
    /// Person or client that asked for the mission.
    pub by: String,
}

/// Progress of a mission's roles.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct MissionProgress {
    /// Robots that hold or have completed each role.
    pub holders: BTreeMap<RoleId, RobotId>,
    /// Robots that get a role later.
    pub promised: BTreeMap<RoleId, RobotId>,
    /// Orders of people about roles, as text: `pinned to amber`.
    pub orders: BTreeMap<RoleId, String>,
    /// Items that robots have, or that need intervention by a person.
    #[serde(deserialize_with = "readable")]
    pub items: Vec<HeldItem>,
    /// Number of ended steps, over all managed roles.
    pub done: usize,
    /// Number of steps.
    pub steps: usize,
    /// Estimated energy of its awards, in full batteries, with those that were released.
    pub energy: Energy,
}

/// A mission with the plans and the progress of its roles. A mission that ended long ago has only
/// its state and its request: the other members are empty.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MissionView {
    /// Common part of all views of a mission.
    #[serde(flatten)]
    pub brief: MissionBrief,
    /// Id of the request.
    #[serde(default)]
    pub request: Option<RequestId>,
    /// Total number of releases of its roles.
    #[serde(default)]
    pub released: u32,
    /// Latest releases of its roles, oldest first.
    #[serde(default, deserialize_with = "readable")]
    pub releases: Vec<RoleRelease>,
    /// Ensembles whose robots it prefers, in this order; empty for none.
    #[serde(default)]
    pub ensembles: Vec<EnsembleId>,
    /// Tasks of the mission, as in the ledger: the first is the root, children are indices.
    #[serde(default, deserialize_with = "readable_or_default")]
    pub tasks: Vec<TaskNode>,
    /// The tasks as a tree, each with its progress and its participants.
    #[serde(default, deserialize_with = "readable_or_default")]
    pub tree: Option<TaskView>,
    /// The roles, in the order of their names.
    #[serde(default, deserialize_with = "readable")]
    pub roles: Vec<RoleView>,
    /// The latest auction; null if there was none.
    #[serde(default, deserialize_with = "readable_or_default")]
    pub auction: Option<AuctionRecord>,
    /// Explanation of the latest auction, without the parts of the bids.
    #[serde(default, deserialize_with = "readable_or_default")]
    pub explanation: Option<Explanation>,
}

/// A role of a mission.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RoleView {
    /// The role.
    pub role: RoleId,
    /// Kind of role.
    pub kind: RoleKind,
    /// Condition on its robot; null for none.
    #[serde(default)]
    pub eligible: Option<String>,
    /// Phase of the role.
    pub phase: RolePhase,
    /// Its holder; kept after the end. Of a promised role: the robot that gets it.
    #[serde(default)]
    pub holder: Option<RobotId>,
    /// Epoch of the award, as `term.index`; null for a promise.
    #[serde(default)]
    pub epoch: Option<String>,
    /// Steps of its plan; null if it has no plan.
    #[serde(default)]
    pub steps: Option<Vec<StepView>>,
    /// Start of a promised role; null unless it is promised.
    #[serde(default, deserialize_with = "readable_or_default")]
    pub promise: Option<PromiseView>,
}

/// Planned start of a promised role.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct PromiseView {
    /// Time at which its robot is estimated to begin it, in milliseconds since 1970: the robot is free, has charged if it has to,
    /// and the roles before have done what the role waits for.
    pub planned_at_ms: u64,
    /// Time by which roles that the robot has inserted before it delay it, in seconds. The planned time contains it.
    pub delayed_s: Seconds,
    /// True if the role could start now: it only waits for its robot.
    pub can_start: bool,
    /// What the robot does before, in this order: the role that it holds, and other promised roles.
    pub after: Vec<RoleOfMission>,
    /// Stop at a charger that the robot makes before.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub charging: Option<ChargingStop>,
}

/// A step of a role's plan.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct StepView {
    /// Index in the plan.
    #[serde(default)]
    pub step: usize,
    /// Type of the task, or `send_message` or `wait_message`.
    #[serde(rename = "type")]
    pub step_type: String,
    /// Name of the task, or the signal.
    pub label: String,
    /// Steps that must have ended before it.
    #[serde(default)]
    pub after: Vec<StepIndex>,
    /// True if it has ended.
    #[serde(default)]
    pub done: bool,
}

/// A task of a mission.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum TaskView {
    /// A task with subtasks.
    Abstract {
        /// The task.
        task: TaskId,
        /// Order of its subtasks.
        order: TaskOrder,
        /// Progress of its subtasks.
        state: TaskProgress,
        /// Its subtasks.
        children: Vec<TaskView>,
    },
    /// A task that a skill executes.
    Elementary {
        /// The task.
        task: TaskId,
        /// Its type.
        #[serde(rename = "type")]
        task_type: TaskType,
        /// Parameters of the skill.
        parameters: BTreeMap<String, String>,
        /// Its progress.
        state: TaskProgress,
        /// Roles that execute it.
        roles: Vec<TaskParticipant>,
        /// Its results, by name.
        #[serde(default)]
        results: BTreeMap<String, Scalar>,
    },
}

impl TaskView {
    /// Returns the results of the tasks of the tree that have any, by task and name.
    pub fn task_results(&self) -> BTreeMap<TaskId, BTreeMap<String, Scalar>> {
        match self {
            TaskView::Abstract { children, .. } => children.iter().flat_map(TaskView::task_results).collect(),
            TaskView::Elementary { results, .. } if results.is_empty() => BTreeMap::new(),
            TaskView::Elementary { task, results, .. } => BTreeMap::from([(task.clone(), results.clone())]),
        }
    }
}

/// Role that executes a task, with its holder.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct TaskParticipant {
    /// The role.
    pub role: RoleId,
    /// Its holder.
    pub holder: Option<RobotId>,
    /// Epoch of the award, as `term.index`.
    pub epoch: Option<String>,
}

/// Progress of a task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TaskProgress {
    /// Its predecessors have not ended.
    Waiting,
    /// It could be performed now, or a part of it is in progress.
    UnderWay,
    /// It has ended.
    Done,
    /// It has ended without being executed: its condition does not hold.
    Skipped,
}

impl TaskProgress {
    /// Returns the name.
    pub fn as_str(self) -> &'static str {
        match self {
            TaskProgress::Waiting => "waiting",
            TaskProgress::UnderWay => "under_way",
            TaskProgress::Done => "done",
            TaskProgress::Skipped => "skipped",
        }
    }

    /// Checks whether the task has ended.
    pub fn has_ended(self) -> bool {
        matches!(self, TaskProgress::Done | TaskProgress::Skipped)
    }

    /// Returns the progress of an abstract task from the progress of its parts.
    pub fn of_all(parts: &[TaskProgress]) -> TaskProgress {
        match parts {
            [_, ..] if parts.iter().all(|part| *part == TaskProgress::Skipped) => TaskProgress::Skipped,
            _ if parts.iter().all(|part| part.has_ended()) => TaskProgress::Done,
            _ if parts.iter().all(|part| *part == TaskProgress::Waiting) => TaskProgress::Waiting,
            _ => TaskProgress::UnderWay,
        }
    }
}
