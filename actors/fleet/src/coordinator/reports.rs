//! Handling of robot reports by the coordinator.

use super::last_known_place::last_known_places;
use super::leader_session::{SharedLeaseMonitor, lock_monitor};
use consort_bus::clock::Clock;
use consort_gossip::SharedKnowledge;
use consort_protocol::ids::{MissionId, NodeId, PlaceId, RobotId};
use consort_protocol::lease::EndReason;
use consort_protocol::ledger::{
    Branch, Command, CommandError, CommandOutcome, Ledger, MissionEntry, MissionState, RolePhase,
};
use consort_protocol::message::{FailureKind, Report, ReportReply};
use consort_protocol::mission::RoleKind;
use consort_protocol::mutants::{self, Mutant};
use consort_raft::{ProposeError, Replica};
use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::time::Duration;
use tracing::{debug, info};

/// Timeout for the ledger to commit a report.
const COMMIT_TIMEOUT: Duration = Duration::from_secs(1);

/// Next step of handling a report.
#[derive(Debug, Clone, PartialEq)]
enum Step {
    /// Send this reply; nothing is left to commit.
    Reply(ReportReply),
    /// Commit this command first.
    Commit(Command),
}

/// Handler of reports, with the state it needs.
pub(super) struct ReportHandler {
    pub(super) replica: Replica<Ledger>,
    pub(super) knowledge: SharedKnowledge,
    pub(super) leadership_age_max: Duration,
    pub(super) clock: Clock,
    pub(super) lease_monitor: SharedLeaseMonitor,
}

impl ReportHandler {
    /// Commits the news of a report to the ledger, then returns the reply. Until the commit the
    /// only possible reply is `NotCoordinator`. A lease is renewed only while a majority is known
    /// to follow this coordinator.
    pub(super) async fn handle(&self, report: Report) -> ReportReply {
        let ReportHandler { replica, knowledge, .. } = self;
        // Accept, progress, release: no report needs more commits.
        for _ in 0..4 {
            let step = replica.read(|ledger| {
                let entry = ledger.mission(&report.mission);
                next(entry, &report, || last_known_places(knowledge, entry))
            });
            let command = match step {
                Step::Reply(reply) => return self.renew_if_leader(reply, &report),
                Step::Commit(command) => command,
            };
            if mutants::is_active(Mutant::UncommittedReport)
                && let Command::Progress { .. } = command
            {
                return reply_before_commit(replica.clone(), command, &report);
            }
            match replica.propose(command, COMMIT_TIMEOUT).await {
                Ok(CommandOutcome::Refused(CommandError::Restarted { .. })) => {
                    let Report { robot, mission, role, .. } = &report;
                    info!(%robot, %mission, %role, "robot restarted: role released");
                    let cause = format!("{} restarted and has lost the plan", report.robot);
                    if let Err(problem) = replica.propose(release(&report, cause, false), COMMIT_TIMEOUT).await {
                        return reply_not_coordinator(problem);
                    }
                }
                Ok(_) => {} // the ledger shows the result
                Err(problem) => return reply_not_coordinator(problem),
            }
        }
        debug!(robot = %report.robot, mission = %report.mission, "ledger changed while a report was being handled");
        ReportReply::NotCoordinator { coordinator: None }
    }

    fn renew_if_leader(&self, reply: ReportReply, report: &Report) -> ReportReply {
        if self.replica.quorum_ack_age().is_none_or(|age| age > self.leadership_age_max) {
            return ReportReply::NotCoordinator { coordinator: None };
        }
        // A robot that gets a renewal counts as contacted before the lease can be found expired.
        let may_renew = || {
            let renewed = lock_monitor(&self.lease_monitor).renew(report.epoch, &report.robot, self.clock.now());
            // Ignoring epochs includes ignoring that this award was revoked.
            renewed || mutants::is_active(Mutant::IgnoreEpoch) || mutants::is_active(Mutant::RefusedApplied)
        };
        if matches!(reply, ReportReply::Renewed { .. }) && !may_renew() {
            let Report { robot, mission, role, .. } = report;
            debug!(%robot, %mission, %role, "lease not renewed: release is due");
            return ReportReply::NotCoordinator { coordinator: None };
        }
        reply
    }
}

/// Injected bug: reports a proposal as committed before it is.
fn reply_before_commit(replica: Replica<Ledger>, command: Command, report: &Report) -> ReportReply {
    let (steps, holders) = replica.read(|ledger| {
        let entry = ledger.mission(&report.mission);
        let plan = entry.and_then(|entry| entry.plan(&report.role));
        (plan.map(|plan| plan.steps.len()), entry.map(MissionEntry::role_holders).unwrap_or_default())
    });
    tokio::spawn(async move { replica.propose(command, COMMIT_TIMEOUT).await });
    let epoch = report.epoch;
    if steps == Some(report.ended.len()) {
        ReportReply::Ended { epoch, reason: EndReason::Over, current: Some(epoch) }
    } else {
        ReportReply::Renewed { epoch, ended: report.ended.clone(), holders, signals: Default::default() }
    }
}

