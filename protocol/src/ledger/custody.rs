//! Who has what, as far as the ledger can tell.
//!
//! The ledger hears of steps after they ended, so it lags behind what robots do. How far, the guards say: the task that
//! moves an item does not begin before the ledger holds what comes before its guard
//! ([`item_moves`](crate::plan::item_moves)). So of each move the ledger knows one of three things:
//!
//! | the ledger holds | the move | who has the item |
//! |---|---|---|
//! | its task's end | has happened | its receiver |
//! | all before its guards, not its end | may have happened | the former keeper or the receiver: neither for certain |
//! | less | has not happened | the former keeper |
//!
//! A step has happened if its role reported it, or if a step that comes after it was reported, by whatever role.

use super::entry::{MissionEntry, RolePhase};
use crate::ids::{ItemId, PlaceId, RobotId, RoleId};
use crate::mission::RoleKind;
use crate::plan::{ItemMove, Signal, StepAction, StepIndex, item_moves};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// An item in a robot's keeping, while a mission is under way or waits for a person.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeldItem {
    /// What.
    pub item: ItemId,
    /// In which role the robot got it.
    pub role: RoleId,
    /// The robot that has it.
    pub robot: RobotId,
    /// Where that robot was last known to be.
    pub place: Option<PlaceId>,
    /// Whether it is certain that the robot has it.
    pub certain: bool,
}

/// The steps of each role that have happened.
type Happened<'a> = BTreeMap<&'a RoleId, BTreeSet<StepIndex>>;

impl MissionEntry {
    /// The items that are in robots' keeping, or may be, by item; an item of which it is not certain may be there more than
    /// once. What has come to its last move and a role that was carried to its end is where the mission meant it to be, and
    /// in nobody's keeping.
    pub fn custody(&self) -> Vec<HeldItem> {
        let mission = self.mission();
        if self.items_at_recovery.is_empty()
            && !mission.elementary().iter().any(|(_, spec)| spec.items().next().is_some())
        {
            return vec![];
        }
        // A mission in the ledger was checked; of one that was not, nothing is known.
        let moves = self.division().and_then(|division| item_moves(mission, division).ok()).unwrap_or_default();
        let happened = self.happened();
        let inherited = self.items_at_recovery.iter().filter(|item| !moves.contains_key(&item.item)).cloned();
        let kept = moves.iter().flat_map(|(item, moves)| self.keepers(item, moves, &happened));
        inherited.chain(kept).collect()
    }

    fn keepers(&self, item: &ItemId, moves: &[ItemMove], happened: &Happened<'_>) -> Vec<HeldItem> {
        let known = moves.iter().rposition(|moved| self.has_happened(moved, happened));
        let mut keepers: Vec<HeldItem> = match known {
            None => self.items_at_recovery.iter().filter(|kept| kept.item == *item).cloned().collect(),
            Some(last) => {
                let to = moves[last].receiver.as_ref();
                let delivered = last + 1 == moves.len()
                    && to.is_some_and(|to| self.roles.get(to).is_some_and(|role| role.phase == RolePhase::Ended));
                let keeper = to.filter(|_| !delivered).and_then(|to| self.keeper(item, to, true));
                keeper.into_iter().collect()
            }
        };
        for moved in &moves[known.map_or(0, |known| known + 1)..] {
            if !self.may_have_happened(moved, happened) {
                break;
            }
            keepers.iter_mut().for_each(|keeper| keeper.certain = false);
            let to = moved.receiver.as_ref().filter(|to| !keepers.iter().any(|keeper| keeper.role == **to));
            keepers.extend(to.and_then(|to| self.keeper(item, to, false)));
        }
        keepers
    }

    /// The robot that holds a managed role, as the keeper of an item. What a person has is in good hands.
    fn keeper(&self, item: &ItemId, role: &RoleId, certain: bool) -> Option<HeldItem> {
        let entry = self.roles.get(role).filter(|entry| entry.kind == RoleKind::Managed)?;
        let robot = entry.holder.as_ref()?.robot.clone();
        Some(HeldItem { item: item.clone(), role: role.clone(), robot, place: None, certain })
    }

