//! State machine of the ledger.

use super::audit_trail::AuditTrail;
use super::branch::Branch;
use super::command::{Command, CommandOutcome, ReleaseCause};
use super::command_error::CommandError;
use super::entry::{HeldItem, MissionEntry, MissionState, RoleAssignment, RoleEntry, RolePhase, later_ms};
use super::history::{HISTORY_SINCE, History, Tombstone};
use super::history_limits::HistoryLimits;
use super::layout::VersionedPart;
use super::mission_changes::{ChangeCursor, MissionChanges};
use super::missions::{MissionGroup, Missions};
use super::order_book::OrderBook;
use super::resource_lease::{Resource, ResourceLease};
use super::schedule::ScheduleEntry;
use super::shared_map::SharedMap;
use super::submission::Submission;
use crate::auction::{AuctionRecord, RoleEstimate};
use crate::ids::{ClusterId, MissionId, PlaceId, RequestId, RobotId, RoleId, ScheduleId};
use crate::lease::Epoch;
use crate::mission::{RoleKind, TaskOutcomes};
use crate::plan::StepIndex;
use crate::units::{Energy, Seconds};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Maximum number of ended missions before wire version 3.
const HISTORY_MAX: usize = 500;

/// The replicated state: missions, awards and their results.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Ledger {
    cluster: Option<ClusterId>,
    pub(super) missions: Missions,
    /// Missions of all requests that are remembered.
    requests: SharedMap<RequestId, MissionId>,
    submitted: u64,
    versioned: VersionedPart,
}

impl Ledger {
    /// Applies the command at position `at` in the log.
    pub fn apply(&mut self, at: Epoch, command: Command) -> CommandOutcome {
        let command = if self.keeps_history() { command.limited() } else { command };
        let mission = command.mission().cloned();
        let requested = self.audited_request(&command);
        let held = self.held_items_of(mission.as_ref());
        let done = match command {
            Command::Bootstrap { cluster } => Ok(self.bootstrap(cluster)),
            Command::Submit(submission) => self.submit(*submission),
            Command::Award { mission, branch, holders, auction } => self.award(&mission, branch, holders, auction, at),
            Command::AwardPromised { mission, role, epoch } => self.award_promised(&mission, &role, epoch, at),
            Command::Postpone { mission, role, epoch } => self.postpone(&mission, &role, epoch),
            Command::MovePromise(change) => self.move_promise(*change, at),
            Command::Defer { mission, branch, auction } => self.defer(&mission, branch, auction),
            Command::Accept { mission, role, epoch, incarnation, from_checkpoint } => {
                self.accept(&mission, &role, epoch, incarnation, from_checkpoint)
            }
            Command::Progress { mission, role, epoch, branch, ended, outcomes } => {
                self.progress(&mission, &role, epoch, branch, &ended, outcomes)
            }
            Command::Release { mission, role, epoch, cause, class, moved_nothing, place, gave_way } => {
                self.release(&mission, &role, epoch, &ReleaseCause { cause, class, moved_nothing, place, gave_way })
            }
            Command::Fail { mission, cause, branch, places, class } => {
                self.fail(&mission, MissionState::Failed { cause, class }, branch, &places)
            }
            Command::Cancel { mission, by, places, .. } => self.cancel(&mission, by, &places),
            Command::Resolve { mission, by, .. } => self.resolve(&mission, &by),
            Command::AskPerson { mission, branch, role, step, asked_ms } => {
                self.ask_person(&mission, branch, &role, step, asked_ms)
            }
            Command::SetQuestion { mission, role, epoch, question, asked_ms } => {
                self.set_question(&mission, &role, epoch, question, asked_ms)
            }
            Command::AnswerPerson { request, answer, places } => self.answer_person(&request, answer, &places),
            Command::EscalatePersonRequest { request, now_ms } => self.escalate_person_request(&request, now_ms),
            Command::ExpirePersonRequest { request, now_ms, places } => {
                self.expire_person_request(&request, now_ms, &places)
            }
            Command::AddSchedule { schedule, from_ms } => self.add_schedule(*schedule, from_ms),
            Command::RemoveSchedule { schedule, .. } => self.remove_schedule(&schedule),
            Command::PauseSchedule { schedule, pause } => self.pause_schedule(&schedule, pause),
            Command::ResumeSchedule { schedule, at_ms, .. } => self.resume_schedule(&schedule, at_ms),
            Command::SubmitOccurrence { schedule, after_ms, due_ms, at_ms } => {
                self.submit_occurrence(&schedule, after_ms, due_ms, at_ms)
            }
            Command::SkipOccurrences { schedule, after_ms, until_ms } => {
                self.skip_occurrences(&schedule, after_ms, until_ms)
            }
            Command::OrderRobots { robots, order } => self.order_robots(&robots, &order, at),
            Command::ChangeClosures { parts, order } => self.change_closures(&parts, &order, at),
            Command::ChangeSpeedLimits { parts, order } => self.change_speed_limits(&parts, &order, at),
            Command::ChangeAlarms { order } => self.change_alarms(&order, at),
            Command::ExpireOrders { now_ms } => Ok(self.expire_orders(now_ms, at)),
            Command::EndOrders { robots } => Ok(self.end_orders(&robots, at)),
            Command::ChangeMission { mission, order } => self.change_mission(&mission, &order),
            Command::CancelMissions { order } => self.cancel_missions(order, at),
            Command::LeaseResource { resource, robot, at_ms } => self.lease_resource(resource, robot, at_ms, at),
            Command::FreeResource { resource, epoch } => self.free_resource(&resource, epoch),
            Command::RaiseWireVersion { wire, .. } => Ok(self.raise(wire)),
            Command::SetHistoryLimits(limits) => Ok(self.set_history_limits(limits)),
        };
        if let (Some(request), Ok(outcome)) = (requested, &done) {
            self.record_request(request, outcome);
        }
        if self.keeps_history() && self.held_items_of(mission.as_ref()) != held {
            self.order_book_mut().changed = at; // the robots learn that they must stay, or may leave
        }
        if let Some(entry) = mission.and_then(|mission| self.missions.get_mut(&mission)) {
            entry.withdraw_needless_requests();
            entry.follow_role_orders();
        }
        self.missions.settle();
        done.unwrap_or_else(CommandOutcome::Refused)
    }

