//! Ledger entry of a mission.

use super::branch::Branch;
use super::mission_order::RoleOrder;
use super::person_request::PersonRequestEntry;
use super::submission::Submission;
use crate::auction::{AuctionId, AuctionRecord, CallForBids, ChargingStop, EnergyBudget, RoleSpan, Timelines};
use crate::cause::CauseClass;
use crate::codec;
use crate::ids::{ItemId, MissionId, PlaceId, RobotId, RoleId, TaskId};
use crate::lease::{Epoch, RoleHolder};
use crate::mission::{LostItem, Mission, OUTCOMES_BYTES_MAX, RoleKind, TaskOutcome, TaskOutcomes};
use crate::plan::{Division, LocalPlan, Signal, StepAction, StepIndex};
use crate::scalar::Scalar;
use crate::units::{Energy, EnergyLimit, Seconds};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Item in the custody of a robot, while a mission is active or waits for a person.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct HeldItem {
    /// The item.
    pub item: ItemId,
    /// Role in which the robot received the item.
    pub role: RoleId,
    /// Robot that has the item.
    pub robot: RobotId,
    /// Last known place of that robot.
    pub place: Option<PlaceId>,
    /// True if it is certain that the robot has the item.
    pub certain: bool,
}

/// Mission in the ledger.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MissionEntry {
    /// Id of the mission.
    pub id: MissionId,
    /// Number among all missions ever submitted, from 1. Missions of the same priority that are due at the same time are
    /// served in this order.
    pub number: u64,
    /// Request as submitted.
    pub submission: Submission,
    /// State of the mission.
    pub state: MissionState,
    /// Roles, including unmanaged roles.
    pub roles: BTreeMap<RoleId, RoleEntry>,
    /// Latest auction of the mission.
    pub auction: Option<AuctionRecord>,
    /// Branch that is executed.
    pub branch: Branch,
    /// Items that robots had when the recovery branch was taken.
    pub items_at_recovery: Vec<HeldItem>,
    /// Awards in force when the recovery branch was taken, until the roles of that branch are
    /// awarded: their holders may act on them until their leases expire.
    pub former_holders: Vec<RoleHolder>,
    /// Releases of roles, oldest first; at most 16.
    pub releases: Vec<RoleRelease>,
    /// Total number of releases.
    pub release_count: u32,
    /// Estimated energy of the awards that robots had confirmed and that have been released.
    pub(super) energy_of_released: Energy,
    /// Outcomes of tasks. The first outcome of a task is kept: others may have acted on it.
    pub outcomes: TaskOutcomes,
    /// Open requests to people and some closed requests, oldest first.
    pub(super) person_requests: Vec<PersonRequestEntry>,
    /// Orders of people about roles.
    pub(super) role_orders: BTreeMap<RoleId, RoleOrder>,
}

/// Maximum number of releases kept for display.
pub(super) const RELEASES_KEPT: usize = 16;

/// Release of a role from a robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RoleRelease {
    /// Role released.
    pub role: RoleId,
    /// Robot that held it.
    pub robot: RobotId,
    /// Cause, as text.
    pub cause: String,
    /// Class of the cause if the robot failed at the role; without one it was lost, or gave the role back.
    pub class: Option<CauseClass>,
    /// True if the robot had confirmed the role.
    pub confirmed: bool,
    /// True if the robot returned the role to give way.
    #[serde(default)]
    pub gave_way: bool,
}

impl RoleRelease {
    /// Checks whether the robot is not invited again for this role of the mission.
    pub fn excludes_robot(&self) -> bool {
        self.class.is_some_and(CauseClass::excludes_robot)
    }

    /// Checks whether the release counts towards the limit of releases: the robot had started, and could not go on.
    pub(super) fn counts(&self) -> bool {
        self.confirmed && !self.gave_way
    }
}

