//! What the ledger keeps of each mission.

use super::custody::HeldItem;
use crate::auction::AuctionRecord;
use crate::ids::{MissionId, RequestId, RobotId, RoleId};
use crate::lease::{Epoch, RoleHolder};
use crate::mission::{LostItem, Mission, RoleKind};
use crate::plan::{Division, LocalPlan, Signal, StepAction, StepIndex};
use serde::{Deserialize, Serialize};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

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
    /// What is done instead if a robot is lost that has an item.
    pub recovery: Option<RecoveryBranch>,
    /// Which of two waiting missions is served first: the one of higher priority, then the earlier.
    pub priority: Priority,
    /// When the mission should be done: milliseconds since 1970 on the accepting coordinator's wall clock. Deadlines trust
    /// the wall clocks of coordinators, leases never do.
    pub deadline_ms: Option<u64>,
    /// When it was submitted: milliseconds on the accepting coordinator's wall clock, to show; nothing is decided by it.
    pub at_ms: u64,
}

impl Submission {
    /// A request for a mission and nothing beyond it: no recovery branch, of usual priority, without a deadline, made at 0.
    pub fn of(request: RequestId, mission: Mission, division: Division) -> Submission {
        Submission {
            request,
            mission,
            division,
            parameters: BTreeMap::new(),
            recovery: None,
            priority: Priority::default(),
            deadline_ms: None,
            at_ms: 0,
        }
    }
}

/// A mission's recovery branch, divided and proven like the mission itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RecoveryBranch {
    /// What is to be done.
    pub mission: Mission,
    /// By whom and in step with whom.
    pub division: Division,
}

impl RecoveryBranch {
    /// The branch for what was lost; `None` if it asks for what is not known.
    fn filled(&self, lost: &LostItem) -> Option<RecoveryBranch> {
        let mut division = self.division.clone();
        for plan in division.plans.values_mut() {
            for step in &mut plan.steps {
                if let StepAction::Task { spec, .. } = &mut step.action {
                    *spec = lost.substitute(spec.clone())?;
                }
            }
            for (_, spec) in plan.alternatives.iter_mut().flat_map(|other| &mut other.tasks) {
                *spec = lost.substitute(spec.clone())?;
            }
        }
        Some(RecoveryBranch { mission: lost.substitute_mission(self.mission.clone())?, division })
    }
}

/// How urgent a mission is: -100 to 100, higher first.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "i8", into = "i8")]
pub struct Priority(i8);

/// A number that is no priority.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{0} is no priority; allowed are -100 to 100, and higher ones are served first")]
pub struct PriorityError(i64);

impl Priority {
    /// Takes a number as a priority.
    ///
    /// # Errors
    /// [`PriorityError`] if it is none.
    pub fn new(number: i64) -> Result<Self, PriorityError> {
        match i8::try_from(number) {
            Ok(small @ -100..=100) => Ok(Priority(small)),
            _ => Err(PriorityError(number)),
        }
    }

    /// As a number.
    pub fn get(self) -> i8 {
        self.0
    }
}

/// Longest time until a deadline: ten years of seconds.
const ALLOWED_MAX_S: f64 = 315_360_000.0;

/// A time in which no mission can be done, or be waited for. Nothing was asked for.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("allowed are more than 0 and at most {ALLOWED_MAX_S} seconds")]
pub struct DeadlineError;

/// Reads the time, in seconds from now, in which a mission should be done.
///
/// # Errors
/// [`DeadlineError`] if it is none, has passed, or is longer than ten years.
pub fn time_until_deadline(seconds: f64) -> Result<Duration, DeadlineError> {
    match Duration::try_from_secs_f64(seconds) {
        Ok(time) if seconds > 0.0 && seconds <= ALLOWED_MAX_S => Ok(time),
        _ => Err(DeadlineError),
    }
}

impl TryFrom<i8> for Priority {
    type Error = PriorityError;
    fn try_from(number: i8) -> Result<Self, PriorityError> {
        Priority::new(number.into())
    }
}

impl From<Priority> for i8 {
    fn from(priority: Priority) -> i8 {
        priority.0
    }
}

