//! Change feed of the ledger: changes are published as events, and sent to robots whose awards have
//! ended.

use super::reports::final_reason;
use super::session_context::SessionContext;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RobotId, RoleId, ScheduleId};
use consort_protocol::lease::{EndReason, Epoch, RoleHolder};
use consort_protocol::ledger::{
    Branch, Ledger, MissionChanges, MissionEntry, MissionState, Occurrence, Priority, RoleEntry, RoleOrder, RolePhase,
    RoleRelease, Tombstone,
};
use consort_protocol::message::AwardNotice;
use consort_protocol::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// State of a mission when it was last compared.
#[derive(Clone, PartialEq)]
struct MissionSnapshot {
    state: MissionState,
    done: usize,
    /// Awards in force.
    holders: BTreeMap<RoleId, RoleHolder>,
    /// Number of times a role was released.
    released: u32,
    priority: Priority,
    /// Orders of people about roles.
    role_orders: BTreeMap<RoleId, RoleOrder>,
    /// Time at which this coordinator first found the mission.
    since: NodeTime,
}

impl MissionSnapshot {
    fn of(entry: &MissionEntry, since: NodeTime) -> MissionSnapshot {
        let held = entry.held_roles().filter(|_| !entry.state.is_final()).map(|(role, _, holder)| {
            let holder = RoleHolder { robot: holder.robot.clone(), epoch: holder.epoch };
            (role.clone(), holder)
        });
        MissionSnapshot {
            state: entry.state.clone(),
            done: entry.progress().0,
            holders: held.collect(),
            released: entry.release_count,
            priority: entry.submission.priority,
            role_orders: entry.role_orders().clone(),
            since,
        }
    }
}

/// Change feed of a session.
pub(super) struct ChangeFeed {
    /// Last published state of each mission, to detect changes.
    snapshots: BTreeMap<MissionId, MissionSnapshot>,
    /// Mission that had ended last when the ledger was last compared.
    last_ended: Option<MissionId>,
    /// Time of the last published occurrence of each schedule, in milliseconds since 1970.
    occurrences: BTreeMap<ScheduleId, u64>,
}

impl ChangeFeed {
    /// Creates the feed. Missions and occurrences that are in the ledger before the session are not
    /// reported as changes.
    pub(super) fn new(context: &SessionContext) -> ChangeFeed {
        context.read_ledger(|ledger| ChangeFeed::of(ledger, context.since))
    }

    fn of(ledger: &Ledger, since: NodeTime) -> ChangeFeed {
        let snapshot = |entry: &MissionEntry| (entry.id.clone(), MissionSnapshot::of(entry, since));
        ChangeFeed {
            snapshots: ledger.missions().map(snapshot).collect(),
            last_ended: last_ended(ledger),
            occurrences: last_occurrences(ledger).collect(),
        }
    }

    /// Forgets the missions and schedules that are no longer in the ledger.
    fn forget(&mut self, ledger: &Ledger, changes: &MissionChanges) {
        let is_gone = |mission: &MissionId| ledger.mission(mission).is_none();
        match changes {
            MissionChanges::All => self.snapshots.retain(|mission, _| !is_gone(mission)),
            MissionChanges::These(missions) => {
                missions
                    .iter()
                    .filter(|mission| is_gone(mission))
                    .for_each(|mission| drop(self.snapshots.remove(mission)));
            }
        }
        self.occurrences.retain(|schedule, _| ledger.schedule(schedule).is_some());
    }

