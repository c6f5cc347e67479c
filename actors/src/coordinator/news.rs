//! What is new in the ledger: told as events, to robots whose awards have ended, and to those who follow missions.

use super::actor::CoordinatorSettings;
use super::reign::{Reign, publish};
use consort_protocol::event::Happening;
use consort_protocol::ids::{MissionId, RobotId, RoleId};
use consort_protocol::keys::Key;
use consort_protocol::lease::{Ending, Epoch, Holding};
use consort_protocol::ledger::{Branch, MissionEntry, MissionState, Released, RoleEntry, RolePhase};
use consort_protocol::message::{AwardNotice, Changed};
use consort_protocol::units::NodeTime;
use std::collections::BTreeMap;
use std::time::Duration;

/// How a mission stood when it was last looked at.
#[derive(Clone, PartialEq)]
pub(super) struct Seen {
    state: MissionState,
    done: usize,
    /// The awards in force.
    holdings: BTreeMap<RoleId, Holding>,
    /// How often a role was taken from a robot.
    released: u32,
    /// When this coordinator first saw the mission.
    since: NodeTime,
}

impl Seen {
    pub(super) fn of(entry: &MissionEntry, since: NodeTime) -> Seen {
        let in_force = |role: &RoleEntry| matches!(role.phase, RolePhase::Awarded | RolePhase::Active);
        let mut holdings = if entry.state.is_end() { BTreeMap::new() } else { entry.holdings() };
        holdings.retain(|role, _| entry.roles.get(role).is_some_and(in_force));
        Seen { state: entry.state.clone(), done: entry.progress().0, holdings, released: entry.released, since }
    }
}

impl Reign {
    /// Tells what has changed since missions were last looked at.
    pub(super) fn follow_missions(&mut self, settings: &CoordinatorSettings, now: NodeTime) {
        let mut changed = false;
        let mut revoked: Vec<(RobotId, Epoch, Ending)> = vec![];
        settings.replica.read(|ledger| {
            for entry in ledger.missions() {
                let known = self.seen.get(&entry.id);
                let since = known.map_or(now, |seen| seen.since);
                let seen = Seen::of(entry, since);
                if known == Some(&seen) {
                    continue;
                }
                changed = true;
                let mission = entry.id.clone();
                if known.is_none() {
                    let parameters = entry.submission.parameters.clone();
                    settings.events.tell(Happening::Submitted { mission: mission.clone(), parameters });
                }
                if known.is_some_and(|known| known.done != seen.done) {
                    let (done, steps) = entry.progress();
                    settings.events.tell(Happening::Progress { mission: mission.clone(), done, steps });
                }
                let given_up = known.map_or(0, |known| seen.released.saturating_sub(known.released)) as usize;
                for Released { role, cause, .. } in entry.releases.iter().rev().take(given_up).rev() {
                    let (mission, role, cause) = (mission.clone(), role.clone(), cause.clone());
                    settings.events.tell(Happening::Released { mission, role, cause });
                }
                if known.is_none_or(|known| known.state != seen.state) {
                    let (mission, state) = (mission.clone(), seen.state.clone());
                    let submitted_at_ms = entry.submission.at_ms;
                    settings.events.tell(Happening::Mission { mission, state, submitted_at_ms });
                }
                let former = known.into_iter().flat_map(|known| &known.holdings);
                for (role, held) in former.filter(|(role, held)| seen.holdings.get(*role) != Some(held)) {
                    let reason = ending(entry, role, held.epoch);
                    revoked.extend(reason.map(|reason| (held.robot.clone(), held.epoch, reason)));
                }
                self.seen.insert(mission, seen);
            }
        });
        for (robot, epoch, reason) in revoked {
            self.notify(settings, &robot, AwardNotice::Revoked { epoch, reason }, |_| ());
        }
        if changed {
            let (settings, term) = (settings.clone(), self.term);
            self.tasks.spawn(async move {
                publish(&settings, &Key::Changed, &Changed { node: settings.node.clone(), term }).await;
            });
        }
    }

    /// How long this coordinator has known of a mission.
    pub(super) fn known_for(&self, mission: &MissionId, now: NodeTime) -> Option<Duration> {
        self.seen.get(mission).map(|seen| now.since(seen.since))
    }
}

/// Why a robot that held a role no longer does; nothing if it carried the role out.
fn ending(entry: &MissionEntry, role: &RoleId, epoch: Epoch) -> Option<Ending> {
    match &entry.state {
        MissionState::Canceled { .. } => Some(Ending::Canceled),
        MissionState::Failed { .. } => Some(Ending::Failed),
        MissionState::NeedsRescue { .. } => Some(Ending::Rescue),
        MissionState::Completed => Some(Ending::Over),
        MissionState::Pending | MissionState::Running => match entry.roles.get(role) {
            Some(RoleEntry { holder: Some(holder), phase: RolePhase::Ended, .. }) if holder.epoch == epoch => None,
            Some(RoleEntry { holder: None, .. }) if entry.branch == Branch::Main => Some(Ending::Released),
            Some(_) | None => Some(Ending::Replaced),
        },
    }
}
