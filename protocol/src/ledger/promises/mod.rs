//! Promises: roles that robots get later.
//!
//! An auction may promise a role to a robot that holds a role of another mission. The other roles of the mission
//! start meanwhile. The coordinator awards a promised role once its robot holds no other role and a step
//! of its plan is possible. So a robot holds a role while its tasks run, and not while it would wait for others.
//!
//! The promises of a robot have an order: by the priority of their missions, and then by their positions. An auction may
//! insert a promise before others, as long as it delays none of them beyond a bound. The order says which of the roles that
//! can start comes first: a robot does not wait for a role that cannot.
//!
//! A promise may move to another robot after an auction, unless others have acted on it. The other robots of the mission
//! learn the new robot as they learn the holders of all roles.
//!
//! A robot that only waits in a role returns it for a promised role that can start, and the returned role
//! becomes a promise (it is *postponed*).
//!
//! A mission waits for the missions that hold the robots of its promises. The ledger rejects an award or a
//! promise that would close a cycle of such waits. Without a cycle there is always a mission that waits for
//! nobody, and a free robot always has a promise that can be awarded to it, so missions cannot block each other.

use super::apply::Ledger;
use super::command::{CommandOutcome, PromiseMove, ReleaseCause};
use super::command_error::CommandError;
use super::entry::{MissionEntry, RoleAssignment, RoleEntry, RolePhase, RoleRelease, later_ms};
use super::missions::MissionGroup;
use crate::auction::{CallForBids, PlannedRole, PromisedRole, RoleOfMission};
use crate::codec;
use crate::ids::{MissionId, RobotId, RoleId};
use crate::lease::Epoch;
use crate::mission::RoleKind;
use crate::plan::{EstimatedPlan, LocalPlan, Signal, Step, StepAction, StepIndex, earliest_starts};
use crate::units::Seconds;
use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};
use std::iter;

/// Maximum size of the promised roles in a call for bids, in bytes, encoded: a call contains plans, too.
const PROMISED_BYTES_MAX: usize = codec::MESSAGE_BYTES_MAX / 4;

/// Excess of a delay over its bound that counts as rounding, in seconds.
const TOLERANCE_S: f64 = 1e-6;

/// Waits between missions: those of the ledger, and others.
struct Waits<'a> {
    ledger: &'a Ledger,
    /// The mission that holds each robot, in place of the ledger's.
    held: BTreeMap<&'a RobotId, &'a MissionId>,
    /// Further robots of the promises of each mission.
    promised: BTreeMap<&'a MissionId, BTreeSet<&'a RobotId>>,
}

impl<'a> Waits<'a> {
    fn of(ledger: &'a Ledger) -> Waits<'a> {
        Waits { ledger, held: BTreeMap::new(), promised: BTreeMap::new() }
    }

    /// Adds a role of a mission, which the robot holds or is promised.
    fn add(&mut self, mission: &'a MissionId, robot: &'a RobotId, promised: bool) {
        if promised {
            self.promised.entry(mission).or_default().insert(robot);
        } else {
            self.held.insert(robot, mission);
        }
    }

    fn holder_of(&self, robot: &RobotId) -> Option<&'a MissionId> {
        let held = self.held.get(robot).copied();
        held.or_else(|| self.ledger.held_by(robot).map(|(entry, ..)| &entry.id))
    }

    /// Returns the missions that hold the robots of a mission's promises.
    fn awaited_by(&self, mission: &MissionId) -> BTreeSet<&'a MissionId> {
        let entry = self.ledger.mission(mission).filter(|entry| !entry.state.is_final());
        let promised = entry.into_iter().flat_map(MissionEntry::promised_roles).map(|(_, promise)| &promise.robot);
        let added = self.promised.get(mission).into_iter().flatten().copied();
        promised.chain(added).filter_map(|robot| self.holder_of(robot)).filter(|other| *other != mission).collect()
    }

    /// Checks whether a mission waits for itself.
    fn contain_cycle_of(&self, mission: &MissionId) -> bool {
        let (mut seen, mut open) = (BTreeSet::new(), vec![mission]);
        while let Some(waiting) = open.pop() {
            for other in self.awaited_by(waiting) {
                if other == mission {
                    return true;
                }
                if seen.insert(other) {
                    open.push(other);
                }
            }
        }
        false
    }
}

