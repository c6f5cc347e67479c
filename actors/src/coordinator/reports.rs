//! What the coordinator does with a robot's report, and what it answers.

use super::actor::CoordinatorMessage;
use crate::replica::{ProposeError, Replica};
use consort_protocol::ids::{MissionId, NodeId, RobotId};
use consort_protocol::lease::{Ending, Epoch};
use consort_protocol::ledger::{Command, Ledger, MissionEntry, MissionState, Outcome, Refused, RolePhase};
use consort_protocol::message::{Report, ReportAnswer};
use consort_protocol::mission::RoleKind;
use ractor::ActorRef;
use std::time::Duration;
use tracing::{debug, info};

/// How long the ledger may take to accept what was reported.
const LIMIT: Duration = Duration::from_secs(1);

/// What the ledger needs to hear before a report can be answered.
#[derive(Debug, Clone, PartialEq)]
enum Step {
    /// Nothing more: answer.
    Answer(ReportAnswer),
    /// This first.
    Commit(Command),
}

/// Writes what is new in a report into the ledger, then answers. Nothing but `NotCoordinator` is said before the ledger
/// has it, and a lease is renewed only while a majority is known to follow this coordinator.
pub(super) async fn answer(
    replica: Replica<Ledger>,
    report: Report,
    leadership_age_max: Duration,
    coordinator: ActorRef<CoordinatorMessage>,
) -> ReportAnswer {
    // Accept, fail or progress, release: no report needs more commits than this.
    for _ in 0..4 {
        let step = replica.read(|ledger| next(ledger.mission(&report.mission), &report));
        let command = match step {
            Step::Answer(answer) => return renew_if_sure(&replica, answer, &report, leadership_age_max, &coordinator),
            Step::Commit(command) => command,
        };
        match replica.propose(command, LIMIT).await {
            Ok(Outcome::Refused(Refused::Restarted { .. })) => {
                info!(robot = %report.robot, mission = %report.mission, role = %report.role, "has started anew: released");
                let cause = format!("{} started anew and has forgotten the plan", report.robot);
                if let Err(problem) = replica.propose(release(&report, cause), LIMIT).await {
                    return unsure(problem);
                }
            }
            Ok(_) => {} // whatever it was, the ledger now shows it
            Err(problem) => return unsure(problem),
        }
    }
    debug!(robot = %report.robot, mission = %report.mission, "the ledger moved on while a report was being answered");
    ReportAnswer::NotCoordinator { coordinator: None }
}

fn unsure(problem: ProposeError) -> ReportAnswer {
    debug!(%problem, "a report was not committed");
    let coordinator: Option<NodeId> = match problem {
        ProposeError::NotLeader { leader } => leader,
        _ => None,
    };
    ReportAnswer::NotCoordinator { coordinator }
}

fn renew_if_sure(
    replica: &Replica<Ledger>,
    answer: ReportAnswer,
    report: &Report,
    leadership_age_max: Duration,
    coordinator: &ActorRef<CoordinatorMessage>,
) -> ReportAnswer {
    if replica.quorum_age().is_none_or(|age| age > leadership_age_max) {
        return ReportAnswer::NotCoordinator { coordinator: None };
    }
    if matches!(answer, ReportAnswer::Renewed { .. }) {
        let contact = CoordinatorMessage::Contact { epoch: report.epoch, robot: report.robot.clone() };
        if coordinator.cast(contact).is_err() {
            return ReportAnswer::NotCoordinator { coordinator: None };
        }
    }
    answer
}

fn release(report: &Report, cause: String) -> Command {
    let (mission, role, epoch) = (report.mission.clone(), report.role.clone(), report.epoch);
    Command::Release { mission, role, epoch, cause }
}

fn next(entry: Option<&MissionEntry>, report: &Report) -> Step {
    let holder = entry.and_then(|entry| entry.roles.get(&report.role)?.holder.as_ref());
    let current = holder.map(|holder| holder.epoch);
    let ended = |reason| Step::Answer(ReportAnswer::Ended { epoch: report.epoch, reason, current });
    let Some(entry) = entry else { return ended(Ending::Over) };
    match &entry.state {
        MissionState::Pending | MissionState::Running => {}
        MissionState::Completed => return ended(Ending::Over),
        MissionState::Failed { .. } => return ended(Ending::Failed),
        MissionState::Canceled { .. } => return ended(Ending::Canceled),
    }
    let Some(role) = entry.roles.get(&report.role) else { return ended(Ending::Over) };
    if role.kind == RoleKind::Managed {
        match &role.holder {
            Some(holder) if holder.epoch == report.epoch && holder.robot == report.robot => {
                if role.phase == RolePhase::Ended {
                    return ended(Ending::Over);
                }
                if holder.incarnation != Some(report.incarnation) {
                    return Step::Commit(Command::Accept {
                        mission: report.mission.clone(),
                        role: report.role.clone(),
                        epoch: report.epoch,
                        incarnation: report.incarnation,
                    });
                }
            }
            _ => return ended(Ending::Replaced),
        }
    }
    if let Some(failure) = &report.failure {
        let what = failure.task.as_ref().map_or("go on".to_owned(), |task| format!("do {task}"));
        let cause = format!("{} as {} could not {what}: {}", report.robot, report.role, failure.cause);
        return Step::Commit(Command::Fail { mission: report.mission.clone(), cause });
    }
    if !report.ended.is_subset(&role.ended) {
        return Step::Commit(progress(&report.mission, report));
    }
    Step::Answer(ReportAnswer::Renewed { epoch: report.epoch, ended: role.ended.clone(), holders: entry.holdings() })
}

fn progress(mission: &MissionId, report: &Report) -> Command {
    let (role, epoch, ended) = (report.role.clone(), report.epoch, report.ended.clone());
    Command::Progress { mission: mission.clone(), role, epoch, ended }
}

/// Takes a role from a robot that will not act on it.
pub(super) async fn give_up(
    replica: Replica<Ledger>,
    mission: MissionId,
    role: consort_protocol::ids::RoleId,
    robot: RobotId,
    epoch: Epoch,
    cause: String,
) -> bool {
    let command = Command::Release { mission: mission.clone(), role: role.clone(), epoch, cause };
    match replica.propose(command, LIMIT).await {
        Ok(Outcome::Done) => true,
        Ok(outcome) => {
            debug!(%mission, %role, %robot, ?outcome, "not released");
            false
        }
        Err(problem) => {
            debug!(%mission, %role, %robot, %problem, "not released");
            false
        }
    }
}
