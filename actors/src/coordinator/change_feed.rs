//! What is new in the ledger: told as events, to robots whose awards have ended, and to those who follow missions.

use super::actor::CoordinatorSettings;
use super::leader_session::{LeaderSession, publish};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RobotId, RoleId};
use consort_protocol::keys::Key;
use consort_protocol::lease::{EndReason, Epoch, RoleHolder};
use consort_protocol::ledger::{Branch, MissionEntry, MissionState, RoleEntry, RolePhase, RoleRelease};
use consort_protocol::message::{AwardNotice, MissionsChanged};
use consort_protocol::units::NodeTime;
use std::collections::BTreeMap;
use std::time::Duration;

/// How a mission stood when it was last looked at.
#[derive(Clone, PartialEq)]
pub(super) struct MissionSnapshot {
    state: MissionState,
    done: usize,
    /// The awards in force.
    holdings: BTreeMap<RoleId, RoleHolder>,
    /// How often a role was taken from a robot.
    released: u32,
    /// When this coordinator first saw the mission.
    since: NodeTime,
}

impl MissionSnapshot {
    pub(super) fn of(entry: &MissionEntry, since: NodeTime) -> MissionSnapshot {
        let in_force = |role: &RoleEntry| matches!(role.phase, RolePhase::Awarded | RolePhase::Active);
        let mut holdings = if entry.state.is_final() { BTreeMap::new() } else { entry.role_holders() };
        holdings.retain(|role, _| entry.roles.get(role).is_some_and(in_force));
        MissionSnapshot {
            state: entry.state.clone(),
            done: entry.progress().0,
            holdings,
            released: entry.release_count,
            since,
        }
    }
}

impl LeaderSession {
    /// Tells what has changed since missions were last looked at.
    pub(super) fn publish_changes(&mut self, settings: &CoordinatorSettings, now: NodeTime) {
        let mut changed = false;
        let mut revoked: Vec<(RobotId, Epoch, EndReason)> = vec![];
        settings.replica.read(|ledger| {
            for entry in ledger.missions() {
                let known = self.mission_snapshots.get(&entry.id);
                let since = known.map_or(now, |seen| seen.since);
                let seen = MissionSnapshot::of(entry, since);
                if known == Some(&seen) {
                    continue;
                }
                changed = true;
                let mission = entry.id.clone();
                if known.is_none() {
                    let parameters = entry.submission.parameters.clone();
                    settings.events.publish(EventKind::Submitted { mission: mission.clone(), parameters });
                }
                if known.is_some_and(|known| known.done != seen.done) {
                    let (done, steps) = entry.progress();
                    settings.events.publish(EventKind::Progress { mission: mission.clone(), done, steps });
                }
                let given_up = known.map_or(0, |known| seen.released.saturating_sub(known.released)) as usize;
                for RoleRelease { role, cause, .. } in entry.releases.iter().rev().take(given_up).rev() {
                    let (mission, role, cause) = (mission.clone(), role.clone(), cause.clone());
                    settings.events.publish(EventKind::Released { mission, role, cause });
                }
                if known.is_none_or(|known| known.state != seen.state) {
                    let (mission, state) = (mission.clone(), seen.state.clone());
                    let submitted_at_ms = entry.submission.at_ms;
                    settings.events.publish(EventKind::Mission { mission, state, submitted_at_ms });
                }
                let former = known.into_iter().flat_map(|known| &known.holdings);
                for (role, held) in former.filter(|(role, held)| seen.holdings.get(*role) != Some(held)) {
                    let reason = ending(entry, role, held.epoch);
                    revoked.extend(reason.map(|reason| (held.robot.clone(), held.epoch, reason)));
                }
                self.mission_snapshots.insert(mission, seen);
            }
        });
        for (robot, epoch, reason) in revoked {
            self.notify(settings, &robot, AwardNotice::Revoked { epoch, reason }, |_| ());
        }
        if changed {
            let (settings, term) = (settings.clone(), self.term);
            self.tasks.spawn(async move {
                publish(&settings, &Key::Changed, &MissionsChanged { node: settings.node.clone(), term }).await;
            });
        }
    }

    /// How long this coordinator has known of a mission.
    pub(super) fn time_known(&self, mission: &MissionId, now: NodeTime) -> Option<Duration> {
        self.mission_snapshots.get(mission).map(|seen| now.since(seen.since))
    }
}

/// Why a robot that held a role no longer does; nothing if it carried the role out.
fn ending(entry: &MissionEntry, role: &RoleId, epoch: Epoch) -> Option<EndReason> {
    match &entry.state {
        MissionState::Canceled { .. } => Some(EndReason::Canceled),
        MissionState::Failed { .. } => Some(EndReason::Failed),
        MissionState::NeedsRescue { .. } => Some(EndReason::Rescue),
        MissionState::Completed => Some(EndReason::Over),
        MissionState::Pending | MissionState::Running => match entry.roles.get(role) {
            Some(RoleEntry { holder: Some(holder), phase: RolePhase::Ended, .. }) if holder.epoch == epoch => None,
            Some(RoleEntry { holder: None, .. }) if entry.branch == Branch::Main => Some(EndReason::Released),
            Some(_) | None => Some(EndReason::Replaced),
        },
    }
}