/// A mission in the ledger.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MissionEntry {
    /// Its id.
    pub id: MissionId,
    /// Its place among all missions ever submitted, from 1: of missions of one priority, the order in which they are served.
    pub number: u64,
    /// What was asked.
    pub submission: Submission,
    /// How it stands.
    pub state: MissionState,
    /// Its roles, the unmanaged ones too.
    pub roles: BTreeMap<RoleId, RoleEntry>,
    /// The latest auction held for it.
    pub auction: Option<AuctionRecord>,
    /// Whether its recovery branch was taken.
    pub branch: Branch,
    /// What was in robots' keeping when the recovery branch was taken.
    pub items_at_recovery: Vec<HeldItem>,
    /// The awards in force when the recovery branch was taken, until its roles are given out: their holders may act on them
    /// for as long as their leases last.
    pub former_holders: Vec<RoleHolder>,
    /// The robots that its roles were taken from, oldest first; of more than [`RELEASES_KEPT`] not all.
    pub releases: Vec<RoleRelease>,
    /// How many there were.
    pub release_count: u32,
}

/// How many releases are kept to be looked at.
pub const RELEASES_KEPT: usize = 16;

/// Which part of a mission is carried out.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Branch {
    /// What was asked for.
    #[default]
    Main,
    /// What is done because something was lost. A mission that takes it never goes back.
    Recovery,
}

impl Branch {
    /// One word for it.
    pub fn as_str(self) -> &'static str {
        match self {
            Branch::Main => "main",
            Branch::Recovery => "recovery",
        }
    }
}

/// A role that was taken from a robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RoleRelease {
    /// The role.
    pub role: RoleId,
    /// Who had it.
    pub robot: RobotId,
    /// Why it was taken away, in words.
    pub cause: String,
    /// Whether the robot failed at the role, and is not asked for it again in this mission.
    pub blamed: bool,
    /// Whether it had confirmed the role. One that never did counts for little.
    pub confirmed: bool,
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
    /// Given up or withdrawn while robots had something in their hands: nothing more is done about it by the fleet, and it
    /// is kept until a person closes it.
    NeedsRescue {
        /// Why, in words.
        cause: String,
        /// What is where.
        items: Vec<HeldItem>,
    },
}

impl MissionState {
    /// Whether the fleet does nothing more about the mission.
    pub fn is_final(&self) -> bool {
        match self {
            MissionState::Pending | MissionState::Running => false,
            MissionState::Completed | MissionState::Failed { .. } | MissionState::Canceled { .. } => true,
            MissionState::NeedsRescue { .. } => true,
        }
    }

    /// Whether it waits for a person to close it.
    pub fn needs_intervention(&self) -> bool {
        matches!(self, MissionState::NeedsRescue { .. })
    }