fn reply_not_coordinator(problem: ProposeError) -> ReportReply {
    debug!(%problem, "a report was not committed");
    let coordinator: Option<NodeId> = match problem {
        ProposeError::NotLeader { leader } => leader,
        _ => None,
    };
    ReportReply::NotCoordinator { coordinator }
}

fn release(report: &Report, cause: String, robot_failed: bool) -> Command {
    let (mission, role, epoch) = (report.mission.clone(), report.role.clone(), report.epoch);
    Command::Release { mission, role, epoch, cause, robot_failed, place: report.place.clone() }
}

fn next(entry: Option<&MissionEntry>, report: &Report, places: impl FnOnce() -> BTreeMap<RobotId, PlaceId>) -> Step {
    let holder = entry.and_then(|entry| entry.roles.get(&report.role)?.holder.as_ref());
    let current = holder.map(|holder| holder.epoch);
    let ended = |reason| Step::Reply(ReportReply::Ended { epoch: report.epoch, reason, current });
    let Some(entry) = entry else { return ended(EndReason::Over) };
    match &entry.state {
        MissionState::Pending | MissionState::Running => {}
        MissionState::Completed => return ended(EndReason::Over),
        MissionState::Failed { .. } => return ended(EndReason::Failed),
        MissionState::Canceled { .. } => return ended(EndReason::Canceled),
        MissionState::NeedsIntervention { .. } => return ended(EndReason::NeedsIntervention),
    }
    let Some(role) = entry.roles.get(&report.role) else { return ended(EndReason::Replaced) };
    match role.kind {
        RoleKind::Managed => match &role.holder {
            Some(_) if mutants::is_active(Mutant::IgnoreEpoch) || mutants::is_active(Mutant::RefusedApplied) => {}
            Some(holder) if holder.epoch == report.epoch && holder.robot == report.robot => {
                if role.phase == RolePhase::Ended {
                    return ended(EndReason::Over);
                }
                if holder.incarnation.is_some_and(|known| known > report.incarnation) {
                    return ended(EndReason::Replaced); // by a later incarnation of the same robot
                }
                if holder.incarnation != Some(report.incarnation) {
                    return Step::Commit(Command::Accept {
                        mission: report.mission.clone(),
                        role: report.role.clone(),
                        epoch: report.epoch,
                        incarnation: report.incarnation,
                        from_checkpoint: report.from_checkpoint,
                    });
                }
            }
            Some(_) => return ended(EndReason::Replaced),
            None if entry.branch == Branch::Recovery => return ended(EndReason::Replaced),
            None => return ended(EndReason::Released),
        },
        RoleKind::Unmanaged => match report.branch.cmp(&entry.branch) {
            // The recovery branch has a role of the same name.
            Ordering::Less => return ended(EndReason::Replaced),
            Ordering::Equal => {}
            // The reporter has received a change that this node has not applied yet.
            Ordering::Greater => return Step::Reply(ReportReply::NotCoordinator { coordinator: None }),
        },
    }
    if !report.ended.is_subset(&role.ended) {
        return Step::Commit(progress(&report.mission, report));
    }
    if let Some(failure) = &report.failure {
        let what = failure.task.as_ref().map_or("go on".to_owned(), |task| format!("do {task}"));
        let cause = format!("{} as {} could not {what}: {}", report.robot, report.role, failure.cause);
        return Step::Commit(match role.kind {
            // The role is released to another robot. A robot that only leaves the fleet, or that
            // has started nothing because its checkpoint failed, may bid again.
            RoleKind::Managed => {
                release(report, cause, !matches!(failure.kind, FailureKind::Leaving | FailureKind::Checkpoint))
            }
            RoleKind::Unmanaged => {
                Command::Fail { mission: report.mission.clone(), cause, branch: Some(report.branch), places: places() }
            }
        });
    }
    Step::Reply(ReportReply::Renewed {
        epoch: report.epoch,
        ended: role.ended.clone(),
        holders: entry.role_holders(),
        signals: entry.signals_to(&report.role),
    })
}

fn progress(mission: &MissionId, report: &Report) -> Command {
    let (role, epoch, ended) = (report.role.clone(), report.epoch, report.ended.clone());
    Command::Progress { mission: mission.clone(), role, epoch, branch: report.branch, ended }
}

#[cfg(test)]
mod tests;