    /// Returns the cluster id of this ledger; `None` until it is committed.
    pub fn cluster(&self) -> Option<ClusterId> {
        self.cluster
    }

    /// Returns the wire version that the fleet writes; `None` until it is set, right after the
    /// ledger's creation.
    pub fn wire(&self) -> Option<u8> {
        self.versioned.wire
    }

    /// Makes this the ledger of another cluster, with all its contents. Never part of the log: only
    /// an offline recovery, which restores a single replica outside the fleet, may separate it from
    /// the other replicas.
    pub fn replace_cluster(&mut self, cluster: ClusterId) {
        self.cluster = Some(cluster);
    }

    /// Returns all missions, by id.
    pub fn missions(&self) -> impl Iterator<Item = &MissionEntry> {
        self.missions.values()
    }

    /// Returns a mission.
    pub fn mission(&self, id: &MissionId) -> Option<&MissionEntry> {
        self.missions.get(id)
    }

    /// Returns the mission of a request.
    pub fn mission_of_request(&self, request: &RequestId) -> Option<&MissionEntry> {
        self.missions.get(self.requests.get(request)?)
    }

    /// Checks whether a request is remembered: a repetition is not executed.
    pub fn remembers(&self, request: &RequestId) -> bool {
        self.requests.contains_key(request)
    }

    /// Returns the remainder of an ended mission, which is kept longer than the mission.
    pub fn tombstone(&self, mission: &MissionId) -> Option<&Tombstone> {
        self.versioned.history.as_ref()?.tombstone(mission)
    }

    /// Returns the remainders of all ended missions, latest end first.
    pub fn latest_ended(&self) -> impl Iterator<Item = (&MissionId, &Tombstone)> {
        self.versioned.history.iter().flat_map(History::latest_ended)
    }

    /// Returns the limits of the history; `None` before wire version 3.
    pub fn history_limits(&self) -> Option<HistoryLimits> {
        self.versioned.history.as_ref().map(History::limits)
    }

    /// Checks whether the ledger has a history and limits, since wire version 3.
    pub(super) fn keeps_history(&self) -> bool {
        self.versioned.history.is_some()
    }