    /// Publishes all changes since the last comparison, of which `changes` names the missions. Returns the robots that
    /// had, have or will get roles of these missions.
    pub(super) fn publish(
        &mut self,
        context: &mut SessionContext,
        changes: &MissionChanges,
        now: NodeTime,
    ) -> BTreeSet<RobotId> {
        let (mut revoked, mut robots): (Vec<(RobotId, Epoch, EndReason)>, BTreeSet<RobotId>) =
            (vec![], BTreeSet::new());
        context.read_ledger(|ledger| {
            for (mission, ended) in self.dropped(ledger) {
                let (state, submitted_at_ms) = (ended.state.clone(), ended.submitted_ms);
                let reason = final_reason(&state);
                let holders = self.snapshots.get(mission).into_iter().flat_map(|previous| previous.holders.values());
                for held in holders {
                    robots.insert(held.robot.clone());
                    revoked.extend(reason.map(|reason| (held.robot.clone(), held.epoch, reason)));
                }
                context.publish_event(EventKind::Mission { mission: mission.clone(), state, submitted_at_ms });
            }
            self.last_ended = last_ended(ledger);
            let examined: Vec<&MissionEntry> = match changes {
                MissionChanges::All => ledger.missions().collect(),
                MissionChanges::These(missions) => missions.iter().filter_map(|id| ledger.mission(id)).collect(),
            };
            for entry in examined {
                let previous = self.snapshots.get(&entry.id);
                let former = previous.into_iter().flat_map(|previous| previous.holders.values());
                robots.extend(former.map(|held| held.robot.clone()));
                robots.extend(entry.assigned_roles().map(|(.., holder)| holder.robot.clone()));
                let since = previous.map_or(now, |snapshot| snapshot.since);
                let snapshot = MissionSnapshot::of(entry, since);
                if previous == Some(&snapshot) {
                    continue;
                }
                let mission = entry.id.clone();
                if previous.is_none() {
                    let parameters = entry.submission.parameters.clone();
                    context.publish_event(EventKind::Submitted { mission: mission.clone(), parameters });
                }
                if previous.is_some_and(|previous| previous.done != snapshot.done) {
                    let (done, steps) = entry.progress();
                    context.publish_event(EventKind::Progress { mission: mission.clone(), done, steps });
                }
                if previous.is_some_and(|previous| previous.priority != snapshot.priority) {
                    let (mission, priority) = (mission.clone(), snapshot.priority);
                    context.publish_event(EventKind::PriorityChanged { mission, priority });
                }
                let former_orders = previous.map(|previous| &previous.role_orders);
                for role in changed_orders(former_orders, &snapshot.role_orders) {
                    let order = snapshot.role_orders.get(&role).map(ToString::to_string);
                    context.publish_event(EventKind::RoleOrdered { mission: mission.clone(), role, order });
                }
                let new_releases =
                    previous.map_or(0, |previous| snapshot.released.saturating_sub(previous.released)) as usize;
                for RoleRelease { role, cause, .. } in entry.releases.iter().rev().take(new_releases).rev() {
                    let (mission, role, cause) = (mission.clone(), role.clone(), cause.clone());
                    context.publish_event(EventKind::Released { mission, role, cause });
                }
                if previous.is_none_or(|previous| previous.state != snapshot.state) {
                    let (mission, state) = (mission.clone(), snapshot.state.clone());
                    let submitted_at_ms = entry.submission.at_ms;
                    context.publish_event(EventKind::Mission { mission, state, submitted_at_ms });
                }
                let former_holders = previous.into_iter().flat_map(|previous| &previous.holders);
                for (role, held) in former_holders.filter(|(role, held)| snapshot.holders.get(*role) != Some(held)) {
                    let reason = end_reason(entry, role, held.epoch);
                    revoked.extend(reason.map(|reason| (held.robot.clone(), held.epoch, reason)));
                }
                self.snapshots.insert(mission, snapshot);
            }
            self.publish_occurrences(ledger, context);
            self.forget(ledger, changes);
        });
        for (robot, epoch, reason) in revoked {
            context.notify(robot, &AwardNotice::Revoked { epoch, reason });
        }
        robots
    }