    fn has_happened(&self, moved: &ItemMove, happened: &Happened<'_>) -> bool {
        moved.performers.iter().all(|role| {
            let steps = self.plan(role).map_or(&[][..], |plan| &plan.steps);
            let is_it = |step: &StepIndex| match steps.get(*step as usize).map(|step| &step.action) {
                Some(StepAction::Task { id, .. }) => *id == moved.task,
                Some(StepAction::Send(_) | StepAction::Wait(_)) | None => false,
            };
            happened.get(role).is_some_and(|steps| steps.iter().any(is_it))
        })
    }

    fn may_have_happened(&self, moved: &ItemMove, happened: &Happened<'_>) -> bool {
        let acts = |role: &RoleId| {
            let acting = |phase| matches!(phase, RolePhase::Active | RolePhase::Ended);
            self.roles.get(role).is_some_and(|role| role.kind == RoleKind::Unmanaged || acting(role.phase))
        };
        let guard_may_be_past = |(role, guard): &(RoleId, StepIndex)| {
            let Some(plan) = self.plan(role) else { return false };
            let before = plan.steps.get(*guard as usize).map_or(&[][..], |step| &step.after);
            let held = |step: &StepIndex| happened.get(role).is_some_and(|steps| steps.contains(step));
            acts(role) && before.iter().all(held)
        };
        moved.guards.iter().all(guard_may_be_past) && moved.performers.iter().all(acts)
    }

    /// All steps that have happened: those that the ledger was told of, and all that come before them, in whatever role.
    fn happened(&self) -> Happened<'_> {
        let Some(division) = self.division() else { return BTreeMap::new() };
        let mut sends: BTreeMap<&Signal, StepIndex> = BTreeMap::new();
        for plan in division.plans.values() {
            sends.extend((0..).zip(&plan.steps).filter_map(|(index, step)| match &step.action {
                StepAction::Send(signal) => Some((signal, index)),
                StepAction::Wait(_) | StepAction::Task { .. } => None,
            }));
        }
        let mut happened: Happened<'_> = BTreeMap::new();
        let told = self.roles.iter().flat_map(|(role, entry)| entry.ended.iter().map(move |step| (role, *step)));
        let mut open: Vec<(&RoleId, StepIndex)> = told.collect();
        while let Some((role, index)) = open.pop() {
            let step = division.plans.get(role).and_then(|plan| plan.steps.get(index as usize));
            let Some(step) = step.filter(|_| happened.entry(role).or_default().insert(index)) else { continue };
            open.extend(step.after.iter().map(|sooner| (role, *sooner)));
            if let StepAction::Wait(signal) = &step.action {
                open.extend(sends.get(signal).map(|send| (&signal.from, *send)));
            }
        }
        happened
    }

    /// Whether something that the role did has been told to others, so that it cannot simply be begun anew elsewhere: by
    /// its own account, or because somebody who waited for it has gone on.
    pub(super) fn has_signalled(&self, teller: &RoleId) -> bool {
        let steps = self.plan(teller).map_or(&[][..], |plan| &plan.steps);
        let is_send = |step: &StepIndex| match steps.get(*step as usize).map(|step| &step.action) {
            Some(StepAction::Send(_)) => true,
            Some(StepAction::Wait(_) | StepAction::Task { .. }) | None => false,
        };
        self.happened().get(teller).is_some_and(|happened| happened.iter().any(is_send))
    }

    /// Whether the role has done what the mission is about, and only its own cleaning up is left: it had items and has
    /// passed all of them on for certain, and of what remains of its plan nobody awaits anything and nothing touches an
    /// item. (A role that never had an item may have its purpose in its last steps.)
    pub(super) fn only_cleanup_remains(&self, role: &RoleId) -> bool {
        let (Some(plan), Some(division)) = (self.plan(role), self.division()) else { return false };
        let happened = self.happened();
        let own = happened.get(role);
        let mut left = (0..).zip(&plan.steps).filter(|(index, _)| own.is_none_or(|own| !own.contains(index)));
        let is_its_own = left.all(|(_, step)| match &step.action {
            StepAction::Send(_) => false,
            StepAction::Wait(_) => true,
            StepAction::Task { spec, .. } => spec.items().next().is_none() && !spec.is_joint(),
        });
        let moves = item_moves(self.mission(), division).unwrap_or_default();
        let got = |moved: &ItemMove| moved.receiver.as_ref() == Some(role) && self.has_happened(moved, &happened);
        let had_any = moves.values().flatten().any(got);
        is_its_own && had_any && !self.custody().iter().any(|kept| kept.role == *role)
    }
}