impl MissionEntry {
    /// Returns the roles that robots hold now or are promised, with their entries and robots.
    pub fn assigned_roles(&self) -> impl Iterator<Item = (&RoleId, &RoleEntry, &RoleAssignment)> {
        let phases = [RolePhase::Promised, RolePhase::Awarded, RolePhase::Active];
        let assigned = self.roles.iter().filter(move |(_, role)| phases.contains(&role.phase));
        assigned.filter_map(|(id, role)| Some((id, role, role.holder.as_deref()?)))
    }

    /// Returns the promised roles, with their robots.
    pub fn promised_roles(&self) -> impl Iterator<Item = (&RoleId, &RoleAssignment)> {
        let promised = self.assigned_roles().filter(|(_, role, _)| role.phase == RolePhase::Promised);
        promised.map(|(id, _, robot)| (id, robot))
    }

    /// Checks whether the holder of a role could perform a step of it now, according to the ended steps. A signal of
    /// a person counts as sent if no robot has to do something first: the person may do the task later.
    pub fn can_proceed(&self, role: &RoleId) -> bool {
        let (Some(plan), Some(entry)) = (self.plan(role), self.roles.get(role)) else { return true };
        let sent = self.signals_to(role);
        let is_awaited = |step: &Step| matches!(&step.action, StepAction::Wait(signal) if self.is_person(&signal.from));
        let by_people = if plan.steps.iter().any(is_awaited) { self.signals_of_people() } else { BTreeSet::new() };
        let passed = passed_steps(plan, &entry.ended, |step| match &step.action {
            StepAction::Wait(signal) => sent.contains(signal) || by_people.contains(signal),
            StepAction::Task { .. } | StepAction::Send(_) => false,
        });
        let is_enabled = |(step, has_passed): (&Step, &bool)| {
            let is_action = !matches!(step.action, StepAction::Wait(_));
            !has_passed && is_action && step.after.iter().all(|before| passed.get(*before as usize) == Some(&true))
        };
        passed.iter().all(|passed| *passed) || plan.steps.iter().zip(&passed).any(is_enabled)
    }

    /// Checks whether the robot of a role only waits: it has ended no step, and can perform none.
    pub fn only_waits(&self, role: &RoleId) -> bool {
        self.roles.get(role).is_some_and(|held| held.ended.is_empty()) && !self.can_proceed(role)
    }

    /// Returns the estimated times until roles can begin, by the earliest start of the mission and by what others do before, at a
    /// time in milliseconds since 1970. Roles that can begin, and those for which nothing is known, are left out.
    pub fn releases(&self, now_ms: u64) -> BTreeMap<RoleId, Seconds> {
        let estimate = |id: &RoleId| {
            let holder = self.roles.get(id)?.holder.as_ref()?;
            let durations_s = self.auction.as_ref()?.durations_s(id, &holder.robot);
            Some((holder.planned_ms as f64 / 1000.0, durations_s))
        };
        let estimated = |(id, plan)| {
            let (begin_s, durations_s) = estimate(id).unwrap_or_default();
            (RoleId::clone(id), EstimatedPlan { plan, begin_s, durations_s })
        };
        let plans = self.division().into_iter().flat_map(|division| &division.plans);
        let plans: BTreeMap<RoleId, EstimatedPlan<'_>> = plans.map(estimated).collect();
        let sent: BTreeSet<Signal> = self.roles.keys().flat_map(|role| self.signals_to(role)).collect();
        let starts = earliest_starts(&plans, |signal| sent.contains(signal));
        let earliest_ms = self.submission.not_before_ms.unwrap_or_default();
        let starts = starts.into_iter().filter_map(|(role, start_s)| {
            let start_s = start_s.max(earliest_ms as f64 / 1000.0);
            let release = Seconds::new(start_s - now_ms as f64 / 1000.0).ok()?;
            let waits = earliest_ms > now_ms || !self.can_proceed(&role);
            (release > Seconds::ZERO && waits).then_some((role, release))
        });
        starts.collect()
    }

