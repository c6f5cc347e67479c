//! Custody of items: the robot that has each item, according to the ledger.
//!
//! The ledger records steps after they ended, so it lags behind the robots. The guards bound the
//! lag: a task that moves an item does not begin before the ledger contains the predecessors of its
//! guard ([`item_moves`](crate::plan::item_moves)). So for each move the ledger shows one of three
//! cases:
//!
//! | the ledger contains | the move | custody of the item |
//! |---|---|---|
//! | the end of its task | has happened | the receiver |
//! | all predecessors of its guards, not its end | may have happened | the former holder or the receiver: neither is certain |
//! | less | has not happened | the former holder |
//!
//! A step has happened if its role reported it, or if any role reported a step that comes after it.

use super::entry::{HeldItem, MissionEntry, RoleEntry, RolePhase};
use crate::ids::{ItemId, RoleId};
use crate::mission::RoleKind;
use crate::plan::{ItemMove, Signal, StepAction, StepIndex, item_moves};
use std::collections::{BTreeMap, BTreeSet};

/// Steps of each role that have happened.
type Happened<'a> = BTreeMap<&'a RoleId, BTreeSet<StepIndex>>;

impl MissionEntry {
    /// Returns the items that robots have or may have, by item. An uncertain item may be listed
    /// more than once. An item is not listed once its last move has happened and the role that
    /// received it is completed: it is where the mission requires it.
    pub fn custody(&self) -> Vec<HeldItem> {
        self.custody_without(&|_| false)
    }

    /// Same as [`custody`](Self::custody). The moves in `undone` have certainly not happened, unless the ledger
    /// contains their end.
    pub(super) fn custody_without(&self, undone: &dyn Fn(&ItemMove) -> bool) -> Vec<HeldItem> {
        let mission = self.mission();
        if self.items_at_recovery.is_empty()
            && !mission.elementary().iter().any(|(_, spec)| spec.items().next().is_some())
        {
            return vec![];
        }
        // A mission in the ledger was checked; for an unchecked mission there are no moves.
        let moves = self.division().and_then(|division| item_moves(mission, division).ok()).unwrap_or_default();
        let happened = self.happened();
        let inherited = self.items_at_recovery.iter().filter(|item| !moves.contains_key(&item.item)).cloned();
        let held = moves.iter().flat_map(|(item, moves)| self.custodians(item, moves, &happened, undone));
        inherited.chain(held).collect()
    }

    fn custodians(
        &self,
        item: &ItemId,
        moves: &[ItemMove],
        happened: &Happened<'_>,
        undone: &dyn Fn(&ItemMove) -> bool,
    ) -> Vec<HeldItem> {
        let known = moves.iter().rposition(|item_move| self.has_happened(item_move, happened));
        let mut custodians: Vec<HeldItem> = match known {
            None => self.items_at_recovery.iter().filter(|held| held.item == *item).cloned().collect(),
            Some(last) => {
                let to = moves[last].receiver.as_ref();
                let delivered = last + 1 == moves.len()
                    && to.is_some_and(|to| self.roles.get(to).is_some_and(|role| role.phase == RolePhase::Ended));
                let custodian = to.filter(|_| !delivered).and_then(|to| self.custodian(item, to, true));
                custodian.into_iter().collect()
            }
        };
        for item_move in &moves[known.map_or(0, |known| known + 1)..] {
            if undone(item_move) || !self.may_have_happened(item_move, happened) {
                break;
            }
            custodians.iter_mut().for_each(|custodian| custodian.certain = false);
            let to =
                item_move.receiver.as_ref().filter(|to| !custodians.iter().any(|custodian| custodian.role == **to));
            custodians.extend(to.and_then(|to| self.custodian(item, to, false)));
        }
        custodians
    }

    /// Returns the robot that holds a managed role, as custodian of an item. Items that a person
    /// has are not tracked.
    fn custodian(&self, item: &ItemId, role: &RoleId, certain: bool) -> Option<HeldItem> {
        let is_held = |entry: &&RoleEntry| entry.kind == RoleKind::Managed && entry.phase != RolePhase::Promised;
        let entry = self.roles.get(role).filter(is_held)?;
        let robot = entry.holder.as_ref()?.robot.clone();
        Some(HeldItem { item: item.clone(), role: role.clone(), robot, place: None, certain })
    }

    fn has_happened(&self, item_move: &ItemMove, happened: &Happened<'_>) -> bool {
        item_move.performers.iter().all(|role| {
            let steps = self.plan(role).map_or(&[][..], |plan| &plan.steps);
            let is_it = |step: &StepIndex| match steps.get(*step as usize).map(|step| &step.action) {
                Some(StepAction::Task { id, .. }) => *id == item_move.task,
                Some(StepAction::Send(_) | StepAction::Wait(_)) | None => false,
            };
            happened.get(role).is_some_and(|steps| steps.iter().any(is_it))
        })
    }

    fn may_have_happened(&self, item_move: &ItemMove, happened: &Happened<'_>) -> bool {
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
        item_move.guards.iter().all(guard_may_be_past) && item_move.performers.iter().all(acts)
    }

    /// Returns all steps that have happened: the reported steps and all their predecessors, in any
    /// role.
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
        let reported = self.roles.iter().flat_map(|(role, entry)| entry.ended.iter().map(move |step| (role, *step)));
        let mut open: Vec<(&RoleId, StepIndex)> = reported.collect();
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

    /// Checks whether other roles have been signalled about work of this role, so that the role
    /// cannot simply be restarted on another robot: the role reported a send, or a role that waited
    /// for its signal has continued.
    pub(super) fn has_signalled(&self, role: &RoleId) -> bool {
        let steps = self.plan(role).map_or(&[][..], |plan| &plan.steps);
        let is_send = |step: &StepIndex| match steps.get(*step as usize).map(|step| &step.action) {
            Some(StepAction::Send(_)) => true,
            Some(StepAction::Wait(_) | StepAction::Task { .. }) | None => false,
        };
        self.happened().get(role).is_some_and(|happened| happened.iter().any(is_send))
    }

    /// Checks whether only cleanup of the role itself remains: it received items and has certainly
    /// passed on all of them, no role awaits any of its remaining steps, and no remaining step
    /// touches an item. (For a role that never had an item the last steps may be its purpose.)
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
        let received =
            |item_move: &ItemMove| item_move.receiver.as_ref() == Some(role) && self.has_happened(item_move, &happened);
        let had_any = moves.values().flatten().any(received);
        is_its_own && had_any && !self.custody().iter().any(|held| held.role == *role)
    }
}
