//! Stall detector: finds holders that reply and renew their lease, but end no step for a long time.

use consort_protocol::ids::{RobotId, RoleId};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Ledger, MissionEntry, MissionState, RolePhase};
use consort_protocol::plan::PlanProgress;
use consort_protocol::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Last progress of each role. The next coordinator starts without it and waits the full time
/// again.
#[derive(Debug, Clone)]
pub(super) struct StallDetector {
    timeout: Duration,
    last_progress: BTreeMap<(Epoch, RoleId), (usize, NodeTime)>,
}

/// A role without progress.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct StalledRole {
    pub(super) role: RoleId,
    pub(super) robot: RobotId,
    pub(super) epoch: Epoch,
    pub(super) cause: String,
}

impl StallDetector {
    /// Creates a detector. A role is stalled if none of its steps has ended for `timeout`. Zero
    /// disables the detector.
    pub(super) fn new(timeout: Duration) -> StallDetector {
        StallDetector { timeout, last_progress: BTreeMap::new() }
    }

    /// Returns the stalled roles: a step could be performed, and no step has ended for too long.
    pub(super) fn check(&mut self, ledger: &Ledger, now: NodeTime) -> Vec<StalledRole> {
        if self.timeout.is_zero() {
            return vec![];
        }
        let mut stalled = vec![];
        let mut active = BTreeSet::new();
        for entry in ledger.missions_with_robots() {
            for (role, held) in entry.roles.iter().filter(|(_, held)| held.phase == RolePhase::Active) {
                let Some(holder) = &held.holder else { continue };
                let key = (holder.epoch, role.clone());
                let (count, since) = self.last_progress.entry(key.clone()).or_insert((held.ended.len(), now));
                active.insert(key);
                // A held robot stands still; its time starts when it is released.
                if *count != held.ended.len() || ledger.is_held(&holder.robot) {
                    (*count, *since) = (held.ended.len(), now);
                }
                let idle = now.since(*since);
                if idle < self.timeout {
                    continue;
                }
                if !can_progress(entry, role) {
                    *since = now; // it waits for others; the time starts again when it can continue
                    continue;
                }
                let cause = format!("{} as {role} ended no step for {:.0} s", holder.robot, idle.as_secs_f64());
                let (role, robot) = (role.clone(), holder.robot.clone());
                stalled.push(StalledRole { role, robot, epoch: holder.epoch, cause });
            }
        }
        self.last_progress.retain(|key, _| active.contains(key));
        stalled
    }
}

/// Checks whether a role has a step that it could perform now, as far as the ledger shows. While
/// another role of the mission is open, steps that depend on that role wait for its holder.
fn can_progress(entry: &MissionEntry, role: &RoleId) -> bool {
    let (Some(plan), Some(held)) = (entry.plan(role), entry.roles.get(role)) else { return false };
    let progress = PlanProgress::restore(plan.clone(), held.ended.clone(), BTreeSet::new());
    entry.state == MissionState::Running && progress.is_ok_and(|progress| !progress.permitted().is_empty())
}