    /// Returns the number of missions that are active or wait for a person.
    pub(super) fn unended(&self) -> usize {
        let ended = self.versioned.history.as_ref().map_or(0, History::whole);
        self.missions.len().saturating_sub(ended)
    }

    /// Returns the state of a mission, also if only its tombstone is left.
    pub fn mission_state(&self, mission: &MissionId) -> Option<&MissionState> {
        let whole = self.missions.get(mission).map(|entry| &entry.state);
        whole.or_else(|| self.tombstone(mission).map(|tombstone| &tombstone.state))
    }

    /// Returns the missions that commands may have changed since the position of the cursor, and moves it to the present.
    pub fn changes_since(&self, cursor: &mut ChangeCursor) -> MissionChanges {
        self.missions.changes().since(cursor)
    }

    /// Returns the missions that have not ended, in the order in which they are served
    /// ([`service_order`](super::service_order())).
    pub fn active_missions(&self) -> Vec<&MissionEntry> {
        self.missions.of_group(MissionGroup::Active)
    }

    /// Returns the missions that are served before a mission, as [`active_missions`](Self::active_missions) does.
    pub fn missions_before(&self, entry: &MissionEntry) -> Vec<&MissionEntry> {
        self.missions.active_before(entry.rank())
    }

    /// Returns the active missions whose roles have, or had, robots, in the order in which they are served.
    pub fn missions_with_robots(&self) -> Vec<&MissionEntry> {
        self.missions.of_group(MissionGroup::WithRobots)
    }

    /// Returns the active missions with roles of people or open requests to people, in the order in which they are served.
    pub fn missions_with_people(&self) -> Vec<&MissionEntry> {
        self.missions.of_group(MissionGroup::WithPeople)
    }

    /// Checks whether at least `count` missions are active.
    pub fn has_active(&self, count: usize) -> bool {
        self.missions.count(MissionGroup::Active) >= count
    }

    /// Returns the items of missions that wait for a person, or that execute their recovery branch,
    /// with these missions. Robots with such items get no role of another mission.
    pub fn held_items(&self) -> impl Iterator<Item = (&MissionEntry, HeldItem)> {
        let mut missions = self.missions.of_group(MissionGroup::WithItems);
        missions.sort_by(|one, other| one.id.cmp(&other.id));
        missions.into_iter().flat_map(|entry| entry.held_items().into_iter().map(move |item| (entry, item)))
    }

    fn held_items_of(&self, mission: Option<&MissionId>) -> Vec<HeldItem> {
        mission.and_then(|mission| self.missions.get(mission)).map(MissionEntry::held_items).unwrap_or_default()
    }

    /// Returns the role that a robot holds now, with the epoch of its award.
    pub fn held_by(&self, robot: &RobotId) -> Option<(&MissionEntry, &RoleId, Epoch)> {
        let entry = self.missions.held_by(robot)?;
        let (id, _, holder) = entry.held_roles().find(|(.., holder)| holder.robot == *robot)?;
        Some((entry, id, holder.epoch))
    }

    /// Sets the cluster id once; a second bootstrap command has no effect, since its proposer may
    /// have replaced the first proposer.
    fn bootstrap(&mut self, cluster: ClusterId) -> CommandOutcome {
        self.cluster.get_or_insert(cluster);
        CommandOutcome::Done
    }

    fn raise(&mut self, wire: u8) -> CommandOutcome {
        let VersionedPart { wire: written, history, .. } = &mut self.versioned;
        *written = (*written).max(Some(wire));
        if *written >= Some(HISTORY_SINCE) {
            history.get_or_insert_with(|| History::of(self.missions.values()));
        }
        CommandOutcome::Done
    }

    fn set_history_limits(&mut self, limits: HistoryLimits) -> CommandOutcome {
        if let Some(history) = &mut self.versioned.history {
            history.set_limits(limits);
        }
        self.drop_excess();
        CommandOutcome::Done
    }