/// State of a mission.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MissionState {
    /// At least 1 managed role is open.
    Pending,
    /// All managed roles are held, promised or ended. Of a mission with spread loops: some are.
    Running,
    /// Completed successfully.
    Completed,
    /// Failed.
    Failed {
        /// Cause, as text.
        cause: String,
        /// Class of the cause.
        #[serde(default)]
        class: CauseClass,
    },
    /// Canceled.
    Canceled {
        /// Person or client that canceled it.
        by: String,
    },
    /// Failed or canceled while robots had items. The fleet takes no further action, and the entry
    /// is kept until a person closes it.
    #[serde(alias = "needs_rescue")]
    NeedsIntervention {
        /// Cause, as text.
        cause: String,
        /// Items and the robots that have them.
        items: Vec<HeldItem>,
        /// Class of the cause; `transient` if the mission was canceled.
        #[serde(default)]
        class: CauseClass,
    },
}

impl MissionState {
    /// Checks whether the fleet takes no further action for the mission.
    pub fn is_final(&self) -> bool {
        match self {
            MissionState::Pending | MissionState::Running => false,
            MissionState::Completed | MissionState::Failed { .. } | MissionState::Canceled { .. } => true,
            MissionState::NeedsIntervention { .. } => true,
        }
    }

    /// Checks whether the mission has ended and does not wait for a person.
    pub fn has_ended(&self) -> bool {
        self.is_final() && !self.needs_intervention()
    }

    /// Checks whether the mission waits for a person to close it.
    pub(crate) fn needs_intervention(&self) -> bool {
        matches!(self, MissionState::NeedsIntervention { .. })
    }

    /// Returns the name.
    pub fn as_str(&self) -> &'static str {
        match self {
            MissionState::Pending => "pending",
            MissionState::Running => "running",
            MissionState::Completed => "completed",
            MissionState::Failed { .. } => "failed",
            MissionState::Canceled { .. } => "canceled",
            MissionState::NeedsIntervention { .. } => "needs_intervention",
        }
    }
}

impl MissionEntry {
    /// Returns the roles that people have in the mission.
    pub fn unmanaged_roles(&self) -> impl Iterator<Item = &RoleId> {
        self.roles.iter().filter(|(_, role)| role.kind == RoleKind::Unmanaged).map(|(id, _)| id)
    }
}

/// State of a role.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RoleEntry {
    /// Managed or unmanaged.
    pub kind: RoleKind,
    /// Phase: open, promised, awarded, active or ended.
    pub phase: RolePhase,
    /// Holder; kept after the end, for display. Of a promised role: the robot that gets it. It is boxed, since the smallest map
    /// of roles has room for eleven, and most missions wait with a single open role.
    pub holder: Option<Box<RoleAssignment>>,
    /// Steps of its local plan that have ended.
    pub ended: BTreeSet<StepIndex>,
}

impl RoleEntry {
    /// Creates the roles of a mission, without holders.
    pub(super) fn all_open(mission: &Mission) -> BTreeMap<RoleId, RoleEntry> {
        let open = |kind| RoleEntry { kind, phase: RolePhase::Open, holder: None, ended: BTreeSet::new() };
        mission.roles.iter().map(|(role, declared)| (role.clone(), open(declared.kind))).collect()
    }
}

/// Phase of a role.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RolePhase {
    /// No robot holds it.
    Open,
    /// Awarded to a robot that has not confirmed it yet.
    Awarded,
    /// Confirmed by its holder.
    Active,
    /// Completed.
    Ended,
    /// Promised to a robot, which gets it once it holds no other role and the role can start.
    Promised,
}

/// Assignment of a role to a robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RoleAssignment {
    /// The robot.
    pub robot: RobotId,
    /// Epoch of the award, or of the promise.
    pub epoch: Epoch,
    /// Incarnation of the robot's node that confirmed the award. A later incarnation has lost the
    /// plan, unless it reports that it restored the plan from a checkpoint.
    pub incarnation: Option<u64>,
    /// Energy that its bid has estimated.
    pub energy: Energy,
    /// Time that its bid has estimated for the tasks of the role.
    pub time: Seconds,
    /// Places, time and energy of the tasks without the first drive, if its bid states them.
    pub span: Option<RoleSpan>,
    /// Position among the promised roles of the robot, while the role is promised.
    pub position: u32,
    /// Time by which roles that were inserted before it have delayed it.
    pub delayed: Seconds,
    /// Time at which the robot is estimated to be free for the role, in milliseconds since 1970, with these delays.
    pub planned_ms: u64,
    /// Stop at a charger before the role, while the role is promised.
    pub charging: Option<ChargingStop>,
}