    /// One word for it.
    pub fn as_str(&self) -> &'static str {
        match self {
            MissionState::Pending => "pending",
            MissionState::Running => "running",
            MissionState::Completed => "completed",
            MissionState::Failed { .. } => "failed",
            MissionState::Canceled { .. } => "canceled",
            MissionState::NeedsRescue { .. } => "needs_rescue",
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
    pub holder: Option<RoleAssignment>,
    /// Steps of its local plan that have ended.
    pub ended: BTreeSet<StepIndex>,
}

impl RoleEntry {
    /// The roles of a mission, which nobody holds yet.
    pub(super) fn all_open(mission: &Mission) -> BTreeMap<RoleId, RoleEntry> {
        let open = |kind| RoleEntry { kind, phase: RolePhase::Open, holder: None, ended: BTreeSet::new() };
        mission.roles.iter().map(|(role, declared)| (role.clone(), open(declared.kind))).collect()
    }
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
pub struct RoleAssignment {
    /// The robot.
    pub robot: RobotId,
    /// By which award.
    pub epoch: Epoch,
    /// In which life of the robot's node it confirmed. A later life knows nothing of the plan, unless it says that it took
    /// it up from what the former one had written down.
    pub incarnation: Option<u64>,
}

impl MissionEntry {
    /// The managed roles that nobody has, unless the mission has ended.
    pub fn open_roles(&self) -> BTreeSet<RoleId> {
        if self.state.is_final() {
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
    pub fn role_holders(&self) -> BTreeMap<RoleId, RoleHolder> {
        let holding = |holder: &RoleAssignment| RoleHolder { robot: holder.robot.clone(), epoch: holder.epoch };
        let held = self.roles.iter().filter_map(|(id, role)| Some((id.clone(), holding(role.holder.as_ref()?))));
        held.collect()
    }

    /// What other roles have told a role, by the steps of theirs that have ended. It outlives those who told it.
    pub fn signals_to(&self, hearer: &RoleId) -> BTreeSet<Signal> {
        let tellers = self.roles.iter().filter_map(|(id, role)| Some((role, self.plan(id)?)));
        let steps =
            tellers.flat_map(|(role, plan)| role.ended.iter().filter_map(|step| plan.steps.get(*step as usize)));
        let told = steps.filter_map(|step| match &step.action {
            StepAction::Send(signal) => Some(signal),
            StepAction::Task { .. } | StepAction::Wait(_) => None,
        });
        told.filter(|signal| signal.to == *hearer).cloned().collect()
    }

    /// A role's local plan.
    pub fn plan(&self, role: &RoleId) -> Option<&LocalPlan> {
        self.division()?.plans.get(role)
    }

    /// What is to be done, in the branch that is taken.
    pub fn mission(&self) -> &Mission {
        match (&self.submission.recovery, self.branch) {
            (Some(recovery), Branch::Recovery) => &recovery.mission,
            (_, Branch::Main | Branch::Recovery) => &self.submission.mission,
        }
    }

    /// The plans of the branch that is taken.
    pub(super) fn division(&self) -> Option<&Division> {
        match self.branch {
            Branch::Main => Some(&self.submission.division),
            Branch::Recovery => self.submission.recovery.as_ref().map(|recovery| &recovery.division),
        }
    }

    /// In which order missions are served: smallest first.
    pub fn rank(&self) -> (Reverse<Priority>, u64) {
        (Reverse(self.submission.priority), self.number)
    }

    /// The robots that failed at a role of this mission, and why: they are not asked for it again.
    pub fn excluded(&self, role: &RoleId) -> BTreeMap<RobotId, String> {
        let blamed = self.releases.iter().filter(|released| released.blamed && released.role == *role);
        blamed.map(|released| (released.robot.clone(), released.cause.clone())).collect()
    }

    /// Goes over to the recovery branch for what was lost, if there is one that has not been taken and that asks for
    /// nothing that is not known. All its roles are open.
    pub(super) fn recover(&mut self, lost: &HeldItem, kept: Vec<HeldItem>) -> bool {
        let from = lost.role.clone();
        let lost = LostItem { item: lost.item.clone(), robot: lost.robot.clone(), place: lost.place.clone() };
        let filled = match self.branch {
            Branch::Main => self.submission.recovery.as_ref().and_then(|recovery| recovery.filled(&lost)),
            Branch::Recovery => None,
        };
        let Some(filled) = filled else { return false };
        let in_force = |(_, role): &(&RoleId, &RoleEntry)| matches!(role.phase, RolePhase::Awarded | RolePhase::Active);
        let others = self.roles.iter().filter(|(id, _)| **id != from).filter(in_force);
        self.former_holders = others
            .filter_map(|(_, role)| role.holder.as_ref())
            .map(|holder| RoleHolder { robot: holder.robot.clone(), epoch: holder.epoch })
            .collect();
        self.roles = RoleEntry::all_open(&filled.mission);
        self.submission.recovery = Some(filled);
        self.branch = Branch::Recovery;
        self.items_at_recovery = kept;
        self.auction = None;
        self.state = MissionState::Pending;
        true
    }

    /// Steps ended and steps in all, over all managed roles.
    pub fn progress(&self) -> (usize, usize) {
        let managed = self.roles.iter().filter(|(_, role)| role.kind == RoleKind::Managed);
        managed.fold((0, 0), |(done, all), (id, role)| {
            (done + role.ended.len(), all + self.plan(id).map_or(0, |plan| plan.steps.len()))
        })
    }
}