    fn submit(&mut self, submission: Submission) -> Result<CommandOutcome, CommandError> {
        if let Some(mission) = self.requests.get(&submission.request) {
            return Ok(CommandOutcome::Submitted { mission: mission.clone(), again: true });
        }
        if self.keeps_history() {
            self.check_room(&submission)?;
        }
        if let Some(history) = &mut self.versioned.history {
            history.check_remembered(&submission.request, submission.at_ms)?;
        }
        Ok(CommandOutcome::Submitted { mission: self.add_mission(submission), again: false })
    }

    /// Adds a mission. The request is new.
    pub(super) fn add_mission(&mut self, submission: Submission) -> MissionId {
        if let Some(history) = &mut self.versioned.history {
            for request in history.advance(submission.at_ms) {
                self.requests.remove(&request);
            }
        }
        self.submitted += 1;
        let number = self.submitted;
        let name: String = submission.mission.name.as_str().chars().take(40).collect();
        let id = MissionId::new(format!("{name}-{number}")).expect("a task name, a dash and a number form a slug");
        let roles = RoleEntry::all_open(&submission.mission);
        self.requests.insert(submission.request.clone(), id.clone());
        let state = MissionState::Pending;
        let entry = MissionEntry {
            id: id.clone(),
            number,
            submission,
            state,
            roles,
            auction: None,
            branch: Branch::Main,
            items_at_recovery: vec![],
            former_holders: vec![],
            releases: vec![],
            release_count: 0,
            energy_of_released: Energy::ZERO,
            outcomes: BTreeMap::new(),
            person_requests: vec![],
            role_orders: BTreeMap::new(),
        };
        self.missions.insert(id.clone(), entry);
        id
    }

    pub(super) fn schedule_entries(&self) -> &BTreeMap<ScheduleId, Arc<ScheduleEntry>> {
        &self.versioned.schedules
    }

    pub(super) fn schedule_entries_mut(&mut self) -> &mut BTreeMap<ScheduleId, Arc<ScheduleEntry>> {
        &mut self.versioned.schedules
    }

    pub(super) fn trail(&self) -> &AuditTrail {
        &self.versioned.trail
    }

    pub(super) fn trail_mut(&mut self) -> &mut AuditTrail {
        &mut self.versioned.trail
    }

    /// Returns the leases of chargers and devices.
    pub fn resource_leases(&self) -> &BTreeMap<Resource, ResourceLease> {
        &self.versioned.leases
    }

    pub(super) fn resource_leases_mut(&mut self) -> &mut BTreeMap<Resource, ResourceLease> {
        &mut self.versioned.leases
    }

    pub(super) fn order_book(&self) -> &OrderBook {
        &self.versioned.orders
    }

    pub(super) fn order_book_mut(&mut self) -> &mut OrderBook {
        &mut self.versioned.orders
    }

    fn award(
        &mut self,
        mission: &MissionId,
        branch: Branch,
        holders: BTreeMap<RoleId, RobotId>,
        auction: AuctionRecord,
        at: Epoch,
    ) -> Result<CommandOutcome, CommandError> {
        let entry = self.in_branch(mission, branch)?;
        if !entry.may_be_awarded(&holders.keys().cloned().collect()) {
            let open = entry.open_roles();
            return Err(CommandError::NotOpen { mission: mission.clone(), open });
        }
        holders.iter().try_for_each(|(role, robot)| entry.check_permitted(role, robot))?;
        let assigned = entry.assigned_roles().map(|(role, _, holder)| (holder.robot.clone(), role.clone()));
        let mut taken: BTreeMap<RobotId, RoleId> = assigned.collect();
        for (role, robot) in &holders {
            if let Some(role) = taken.insert(robot.clone(), role.clone()) {
                let (robot, mission) = (robot.clone(), mission.clone());
                return Err(CommandError::TwoRoles { robot, mission, role });
            }
            self.check_assignable(mission, robot, auction.promised.contains_key(role))?;
        }
        if self.would_wait_circularly(mission, &holders, &auction.promised) {
            return Err(CommandError::CircularWait { mission: mission.clone() });
        }
        self.active_mission(mission)?.former_holders.clear();
        self.assign(mission, holders, auction, at)
    }