impl RoleAssignment {
    /// Delays a promised role by an insertion before it.
    pub(super) fn delay(&mut self, time: Seconds) {
        self.delayed += time;
        self.planned_ms = later_ms(self.planned_ms, time);
    }
}

/// Returns the time after another, in milliseconds since 1970.
pub(super) fn later_ms(from_ms: u64, time: Seconds) -> u64 {
    from_ms.saturating_add((time.get() * 1000.0).round() as u64)
}

impl MissionEntry {
    /// Returns the managed roles without a holder; empty if the mission has ended.
    pub fn open_roles(&self) -> BTreeSet<RoleId> {
        if self.state.is_final() {
            return BTreeSet::new();
        }
        let open = |(_, role): &(&RoleId, &RoleEntry)| role.kind == RoleKind::Managed && role.phase == RolePhase::Open;
        self.roles.iter().filter(open).map(|(id, _)| id.clone()).collect()
    }

    /// Returns the class of the latest failure of a robot that excludes it from one of these roles.
    pub fn class_of_failures(&self, roles: &BTreeSet<RoleId>) -> CauseClass {
        let failed = self.releases.iter().rev().filter(|released| roles.contains(&released.role));
        failed.filter_map(|released| released.class).find(|class| class.excludes_robot()).unwrap_or_default()
    }

    /// Returns the state of an active mission.
    pub(super) fn active_state(&self) -> MissionState {
        let is_under_way = self.assigned_roles().next().is_some();
        match is_under_way && self.roles_to_auction().iter().all(|role| self.is_spread(role)) {
            true => MissionState::Running,
            false => MissionState::Pending,
        }
    }

    /// Returns the robots that hold, or have completed, the managed roles.
    pub fn holders(&self) -> BTreeMap<RoleId, RobotId> {
        self.role_holders().into_iter().map(|(role, holder)| (role, holder.robot)).collect()
    }

    /// Returns the holders with the epochs of their awards.
    pub fn role_holders(&self) -> BTreeMap<RoleId, RoleHolder> {
        let mut robots = self.role_robots();
        robots.retain(|role, _| self.roles.get(role).is_some_and(|role| role.phase != RolePhase::Promised));
        robots
    }

    /// Returns the robots that hold, have completed or will get the managed roles, with the epochs of their
    /// awards or promises.
    pub fn role_robots(&self) -> BTreeMap<RoleId, RoleHolder> {
        let holding = |holder: &RoleAssignment| RoleHolder { robot: holder.robot.clone(), epoch: holder.epoch };
        let held = self.roles.iter().filter_map(|(id, role)| Some((id.clone(), holding(role.holder.as_deref()?))));
        held.collect()
    }

    /// Returns the roles that robots hold now, with their entries and holders.
    pub fn held_roles(&self) -> impl Iterator<Item = (&RoleId, &RoleEntry, &RoleAssignment)> {
        let held = self.roles.iter().filter(|(_, role)| matches!(role.phase, RolePhase::Awarded | RolePhase::Active));
        held.filter_map(|(id, role)| Some((id, role, role.holder.as_deref()?)))
    }

    /// Returns the signals that other roles have sent to `receiver`, according to their ended
    /// steps. They outlive their senders.
    pub fn signals_to(&self, receiver: &RoleId) -> BTreeSet<Signal> {
        let senders = self.roles.iter().filter_map(|(id, role)| Some((role, self.plan(id)?)));
        let steps =
            senders.flat_map(|(role, plan)| role.ended.iter().filter_map(|step| plan.steps.get(*step as usize)));
        let sent = steps.filter_map(|step| match &step.action {
            StepAction::Send(signal) => Some(signal),
            StepAction::Task { .. } | StepAction::Wait(_) => None,
        });
        sent.filter(|signal| signal.to == *receiver).cloned().collect()
    }

