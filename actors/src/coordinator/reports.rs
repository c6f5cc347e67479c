//! What the coordinator does with a robot's report, and what it answers.

use super::last_known_place::last_known_places;
use super::leader_session::{SharedLeaseMonitor, lock_monitor};
use crate::clock::Clock;
use crate::gossip::SharedKnowledge;
use crate::raft::{ProposeError, Replica};
use consort_protocol::ids::{MissionId, NodeId, PlaceId, RobotId};
use consort_protocol::lease::EndReason;
use consort_protocol::ledger::{
    Branch, Command, CommandError, CommandOutcome, Ledger, MissionEntry, MissionState, RolePhase,
};
use consort_protocol::message::{FailureKind, Report, ReportReply};
use consort_protocol::mission::RoleKind;
use consort_protocol::mutants::{self, Mutant};
use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::time::Duration;
use tracing::{debug, info};

/// How long the ledger may take to accept what was reported.
const LIMIT: Duration = Duration::from_secs(1);

/// What the ledger needs to hear before a report can be answered.
#[derive(Debug, Clone, PartialEq)]
enum Step {
    /// Nothing more: answer.
    Answer(ReportReply),
    /// This first.
    Commit(Command),
}

/// What reports are answered with.
pub(super) struct ReportHandler {
    pub(super) replica: Replica<Ledger>,
    pub(super) knowledge: SharedKnowledge,
    pub(super) leadership_age_max: Duration,
    pub(super) clock: Clock,
    pub(super) lease_monitor: SharedLeaseMonitor,
}

impl ReportHandler {
    /// Writes what is new in a report into the ledger, then answers. Nothing but `NotCoordinator` is said before the ledger
    /// has it, and a lease is renewed only while a majority is known to follow this coordinator.
    pub(super) async fn handle(&self, report: Report) -> ReportReply {
        let ReportHandler { replica, knowledge, .. } = self;
        // Accept, progress, release: no report needs more commits than this.
        for _ in 0..4 {
            let step = replica.read(|ledger| {
                let entry = ledger.mission(&report.mission);
                next(entry, &report, || last_known_places(knowledge, entry))
            });
            let command = match step {
                Step::Answer(answer) => return self.renew_if_sure(answer, &report),
                Step::Commit(command) => command,
            };
            if mutants::is_active(Mutant::UncommittedReport)
                && let Command::Progress { .. } = command
            {
                return answer_at_once(replica.clone(), command, &report);
            }
            match replica.propose(command, LIMIT).await {
                Ok(CommandOutcome::Refused(CommandError::Restarted { .. })) => {
                    info!(robot = %report.robot, mission = %report.mission, role = %report.role, "has started anew: released");
                    let cause = format!("{} started anew and has forgotten the plan", report.robot);
                    if let Err(problem) = replica.propose(release(&report, cause, false), LIMIT).await {
                        return unsure(problem);
                    }
                }
                Ok(_) => {} // whatever it was, the ledger now shows it
                Err(problem) => return unsure(problem),
            }
        }
        debug!(robot = %report.robot, mission = %report.mission, "the ledger moved on while a report was being answered");
        ReportReply::NotCoordinator { coordinator: None }
    }

    fn renew_if_sure(&self, answer: ReportReply, report: &Report) -> ReportReply {
        if self.replica.quorum_ack_age().is_none_or(|age| age > self.leadership_age_max) {
            return ReportReply::NotCoordinator { coordinator: None };
        }
        // Whoever is told that the lease goes on was in contact before anybody can find the lease to have ended.
        let may_renew = || {
            let renewed = lock_monitor(&self.lease_monitor).renew(report.epoch, &report.robot, self.clock.now());
            // To ignore epochs is to ignore that this one was taken away, too.
            renewed || mutants::is_active(Mutant::IgnoreEpoch) || mutants::is_active(Mutant::RefusedApplied)
        };
        if matches!(answer, ReportReply::Renewed { .. }) && !may_renew() {
            debug!(robot = %report.robot, mission = %report.mission, role = %report.role, "not renewed: about to be released");
            return ReportReply::NotCoordinator { coordinator: None };
        }
        answer
    }
}

/// A mistake: it says that the ledger has what it was only just asked to take.
fn answer_at_once(replica: Replica<Ledger>, command: Command, report: &Report) -> ReportReply {
    let (steps, holders) = replica.read(|ledger| {
        let entry = ledger.mission(&report.mission);
        let plan = entry.and_then(|entry| entry.plan(&report.role));
        (plan.map(|plan| plan.steps.len()), entry.map(MissionEntry::role_holders).unwrap_or_default())
    });
    tokio::spawn(async move { replica.propose(command, LIMIT).await });
    let epoch = report.epoch;
    if steps == Some(report.ended.len()) {
        ReportReply::Ended { epoch, reason: EndReason::Over, current: Some(epoch) }
    } else {
        ReportReply::Renewed { epoch, ended: report.ended.clone(), holders, signals: Default::default() }
    }
}

fn unsure(problem: ProposeError) -> ReportReply {
    debug!(%problem, "a report was not committed");
    let coordinator: Option<NodeId> = match problem {
        ProposeError::NotLeader { leader } => leader,
        _ => None,
    };
    ReportReply::NotCoordinator { coordinator }
}

fn release(report: &Report, cause: String, blamed: bool) -> Command {
    let (mission, role, epoch) = (report.mission.clone(), report.role.clone(), report.epoch);
    Command::Release { mission, role, epoch, cause, robot_failed: blamed, place: report.place.clone() }
}

fn next(entry: Option<&MissionEntry>, report: &Report, places: impl FnOnce() -> BTreeMap<RobotId, PlaceId>) -> Step {
    let holder = entry.and_then(|entry| entry.roles.get(&report.role)?.holder.as_ref());
    let current = holder.map(|holder| holder.epoch);
    let ended = |reason| Step::Answer(ReportReply::Ended { epoch: report.epoch, reason, current });
    let Some(entry) = entry else { return ended(EndReason::Over) };
    match &entry.state {
        MissionState::Pending | MissionState::Running => {}
        MissionState::Completed => return ended(EndReason::Over),
        MissionState::Failed { .. } => return ended(EndReason::Failed),
        MissionState::Canceled { .. } => return ended(EndReason::Canceled),
        MissionState::NeedsRescue { .. } => return ended(EndReason::Rescue),
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
                    return ended(EndReason::Replaced); // by a later life of the same robot
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
            Ordering::Less => return ended(EndReason::Replaced), // by its namesake in the recovery branch
            Ordering::Equal => {}
            // What the reporter has been told this node has yet to learn.
            Ordering::Greater => return Step::Answer(ReportReply::NotCoordinator { coordinator: None }),
        },
    }
    if !report.ended.is_subset(&role.ended) {
        return Step::Commit(progress(&report.mission, report));
    }
    if let Some(failure) = &report.failure {
        let what = failure.task.as_ref().map_or("go on".to_owned(), |task| format!("do {task}"));
        let cause = format!("{} as {} could not {what}: {}", report.robot, report.role, failure.cause);
        return Step::Commit(match role.kind {
            // It leaves the role to another. One that merely leaves the fleet, or has begun nothing because it could not
            // write that down, may come back and bid.
            RoleKind::Managed => {
                release(report, cause, !matches!(failure.kind, FailureKind::Leaving | FailureKind::Notebook))
            }
            RoleKind::Unmanaged => {
                Command::Fail { mission: report.mission.clone(), cause, branch: Some(report.branch), places: places() }
            }
        });
    }
    Step::Answer(ReportReply::Renewed {
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
