//! Whether held roles get on: a holder that answers and renews, but ends no step for long, is not at work.

use consort_protocol::ids::{RobotId, RoleId};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Ledger, MissionEntry, MissionState, RolePhase};
use consort_protocol::plan::PlanProgress;
use consort_protocol::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// When each role's last step was seen to end. Forgotten by the next coordinator, which then waits the whole time anew.
#[derive(Debug, Clone)]
pub(super) struct StallDetector {
    after: Duration,
    seen: BTreeMap<(Epoch, RoleId), (usize, NodeTime)>,
}

/// A role that does not get on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct StalledRole {
    pub(super) role: RoleId,
    pub(super) robot: RobotId,
    pub(super) epoch: Epoch,
    pub(super) cause: String,
}

impl StallDetector {
    /// Roles are stalled when none of their steps has ended for this long; none ever is for a time of zero.
    pub(super) fn new(after: Duration) -> StallDetector {
        StallDetector { after, seen: BTreeMap::new() }
    }

    /// Looks at the ledger, and says which roles are stalled: something could be done, and no step has ended for too long.
    pub(super) fn check(&mut self, ledger: &Ledger, now: NodeTime) -> Vec<StalledRole> {
        if self.after.is_zero() {
            return vec![];
        }
        let mut stalled = vec![];
        let mut live = BTreeSet::new();
        for entry in ledger.active_missions() {
            for (role, held) in entry.roles.iter().filter(|(_, held)| held.phase == RolePhase::Active) {
                let Some(holder) = &held.holder else { continue };
                let key = (holder.epoch, role.clone());
                let (count, since) = self.seen.entry(key.clone()).or_insert((held.ended.len(), now));
                live.insert(key);
                if *count != held.ended.len() {
                    (*count, *since) = (held.ended.len(), now);
                }
                let idle = now.since(*since);
                if idle < self.after {
                    continue;
                }
                if !could_go_on(entry, role) {
                    *since = now; // it waits for others; its time counts from when it no longer does
                    continue;
                }
                let cause = format!("{} as {role} ended no step for {:.0} s", holder.robot, idle.as_secs_f64());
                let (role, robot) = (role.clone(), holder.robot.clone());
                stalled.push(StalledRole { role, robot, epoch: holder.epoch, cause });
            }
        }
        self.seen.retain(|key, _| live.contains(key));
        stalled
    }
}

/// Whether a role has a step to perform that waits for nobody, as far as the ledger knows. While a role of the mission is
/// open, whoever needs it waits for it to be filled.
fn could_go_on(entry: &MissionEntry, role: &RoleId) -> bool {
    let (Some(plan), Some(held)) = (entry.plan(role), entry.roles.get(role)) else { return false };
    let progress = PlanProgress::restore(plan.clone(), held.ended.clone(), BTreeSet::new());
    entry.state == MissionState::Running && progress.is_ok_and(|progress| !progress.permitted().is_empty())
}