    /// Returns the known outcomes of the tasks whose results the plan of a role uses. A task that has
    /// ended in all its roles without a result has an outcome, too.
    pub fn outcomes_for(&self, role: &RoleId) -> TaskOutcomes {
        let used = self.plan(role).map(LocalPlan::tasks_used).unwrap_or_default();
        let outcome = |task: TaskId| {
            let known = self.outcomes.get(&task).cloned();
            let outcome = known.or_else(|| self.has_ended(&task).then(|| TaskOutcome::Done(BTreeMap::new())))?;
            Some((task, outcome))
        };
        used.into_iter().filter_map(outcome).collect()
    }

    /// Checks whether a task of the role's plan has no outcome.
    pub fn lacks_outcome(&self, role: &RoleId, task: &TaskId) -> bool {
        !self.outcomes.contains_key(task) && self.plan(role).is_some_and(|plan| plan.step_of(task).is_some())
    }

    /// Adds the outcomes of tasks of a role. The results of a role are empty where they exceed what a mission
    /// may have: its holder does not follow the limits.
    pub(super) fn add_outcomes(&mut self, role: &RoleId, outcomes: TaskOutcomes) {
        for (task, outcome) in outcomes {
            if self.lacks_outcome(role, &task) {
                let outcome = outcome.limited();
                let bytes = codec::encoded_size(&self.outcomes).saturating_add(codec::encoded_size(&(&task, &outcome)));
                let fits = bytes <= 2 * OUTCOMES_BYTES_MAX;
                self.outcomes.insert(task, if fits { outcome } else { TaskOutcome::Done(BTreeMap::new()) });
            }
        }
    }

    /// Checks whether a task has ended in all its roles.
    pub(super) fn has_ended(&self, task: &TaskId) -> bool {
        let steps = self.roles.iter().filter_map(|(id, role)| Some((role, self.plan(id)?.step_of(task)?)));
        steps.clone().next().is_some() && steps.into_iter().all(|(role, step)| role.ended.contains(&step))
    }

    /// Returns the results of the mission that are known.
    pub fn results(&self) -> BTreeMap<String, Scalar> {
        self.mission().known_results(&self.outcomes)
    }

    /// Returns the local plan of a role.
    pub fn plan(&self, role: &RoleId) -> Option<&LocalPlan> {
        self.division()?.plans.get(role)
    }

    /// Returns the call for bids for these roles; `None` if there are none, or a plan is missing.
    pub fn call_for_roles(&self, called: &BTreeSet<RoleId>, auction: AuctionId) -> Option<CallForBids> {
        if called.is_empty() {
            return None;
        }
        let Mission { roles, ensembles, .. } = self.mission();
        let condition = |role: &RoleId| Some((role.clone(), roles.get(role)?.eligible.clone()?));
        let plan = |role: &RoleId| Some((role.clone(), self.plan(role)?.clone()));
        Some(CallForBids {
            auction,
            ensembles: ensembles.clone(),
            roles: called.iter().map(plan).collect::<Option<_>>()?,
            eligible: called.iter().filter_map(condition).collect(),
            spread: called.iter().filter(|role| self.is_spread(role)).cloned().collect(),
            timelines: Timelines::default(),
        })
    }

    /// Returns the mission tree of the branch that is executed.
    pub fn mission(&self) -> &Mission {
        match (&self.submission.recovery, self.branch) {
            (Some(recovery), Branch::Recovery) => &recovery.mission,
            (_, Branch::Main | Branch::Recovery) => &self.submission.mission,
        }
    }

    /// Returns the plans of the branch that is executed.
    pub(super) fn division(&self) -> Option<&Division> {
        match self.branch {
            Branch::Main => Some(&self.submission.division),
            Branch::Recovery => self.submission.recovery.as_ref().map(|recovery| &recovery.division),
        }
    }

    /// Returns the estimated energy of all awards of the mission. An award that its robot never confirmed
    /// counts only while it is in force: the robot has not started.
    pub fn estimated_energy(&self) -> Energy {
        self.estimated_energy_without(|_| false)
    }

    fn estimated_energy_without(&self, is_left_out: impl Fn(&RoleId) -> bool) -> Energy {
        let roles = self.roles.iter().filter(|(id, _)| !is_left_out(id));
        self.energy_of_released + roles.filter_map(|(_, role)| Some(role.holder.as_ref()?.energy)).sum::<Energy>()
    }