    fn is_person(&self, role: &RoleId) -> bool {
        self.roles.get(role).is_some_and(|entry| entry.kind == RoleKind::Unmanaged)
    }

    /// Returns the signals that people have sent, or can send before robots perform further steps.
    fn signals_of_people(&self) -> BTreeSet<&Signal> {
        let people = self.roles.iter().filter(|(_, role)| role.kind == RoleKind::Unmanaged);
        let people: Vec<_> =
            people.filter_map(|(id, role)| Some((self.plan(id)?, &role.ended, self.signals_to(id)))).collect();
        let mut signals: BTreeSet<&Signal> = BTreeSet::new();
        // People wait for each other, too.
        loop {
            let known = signals.len();
            for (plan, ended, sent) in &people {
                let passed = passed_steps(plan, ended, |step| match &step.action {
                    StepAction::Wait(signal) => sent.contains(signal) || signals.contains(signal),
                    StepAction::Task { .. } | StepAction::Send(_) => true,
                });
                signals.extend(plan.steps.iter().zip(passed).filter_map(|(step, passed)| match &step.action {
                    StepAction::Send(signal) if passed => Some(signal),
                    _ => None,
                }));
            }
            if signals.len() == known {
                return signals;
            }
        }
    }
}

/// Returns for each step of a plan whether it has ended, or passes once the steps before it have passed.
fn passed_steps(plan: &LocalPlan, ended: &BTreeSet<StepIndex>, passes: impl Fn(&Step) -> bool) -> Vec<bool> {
    let mut passed: Vec<bool> = Vec::with_capacity(plan.steps.len());
    // Steps follow the steps that they depend on, so a single pass is enough.
    for (index, step) in (0..).zip(&plan.steps) {
        let is_enabled = step.after.iter().all(|before| passed.get(*before as usize) == Some(&true));
        passed.push(ended.contains(&index) || (is_enabled && passes(step)));
    }
    passed
}

/// Returns the time by which a promise may still be delayed: up to `delay_max` in all, and not beyond the deadline of its
/// mission.
fn slack_of(entry: &MissionEntry, promise: &RoleAssignment, delay_max: Seconds) -> Seconds {
    // The span lacks the first drive, and the record of a large auction lacks the time.
    let span_s = promise.span.as_ref().map_or(0.0, |span| span.time.get());
    // The planned start follows the stop at a charger, and the span contains it.
    let stop_s = promise.charging.as_ref().map_or(0.0, |stop| stop.time.get());
    let time = Seconds::new((span_s - stop_s).max(promise.time.get())).unwrap_or(promise.time);
    let ends_ms = later_ms(promise.planned_ms, time);
    let until_s = |deadline_ms: u64| deadline_ms.saturating_sub(ends_ms) as f64 / 1000.0;
    let until_s = entry.submission.deadline_ms.map_or(f64::INFINITY, until_s);
    let slack_s = (delay_max.get() - promise.delayed.get()).min(until_s);
    Seconds::new(slack_s.max(0.0)).unwrap_or(Seconds::ZERO)
}

/// A promised role of a mission.
type PromisedIn<'a> = (&'a MissionEntry, &'a RoleId, &'a RoleAssignment);

fn promised_in(entry: &MissionEntry) -> impl Iterator<Item = PromisedIn<'_>> {
    entry.promised_roles().map(move |(role, promise)| (entry, role, promise))
}

/// Returns promised roles of active missions, those of each robot in their order.
fn in_order<'a>(promises: impl Iterator<Item = PromisedIn<'a>>) -> Vec<PromisedIn<'a>> {
    let mut promises: Vec<PromisedIn<'a>> = promises.collect();
    promises.sort_by_key(|(entry, _, promise)| {
        let rank = entry.rank();
        (rank.priority, promise.position, rank)
    });
    promises
}