    /// Assigns roles to robots, which have been checked: the promised roles of the record are promised, all others are
    /// awarded.
    pub(super) fn assign(
        &mut self,
        mission: &MissionId,
        holders: BTreeMap<RoleId, RobotId>,
        auction: AuctionRecord,
        at: Epoch,
    ) -> Result<CommandOutcome, CommandError> {
        let is_promised = |role: &RoleId| auction.promised.contains_key(role);
        let mut positions: BTreeMap<RoleId, u32> = BTreeMap::new();
        for (role, robot) in holders.iter().filter(|(role, _)| is_promised(role)) {
            positions.insert(role.clone(), self.insert_promise(mission, robot, auction.planned.get(role)));
        }
        let entry = self.active_mission(mission)?;
        entry.end_next_restrictions(holders.keys().filter(|role| !is_promised(role)));
        for (id, robot) in holders {
            if let Some(role) = entry.roles.get_mut(&id) {
                let RoleEstimate { time, energy } = auction.estimate_of(&id, &robot);
                let planned = auction.planned.get(&id);
                let span = planned.map(|planned| planned.span.clone());
                let charging = planned.and_then(|planned| planned.charging.clone()).filter(|_| is_promised(&id));
                let (incarnation, delayed) = (None, Seconds::ZERO);
                let position = positions.get(&id).copied().unwrap_or_default();
                let start = auction.promised.get(&id).copied().unwrap_or(Seconds::ZERO);
                let planned_ms = later_ms(auction.at_ms, start);
                role.holder = Some(Box::new(RoleAssignment {
                    robot,
                    epoch: at,
                    incarnation,
                    energy,
                    time,
                    span,
                    position,
                    delayed,
                    planned_ms,
                    charging,
                }));
                role.phase = if is_promised(&id) { RolePhase::Promised } else { RolePhase::Awarded };
                role.ended.clear();
            }
        }
        entry.auction = Some(auction);
        entry.state = entry.active_state();
        Ok(CommandOutcome::Awarded { epoch: at })
    }

    fn defer(
        &mut self,
        mission: &MissionId,
        branch: Branch,
        auction: AuctionRecord,
    ) -> Result<CommandOutcome, CommandError> {
        self.in_branch(mission, branch)?.auction = Some(auction);
        Ok(CommandOutcome::Done)
    }

    fn accept(
        &mut self,
        mission: &MissionId,
        role_id: &RoleId,
        epoch: Epoch,
        incarnation: u64,
        resumes: bool,
    ) -> Result<CommandOutcome, CommandError> {
        let role = self.held_role(mission, role_id, epoch)?;
        let Some(holder) = &mut role.holder else { return Ok(CommandOutcome::Done) };
        match holder.incarnation {
            Some(known) if known > incarnation => {
                let (robot, mission, role) = (holder.robot.clone(), mission.clone(), role_id.clone());
                return Err(CommandError::StaleIncarnation { robot, mission, role });
            }
            Some(known) if known < incarnation && resumes => holder.incarnation = Some(incarnation),
            Some(known) if known < incarnation => {
                let (robot, mission, role) = (holder.robot.clone(), mission.clone(), role_id.clone());
                return Err(CommandError::Restarted { robot, mission, role });
            }
            Some(_) => {}
            None => {
                holder.incarnation = Some(incarnation);
                role.phase = RolePhase::Active;
            }
        }
        Ok(CommandOutcome::Done)
    }

    fn progress(
        &mut self,
        mission: &MissionId,
        role_id: &RoleId,
        epoch: Epoch,
        branch: Branch,
        ended: &BTreeSet<StepIndex>,
        outcomes: TaskOutcomes,
    ) -> Result<CommandOutcome, CommandError> {
        let taken = self.active_mission(mission)?.branch;
        let role = self.held_role(mission, role_id, epoch)?;
        if role.kind == RoleKind::Unmanaged && branch != taken {
            return Err(CommandError::WrongBranch { mission: mission.clone(), taken });
        }
        let entry = self.active_mission(mission)?;
        entry.end_steps(role_id, ended.iter().copied());
        entry.add_outcomes(role_id, outcomes);
        self.complete_if_done(mission)
    }

    fn fail(
        &mut self,
        mission: &MissionId,
        failed: MissionState,
        branch: Option<Branch>,
        places: &BTreeMap<RobotId, PlaceId>,
    ) -> Result<CommandOutcome, CommandError> {
        if let Some(branch) = branch {
            self.in_branch(mission, branch)?;
        }
        self.end(mission, failed, places, &|_| false)
    }