    /// Returns the missions that have ended since the last comparison and that the ledger no longer contains as a whole,
    /// earliest end first.
    fn dropped<'a>(&self, ledger: &'a Ledger) -> Vec<(&'a MissionId, &'a Tombstone)> {
        let is_new = |(mission, _): &(&MissionId, &Tombstone)| self.last_ended.as_ref() != Some(*mission);
        let had_ended =
            |mission: &MissionId| self.snapshots.get(mission).is_some_and(|previous| previous.state.has_ended());
        let ended = ledger.latest_ended().take_while(is_new);
        let dropped = ended.filter(|&(mission, _)| ledger.mission(mission).is_none() && !had_ended(mission));
        let mut dropped: Vec<_> = dropped.collect();
        dropped.reverse();
        dropped
    }

    /// Publishes the submitted occurrences. A session proposes the next occurrence of a schedule only after this
    /// comparison, so each occurrence is the last one when it is published.
    fn publish_occurrences(&mut self, ledger: &Ledger, context: &SessionContext) {
        for entry in ledger.schedules() {
            let schedule = entry.schedule.id.clone();
            let Some(Occurrence { due_ms, mission }) = entry.last.clone() else { continue };
            if self.occurrences.insert(schedule.clone(), due_ms) != Some(due_ms) {
                context.publish_event(EventKind::OccurrenceSubmitted { schedule, due_ms, mission });
            }
        }
    }

    /// Returns the time since this coordinator first found a mission.
    pub(super) fn time_known(&self, mission: &MissionId, now: NodeTime) -> Option<Duration> {
        self.snapshots.get(mission).map(|snapshot| now.since(snapshot.since))
    }
}

/// Returns the roles with changed orders.
fn changed_orders(
    former: Option<&BTreeMap<RoleId, RoleOrder>>,
    orders: &BTreeMap<RoleId, RoleOrder>,
) -> BTreeSet<RoleId> {
    let all = former.into_iter().chain([orders]).flat_map(BTreeMap::keys);
    let changed = all.filter(|role| former.and_then(|former| former.get(*role)) != orders.get(*role));
    changed.cloned().collect()
}

/// Returns the mission that has ended last.
fn last_ended(ledger: &Ledger) -> Option<MissionId> {
    ledger.latest_ended().next().map(|(mission, _)| mission.clone())
}

/// Returns the time of the last submitted occurrence of each schedule that has any.
fn last_occurrences(ledger: &Ledger) -> impl Iterator<Item = (ScheduleId, u64)> {
    ledger.schedules().filter_map(|entry| Some((entry.schedule.id.clone(), entry.last.as_ref()?.due_ms)))
}

/// Returns the reason for the end of an award; `None` if the role was completed.
fn end_reason(entry: &MissionEntry, role: &RoleId, epoch: Epoch) -> Option<EndReason> {
    let of_mission = final_reason(&entry.state);
    if of_mission.is_some() {
        return of_mission;
    }
    match entry.roles.get(role) {
        Some(RoleEntry { holder: Some(holder), phase: RolePhase::Ended, .. }) if holder.epoch == epoch => None,
        Some(RoleEntry { phase: RolePhase::Promised, .. }) => Some(EndReason::Released),
        Some(RoleEntry { holder: None, .. }) if entry.branch == Branch::Main => Some(EndReason::Released),
        Some(_) | None => Some(EndReason::Replaced),
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_ledger::Log;
    use super::*;
    use consort_protocol::ledger::{Command, HistoryLimits};

    fn cancel(log: &mut Log, mission: &MissionId) {
        let (mission, by) = (mission.clone(), "Nia".to_owned());
        log.apply(Command::Cancel { mission, by, places: BTreeMap::new(), at_ms: 7 });
    }

    #[test]
    fn missions_that_end_between_comparisons_are_found_once_after_they_were_dropped() {
        let mut log = Log::default();
        log.apply(Command::first_wire_version(3));
        let (published, known) = (log.add_mission("ada"), log.add_mission("bob"));
        cancel(&mut log, &published);
        let mut feed = ChangeFeed::of(&log.0, NodeTime::at(Duration::ZERO));
        log.apply(Command::SetHistoryLimits(HistoryLimits { missions_max: 0, ..HistoryLimits::default() }));
        assert!(log.0.mission(&published).is_none() && feed.dropped(&log.0).is_empty());
        let unknown = log.add_mission("cyd");
        cancel(&mut log, &unknown);
        cancel(&mut log, &known);
        let dropped = feed.dropped(&log.0);
        let states: Vec<_> =
            dropped.into_iter().map(|(mission, ended)| (mission.clone(), ended.state.clone())).collect();
        let canceled = || MissionState::Canceled { by: "Nia".to_owned() };
        assert_eq!(states, [(unknown, canceled()), (known, canceled())]);
        feed.last_ended = last_ended(&log.0);
        assert!(feed.dropped(&log.0).is_empty());
    }
}