impl Ledger {
    /// Returns the promised roles of active missions, those of each robot in their order.
    pub fn promises_in_order(&self) -> Vec<PromisedIn<'_>> {
        in_order(self.missions.of_group(MissionGroup::WithPromises).into_iter().flat_map(promised_in))
    }

    /// Returns the promised roles of a robot in their order.
    pub fn promises_of(&self, robot: &RobotId) -> Vec<PromisedIn<'_>> {
        let promises = self.missions.promised_to(robot).flat_map(promised_in);
        in_order(promises.filter(|(.., promise)| promise.robot == *robot))
    }

    /// Returns what the robot of a promise does before: the role that it holds, and the promised roles before this one.
    pub fn roles_before(&self, mission: &MissionId, role: &RoleId, promise: &RoleAssignment) -> Vec<RoleOfMission> {
        let held = self.held_by(&promise.robot).map(|(entry, role, _)| (entry, role));
        let promised = self.promises_of(&promise.robot).into_iter().map(|(entry, role, _)| (entry, role));
        let before = promised.take_while(|(entry, id)| entry.id != *mission || *id != role);
        let role = |(entry, role): (&MissionEntry, &RoleId)| (entry.id.clone(), role.clone());
        held.into_iter().chain(before).map(role).map(|(mission, role)| RoleOfMission { mission, role }).collect()
    }

    /// Returns the promised roles of these robots for a call for bids, except for the roles of the call. It contains all
    /// promises of a robot or none: those of a robot are left out if the estimate of one is unknown, or if there is no room;
    /// the robots that have promised the least time come first, since they are likely to get the role. A promise may be
    /// delayed up to `delay_max` in all, and not beyond the deadline of its mission; by a mission of higher priority without a
    /// bound, and by one of lower priority not at all. `now_ms` is the time of the call in milliseconds since 1970.
    pub fn promised_roles(
        &self,
        call: &CallForBids,
        delay_max: Seconds,
        invited: &BTreeSet<RobotId>,
        now_ms: u64,
    ) -> Vec<PromisedRole> {
        let mission = &call.auction.mission;
        let Some(called) = self.mission(mission) else { return vec![] };
        let mut queues: BTreeMap<&RobotId, Vec<Option<PromisedRole>>> = BTreeMap::new();
        let is_called = |entry: &MissionEntry, role: &RoleId| entry.id == *mission && call.roles.contains_key(role);
        for (entry, role, promise) in self.promises_in_order() {
            if !invited.contains(&promise.robot) || is_called(entry, role) {
                continue;
            }
            let slack = match entry.submission.priority.cmp(&called.submission.priority) {
                Ordering::Less => None,
                Ordering::Equal => Some(slack_of(entry, promise, delay_max)),
                Ordering::Greater => Some(Seconds::ZERO),
            };
            let promised = promise.span.clone().map(|span| PromisedRole {
                robot: promise.robot.clone(),
                role: RoleOfMission { mission: entry.id.clone(), role: role.clone() },
                span,
                slack,
                release: entry.releases(now_ms).remove(role).unwrap_or(Seconds::ZERO),
                charges: promise.charging.is_some(),
            });
            queues.entry(&promise.robot).or_default().push(promised);
        }
        let known = queues.into_values().filter_map(|queue| queue.into_iter().collect::<Option<Vec<_>>>());
        let mut known: Vec<Vec<PromisedRole>> = known.collect();
        let time_s = |queue: &[PromisedRole]| queue.iter().map(|promised| promised.span.time.get()).sum::<f64>();
        known.sort_by(|one, other| time_s(one).total_cmp(&time_s(other)));
        let mut room = PROMISED_BYTES_MAX;
        let fits = known.into_iter().filter(|queue| {
            let left = room.checked_sub(codec::encoded_size(queue));
            room = left.unwrap_or(room);
            left.is_some()
        });
        fits.flatten().collect()
    }

    /// Returns the position of a promise that is about to be added for a robot. Promises that follow it move back. It
    /// comes last if the promise that should follow is gone, or if a promise would be delayed beyond the bound.
    pub(super) fn insert_promise(
        &mut self,
        mission: &MissionId,
        robot: &RobotId,
        planned: Option<&PlannedRole>,
    ) -> u32 {
        let priority = self.mission(mission).map(|entry| entry.submission.priority).unwrap_or_default();
        let promises = self.promises_of(robot);
        let follows = |planned: &PlannedRole| {
            let next = planned.before.as_ref()?;
            let next = promises.iter().position(|(entry, role, _)| entry.id == next.mission && **role == next.role)?;
            let is_late = |(entry, _, promise): &(&MissionEntry, &RoleId, &RoleAssignment)| {
                let slack_s = slack_of(entry, promise, planned.delay_max).get() + TOLERANCE_S;
                entry.submission.priority >= priority && planned.delay.get() > slack_s
            };
            (!promises[next..].iter().any(is_late)).then_some((next, planned.delay))
        };
        let (next, delay) = planned.and_then(follows).unwrap_or((promises.len(), Seconds::ZERO));
        let order: Vec<(MissionId, RoleId)> =
            promises.iter().map(|(entry, role, _)| (entry.id.clone(), RoleId::clone(role))).collect();
        let inserted = u32::try_from(next).unwrap_or(u32::MAX);
        for (index, (mission, role)) in (0..).zip(&order) {
            let role = self.missions.get_mut(mission).and_then(|entry| entry.roles.get_mut(role));
            if let Some(promise) = role.and_then(|role| role.holder.as_mut()) {
                let follows = index >= inserted;
                promise.position = index + u32::from(follows);
                promise.delay(if follows { delay } else { Seconds::ZERO });
            }
        }
        inserted
    }

    /// Checks whether a mission with these robots would wait for itself.
    pub fn would_wait_circularly(
        &self,
        mission: &MissionId,
        holders: &BTreeMap<RoleId, RobotId>,
        promised: &BTreeMap<RoleId, Seconds>,
    ) -> bool {
        let mut waits = Waits::of(self);
        for (role, robot) in holders {
            waits.add(mission, robot, promised.contains_key(role));
        }
        waits.contain_cycle_of(mission)
    }

    /// Checks that a promised role can be awarded to its robot, which then holds no other role.
    ///
    /// # Errors
    /// [`CommandError`] states the reason.
    pub fn check_promise(&self, mission: &MissionId, role: &RoleId, epoch: Epoch) -> Result<(), CommandError> {
        let (_, robot) = self.promise(mission, role, epoch)?;
        self.check_takes_roles(&robot.robot)?;
        self.check_free(mission, &robot.robot)?;
        let mut waits = Waits::of(self);
        waits.add(mission, &robot.robot, false);
        match waits.contain_cycle_of(mission) {
            true => Err(CommandError::CircularWait { mission: mission.clone() }),
            false => Ok(()),
        }
    }

    /// Returns the mission and the robot of a promise with this epoch.
    fn promise(
        &self,
        mission: &MissionId,
        role: &RoleId,
        epoch: Epoch,
    ) -> Result<(&MissionEntry, &RoleAssignment), CommandError> {
        let not_promised = || CommandError::NotPromised { mission: mission.clone(), role: role.clone() };
        let entry = self.mission(mission).ok_or_else(|| self.no_mission(mission))?;
        let (_, robot) = entry.promised_roles().find(|(id, _)| *id == role).ok_or_else(not_promised)?;
        match entry.state.is_final() || robot.epoch != epoch {
            true => Err(not_promised()),
            false => Ok((entry, robot)),
        }
    }

    /// Moves a promise to another robot. Its former robot keeps the delays of its other promises.
    pub(super) fn move_promise(&mut self, change: PromiseMove, at: Epoch) -> Result<CommandOutcome, CommandError> {
        let PromiseMove { mission, role, epoch, robot, cause, auction } = change;
        let (entry, former) = self.promise(&mission, &role, epoch)?;
        if entry.has_signalled(&role) {
            return Err(CommandError::ActedOn { mission, role });
        }
        entry.check_permitted(&role, &robot)?;
        if let Some((other, ..)) = entry.assigned_roles().find(|(.., holder)| holder.robot == robot) {
            let role = other.clone();
            return Err(CommandError::TwoRoles { robot, mission, role });
        }
        let release = RoleRelease {
            role: role.clone(),
            robot: former.robot.clone(),
            cause,
            class: None,
            confirmed: false,
            gave_way: false,
        };
        self.check_assignable(&mission, &robot, auction.promised.contains_key(&role))?;
        let holders = BTreeMap::from([(role, robot)]);
        if self.would_wait_circularly(&mission, &holders, &auction.promised) {
            return Err(CommandError::CircularWait { mission });
        }
        self.active_mission(&mission)?.add_release(release);
        self.assign(&mission, holders, auction, at)
    }

    /// Checks that a robot can be awarded a role of a mission, or be promised one.
    pub(super) fn check_assignable(
        &self,
        mission: &MissionId,
        robot: &RobotId,
        is_promised: bool,
    ) -> Result<(), CommandError> {
        self.check_takes_roles(robot)?;
        match is_promised {
            true => self.check_carries_nothing(mission, robot),
            false => self.check_free(mission, robot),
        }
    }

    pub(super) fn award_promised(
        &mut self,
        mission: &MissionId,
        role: &RoleId,
        epoch: Epoch,
        at: Epoch,
    ) -> Result<CommandOutcome, CommandError> {
        self.check_promise(mission, role, epoch)?;
        let not_promised = || CommandError::NotPromised { mission: mission.clone(), role: role.clone() };
        let entry = self.active_mission(mission)?;
        let promised = entry.roles.get_mut(role).ok_or_else(not_promised)?;
        promised.phase = RolePhase::Awarded;
        if let Some(holder) = &mut promised.holder {
            (holder.epoch, holder.charging) = (at, None);
        }
        entry.end_next_restrictions(iter::once(role));
        Ok(CommandOutcome::Awarded { epoch: at })
    }

    pub(super) fn postpone(
        &mut self,
        mission: &MissionId,
        role_id: &RoleId,
        epoch: Epoch,
    ) -> Result<CommandOutcome, CommandError> {
        let entry = self.active_mission(mission)?;
        let (can_proceed, is_returned) = (entry.can_proceed(role_id), entry.is_returned(role_id));
        let role = self.held_role(mission, role_id, epoch)?;
        let is_held = role.kind == RoleKind::Managed && role.phase != RolePhase::Ended;
        if can_proceed || !is_held || !role.ended.is_empty() {
            return Err(CommandError::CanStart { mission: mission.clone(), role: role_id.clone() });
        }
        if is_returned {
            // It would become a promise to a robot that may not get it.
            let (cause, place) = ("it was reassigned".to_owned(), None);
            let cause = ReleaseCause { cause, class: None, moved_nothing: true, place, gave_way: true };
            return self.release(mission, role_id, epoch, &cause);
        }
        role.phase = RolePhase::Promised;
        if let Some(holder) = &mut role.holder {
            holder.incarnation = None;
        }
        Ok(CommandOutcome::Done)
    }

    /// Checks that a robot holds no role and has no item of another mission.
    fn check_free(&self, mission: &MissionId, robot: &RobotId) -> Result<(), CommandError> {
        if let Some((held, role, _)) = self.held_by(robot) {
            let (robot, mission, role) = (robot.clone(), held.id.clone(), role.clone());
            return Err(CommandError::TwoRoles { robot, mission, role });
        }
        self.check_carries_nothing(mission, robot)
    }

    /// Checks that a robot has no item of another mission.
    pub(super) fn check_carries_nothing(&self, mission: &MissionId, robot: &RobotId) -> Result<(), CommandError> {
        let mut others = self.held_items().filter(|(entry, _)| entry.id != *mission);
        match others.find(|(_, held_item)| held_item.robot == *robot) {
            None => Ok(()),
            Some((entry, held_item)) => {
                let (robot, item, mission) = (robot.clone(), held_item.item, entry.id.clone());
                Err(CommandError::CarriesItem { robot, item, mission })
            }
        }
    }
}

#[cfg(test)]
mod tests;