    pub(super) fn active_mission(&mut self, mission: &MissionId) -> Result<&mut MissionEntry, CommandError> {
        if !self.missions.contains_key(mission) {
            return Err(self.no_mission(mission));
        }
        match self.missions.get_mut(mission) {
            None => Err(CommandError::NoMission { mission: mission.clone() }),
            Some(entry) if entry.state.is_final() => {
                Err(CommandError::MissionEnded { mission: mission.clone(), state: entry.state.clone() })
            }
            Some(entry) => Ok(entry),
        }
    }

    /// Returns the error for a mission that the ledger does not contain, or no longer as a whole.
    pub(super) fn no_mission(&self, mission: &MissionId) -> CommandError {
        match self.tombstone(mission) {
            Some(ended) => CommandError::MissionEnded { mission: mission.clone(), state: ended.state.clone() },
            None => CommandError::NoMission { mission: mission.clone() },
        }
    }

    /// Returns a mission that has not ended and executes this branch.
    pub(super) fn in_branch(&mut self, mission: &MissionId, branch: Branch) -> Result<&mut MissionEntry, CommandError> {
        let entry = self.active_mission(mission)?;
        match entry.branch {
            taken if taken != branch => Err(CommandError::WrongBranch { mission: mission.clone(), taken }),
            _ => Ok(entry),
        }
    }

    /// Returns a role of an active mission that is held under `epoch`, or an unmanaged role.
    pub(super) fn held_role(
        &mut self,
        mission: &MissionId,
        id: &RoleId,
        epoch: Epoch,
    ) -> Result<&mut RoleEntry, CommandError> {
        let role = self.assigned_role(mission, id, epoch)?;
        match role.phase {
            RolePhase::Promised => {
                Err(CommandError::StaleEpoch { mission: mission.clone(), role: id.clone(), held: None })
            }
            _ => Ok(role),
        }
    }

    /// Returns a role of an active mission that is held or promised under `epoch`, or an unmanaged role.
    pub(super) fn assigned_role(
        &mut self,
        mission: &MissionId,
        id: &RoleId,
        epoch: Epoch,
    ) -> Result<&mut RoleEntry, CommandError> {
        let (mission_id, role_id) = (mission.clone(), id.clone());
        let entry = self.active_mission(mission)?;
        let Some(role) = entry.roles.get_mut(id) else {
            return Err(CommandError::NoRole { mission: mission_id, role: role_id });
        };
        let held = role.holder.as_ref().map(|holder| holder.epoch);
        if role.kind == RoleKind::Managed && held != Some(epoch) {
            return Err(CommandError::StaleEpoch { mission: mission_id, role: role_id, held });
        }
        Ok(role)
    }

    /// Adds a mission that has ended to the history, and drops what exceeds its limits.
    pub(super) fn record_end(&mut self, mission: &MissionId) {
        let Some(history) = &mut self.versioned.history else { return self.drop_by_number() };
        let Some(entry) = self.missions.get(mission).filter(|entry| entry.state.has_ended()) else { return };
        history.push(entry);
        self.drop_excess();
    }

    /// Drops ended missions and requests beyond the limits of the history.
    fn drop_excess(&mut self) {
        let Some(history) = &mut self.versioned.history else { return };
        while let Some(dropped) = history.pop_whole() {
            self.missions.remove(&dropped);
        }
        for request in history.forget_over_size() {
            self.requests.remove(&request);
        }
    }

    /// Drops the ended missions with the lowest numbers, with their requests: the rule of wire
    /// versions without a history.
    fn drop_by_number(&mut self) {
        let ended = self.missions.values().filter(|entry| entry.state.has_ended());
        let mut ended: Vec<(u64, MissionId, RequestId)> =
            ended.map(|entry| (entry.number, entry.id.clone(), entry.submission.request.clone())).collect();
        let Some(excess) = ended.len().checked_sub(HISTORY_MAX) else { return };
        ended.sort();
        for (_, mission, request) in ended.drain(..excess) {
            self.missions.remove(&mission);
            self.requests.remove(&request);
        }
    }
}

#[cfg(test)]
mod tests;