    /// Returns the bound on the energy of the mission.
    pub fn energy_max(&self) -> Option<EnergyLimit> {
        self.submission.mission.energy_max
    }

    /// Returns the bound on the energy of the mission for an auction, with the estimate for the awards so far. A promise that
    /// is auctioned again does not count.
    pub fn energy_budget(&self, call: &CallForBids) -> Option<EnergyBudget> {
        let used = self.estimated_energy_without(|role| call.roles.contains_key(role));
        Some(EnergyBudget { limit: self.energy_max()?, used })
    }

    /// Counts the energy of a role whose holder is about to be removed.
    pub(super) fn keep_energy_of(&mut self, role: &RoleId) {
        let Some(role) = self.roles.get(role) else { return };
        if let (RolePhase::Active | RolePhase::Ended, Some(holder)) = (role.phase, &role.holder) {
            self.energy_of_released += holder.energy;
        }
    }

    /// Records a release of a role.
    pub(super) fn add_release(&mut self, release: RoleRelease) {
        self.releases.push(release);
        self.release_count = self.release_count.saturating_add(1);
        if self.releases.len() > RELEASES_KEPT {
            let first_of = |may_go: &dyn Fn(&RoleRelease) -> bool| self.releases.iter().position(may_go);
            let first = first_of(&|released| !released.counts() && !released.excludes_robot());
            let first = first.or_else(|| first_of(&|released| !released.counts())).unwrap_or(0);
            self.releases.remove(first);
        }
    }

    /// Returns the number of releases of a role from robots that had not confirmed it, as far as they are kept.
    pub fn unconfirmed_releases(&self, role: &RoleId) -> u32 {
        let of_role = self.releases.iter().filter(|released| released.role == *role && !released.confirmed);
        u32::try_from(of_role.count()).unwrap_or(u32::MAX)
    }

    /// Returns the robots that failed at a role of this mission, with the causes. They are not
    /// invited again for this role.
    pub fn excluded(&self, role: &RoleId) -> BTreeMap<RobotId, String> {
        let failed = self.releases.iter().filter(|released| released.excludes_robot() && released.role == *role);
        failed.map(|released| (released.robot.clone(), released.cause.clone())).collect()
    }

    /// Returns the robots that have lost or returned a role of this mission, with the latest causes.
    pub fn former_robots(&self, role: &RoleId) -> BTreeMap<RobotId, String> {
        let released = self.releases.iter().filter(|released| released.role == *role);
        released.map(|released| (released.robot.clone(), released.cause.clone())).collect()
    }

    /// Switches to the recovery branch for the lost item. Returns false without any change if there
    /// is no such branch, if it was taken before, or if it uses a value that is not known. All its
    /// roles are open.
    pub(super) fn recover(&mut self, lost: &HeldItem, held: Vec<HeldItem>) -> bool {
        let from = lost.role.clone();
        let lost = LostItem { item: lost.item.clone(), robot: lost.robot.clone(), place: lost.place.clone() };
        let filled = match self.branch {
            Branch::Main => self.submission.recovery.as_ref().and_then(|recovery| recovery.filled(&lost)),
            Branch::Recovery => None,
        };
        let Some(filled) = filled else { return false };
        let others = self.held_roles().filter(|(id, ..)| **id != from);
        self.former_holders =
            others.map(|(.., holder)| RoleHolder { robot: holder.robot.clone(), epoch: holder.epoch }).collect();
        for role in self.roles.keys().cloned().collect::<Vec<_>>() {
            self.keep_energy_of(&role);
        }
        self.roles = RoleEntry::all_open(&filled.mission);
        self.submission.recovery = Some(filled);
        self.branch = Branch::Recovery;
        self.items_at_recovery = held;
        self.auction = None;
        // A role of this branch may have the same name.
        self.role_orders.clear();
        self.state = MissionState::Pending;
        true
    }

    /// Returns the number of ended steps and of all steps, over all managed roles.
    pub fn progress(&self) -> (usize, usize) {
        let managed = self.roles.iter().filter(|(_, role)| role.kind == RoleKind::Managed);
        managed.fold((0, 0), |(done, all), (id, role)| {
            (done + role.ended.len(), all + self.plan(id).map_or(0, |plan| plan.steps.len()))
        })
    }
}
