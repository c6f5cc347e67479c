//! Held roles: award notices, and holders that make no progress.

use super::message::AwardedRole;
use super::session_context::SessionContext;
use super::stall_detector::{StallDetector, StalledRole};
use consort_protocol::cause::CauseClass;
use consort_protocol::ids::{MissionId, RoleId};
use consort_protocol::lease::{Award, Epoch, LeaseMonitor};
use consort_protocol::ledger::{Command, Ledger, RoleReturn};
use consort_protocol::message::AwardNotice;
use consort_protocol::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Held roles during a session.
pub(super) struct HeldRoles {
    stall_detector: StallDetector,
    /// Roles to be released because their holders reply but make no progress, once the leases have
    /// expired.
    stalled: BTreeMap<(Epoch, RoleId), String>,
    /// Time of the last notice to the holder of each role, or of the last proposal to award or to release a promised role.
    notified: BTreeMap<(Epoch, RoleId), NodeTime>,
}

impl HeldRoles {
    /// Creates the state of a session. A role is stalled if none of its steps has ended for
    /// `stall_timeout`.
    pub(super) fn new(stall_timeout: Duration) -> HeldRoles {
        HeldRoles {
            stall_detector: StallDetector::new(stall_timeout),
            stalled: BTreeMap::new(),
            notified: BTreeMap::new(),
        }
    }

    /// Returns the time of the last notice to the holder of each role, or of the last proposal to award or to release a
    /// promised role.
    pub(super) fn notified(&self) -> &BTreeMap<(Epoch, RoleId), NodeTime> {
        &self.notified
    }

    /// Forgets the roles of other epochs, and ends the renewal of stalled roles.
    pub(super) fn follow(
        &mut self,
        ledger: &Ledger,
        epochs: &BTreeSet<Epoch>,
        lease_monitor: &mut LeaseMonitor,
        now: NodeTime,
    ) {
        let promises: BTreeSet<Epoch> =
            ledger.promises_in_order().into_iter().map(|(.., promise)| promise.epoch).collect();
        self.notified.retain(|(epoch, _), _| epochs.contains(epoch) || promises.contains(epoch));
        self.stalled.retain(|(epoch, _), _| epochs.contains(epoch));
        for StalledRole { role, robot, epoch, cause } in self.stall_detector.check(ledger, now) {
            lease_monitor.stop_renewing(epoch, &robot, now);
            self.stalled.entry((epoch, role)).or_insert(cause);
        }
    }

    /// Notifies a robot of its award.
    pub(super) fn notify_award(&mut self, awarded: AwardedRole, context: &mut SessionContext, now: NodeTime) {
        let award = context.read_ledger(|ledger| {
            let AwardedRole { mission, role, robot, epoch } = awarded.clone();
            let entry = ledger.mission(&mission)?;
            let (plan, holders) = (entry.plan(&role)?.clone(), entry.role_robots());
            Some(Award { mission, role, robot, epoch, plan, holders })
        });
        let Some(award) = award else { return };
        self.notified.insert((awarded.epoch, awarded.role.clone()), now);
        context.notify_award(awarded, &AwardNotice::Awarded(Box::new(award)));
    }

    /// Awards a promised role to its robot.
    pub(super) fn award_promised(&mut self, promised: AwardedRole, context: &mut SessionContext, now: NodeTime) {
        let AwardedRole { mission, role, robot, epoch } = promised;
        self.notified.insert((epoch, role.clone()), now);
        let command = Command::AwardPromised { mission: mission.clone(), role: role.clone(), epoch };
        context.propose_award(command, (mission, role, robot), false);
    }

    /// Asks a robot to return a role for the mission `first`. With `for_now` it gets the role again.
    pub(super) fn ask_to_give_way(
        &mut self,
        awarded: AwardedRole,
        (first, for_now): (MissionId, bool),
        context: &mut SessionContext,
        now: NodeTime,
    ) {
        let AwardedRole { role, robot, epoch, .. } = awarded;
        self.notified.insert((epoch, role), now);
        context.notify(robot, &AwardNotice::GiveWay { epoch, to: first, for_now });
    }

    /// Asks a robot to return a role that a person has reassigned.
    pub(super) fn ask_to_return(
        &mut self,
        awarded: AwardedRole,
        RoleReturn { epoch, repeat, by }: &RoleReturn,
        context: &mut SessionContext,
        now: NodeTime,
    ) {
        let AwardedRole { role, robot, .. } = awarded;
        self.notified.insert((*epoch, role), now);
        let cause = format!("reassigned by {by}");
        context.notify(robot, &AwardNotice::Return { epoch: *epoch, repeat: *repeat, cause });
    }

    /// Releases a promise, or a role with an expired lease. The holder of a stalled role may not get it again.
    pub(super) fn release(&mut self, awarded: AwardedRole, cause: String, context: &mut SessionContext, now: NodeTime) {
        let key = (awarded.epoch, awarded.role.clone());
        let stalled = self.stalled.get(&key).cloned();
        self.notified.insert(key, now);
        let class = stalled.as_ref().map(|_| CauseClass::Robot);
        context.release_role(awarded, stalled.unwrap_or(cause), class);
    }
}
