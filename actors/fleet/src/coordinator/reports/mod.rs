//! Handling of robot reports by the coordinator.

mod service;

use super::confirmed_time::ConfirmedTime;
use super::lease_monitor::SharedLeaseMonitor;
use super::message::CoordinatorMessage;
use super::session_context::SessionContext;
use super::settings::NodeParts;
use consort_bus::clock::Clock;
use consort_protocol::ids::NodeId;
use consort_protocol::lease::{EndReason, LeaseMonitor};
use consort_protocol::ledger::{
    Branch, Command, CommandError, CommandOutcome, FinalAnswer, Ledger, MissionEntry, MissionState, PersonRequestPhase,
    RequestSubject, RoleEntry, RolePhase, TaskQuestion,
};
use consort_protocol::message::{FailureKind, OrdersNotice, QuestionAnswer, Report, ReportReply, TaskFailure};
use consort_protocol::units::NodeTime;
use consort_raft::{ProposeError, Replica};
use ractor::ActorRef;
pub(super) use service::serve_reports;
use std::time::Duration;
use tracing::{debug, info};

/// Timeout for the ledger to commit a report.
const COMMIT_TIMEOUT: Duration = Duration::from_secs(1);

/// Maximum number of commits for a report: accept, progress and release, and a spare for a change
/// of the ledger meanwhile.
const COMMITS_MAX: u32 = 4;

/// Next step of handling a report.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Step {
    /// Send this reply; nothing is left to commit.
    Reply(ReportReply),
    /// Commit this command first.
    Commit(Command),
}

/// Handler of reports, with the state it needs.
pub(super) struct ReportHandler {
    replica: Replica<Ledger>,
    leadership_age_max: Duration,
    clock: Clock,
    lease_monitor: SharedLeaseMonitor,
    mailbox: ActorRef<CoordinatorMessage>,
    time: ConfirmedTime,
}

impl ReportHandler {
    pub(super) fn new(context: &SessionContext) -> ReportHandler {
        let NodeParts { replica, clock, .. } = &context.settings.parts;
        ReportHandler {
            replica: replica.clone(),
            leadership_age_max: context.settings.lease_terms.leadership_age_max(),
            clock: *clock,
            lease_monitor: context.lease_monitor.clone(),
            mailbox: context.mailbox.clone(),
            time: context.time.clone(),
        }
    }

    /// Commits the news of a report to the ledger, then returns the reply. Until the commit the
    /// only possible reply is `NotCoordinator`. A lease is renewed only while a majority is known
    /// to follow this coordinator.
    pub(super) async fn handle(&self, report: Report) -> ReportReply {
        for _ in 0..COMMITS_MAX {
            let command = match self.next_step(&report) {
                Step::Reply(reply) => {
                    let reply = self.renew_if_leader(self.with_orders(reply, &report), &report);
                    // Only the holder of the role may ask.
                    if matches!(reply, ReportReply::Renewed { .. }) {
                        self.pass_question(&report);
                    }
                    return reply;
                }
                Step::Commit(command) => command,
            };
            let outcome = match self.replica.propose(command, COMMIT_TIMEOUT).await {
                Ok(outcome) => outcome,
                Err(problem) => return reply_not_coordinator(problem),
            };
            if let Some(reply) = reply_to_refusal(&outcome, &report) {
                return self.renew_if_leader(reply, &report);
            }
        }
        debug!(robot = %report.robot, mission = %report.mission, "ledger changed while a report was being handled");
        ReportReply::NotCoordinator { coordinator: None }
    }

    fn next_step(&self, report: &Report) -> Step {
        self.replica.read(|ledger| next(ledger.mission(&report.mission), report))
    }

    /// Adds the orders of people to the renewal of a lease: a robot that was cut off gets them before it acts.
    fn with_orders(&self, mut reply: ReportReply, report: &Report) -> ReportReply {
        if let ReportReply::Renewed { orders, .. } = &mut reply {
            let confirmed_ms = self.time.now_ms();
            **orders = self.replica.read(|ledger| OrdersNotice::of(ledger, &report.robot, confirmed_ms));
        }
        reply
    }

    /// Lets the session record a question that the ledger lacks, or withdraw one that is no longer asked.
    /// The reply to the report does not wait for that.
    fn pass_question(&self, report: &Report) {
        let Report { mission, role, epoch, question: Some(question), .. } = report else { return };
        let lacks = |entry: &MissionEntry| entry.lacks_question(role, *epoch, question);
        if self.replica.read(|ledger| ledger.mission(mission).is_some_and(lacks)) {
            let (mission, role, epoch, question) = (mission.clone(), role.clone(), *epoch, question.clone());
            // The actor ends with the node; the next report repeats the question.
            let _ = self.mailbox.cast(CoordinatorMessage::Question { mission, role, epoch, question });
        }
    }

    fn renew_if_leader(&self, reply: ReportReply, report: &Report) -> ReportReply {
        let contact = QuorumContact { age: self.replica.quorum_ack_age(), age_max: self.leadership_age_max };
        confirm(reply, report, contact, &mut self.lease_monitor.lock(), || self.clock.now())
    }
}

/// Age of a coordinator's last contact with a majority; `None` for a node that does not lead.
pub(super) struct QuorumContact {
    pub(super) age: Option<Duration>,
    /// Maximum age at which the coordinator may reply.
    pub(super) age_max: Duration,
}

/// Returns the reply, if this coordinator may send it, and renews the lease. The clock is read after
/// the lease monitor is locked: a robot that gets a renewal counts as contacted before its lease can
/// be found expired.
pub(super) fn confirm(
    reply: ReportReply,
    report: &Report,
    quorum: QuorumContact,
    lease_monitor: &mut LeaseMonitor,
    now: impl FnOnce() -> NodeTime,
) -> ReportReply {
    if quorum.age.is_none_or(|age| age > quorum.age_max) {
        return ReportReply::NotCoordinator { coordinator: None };
    }
    let may_renew = || lease_monitor.renew(report.epoch, &report.robot, now());
    if matches!(reply, ReportReply::Renewed { .. }) && !may_renew() {
        let Report { robot, mission, role, .. } = report;
        debug!(%robot, %mission, %role, "lease not renewed: release is due");
        return ReportReply::NotCoordinator { coordinator: None };
    }
    reply
}

/// Returns the reply to a robot that restarted without a checkpoint: it has lost the plan. Its body may
/// still act on a command of the previous incarnation, so the coordinator releases the role only when
/// the lease has expired. `None` for other outcomes: the ledger shows the result.
pub(super) fn reply_to_refusal(outcome: &CommandOutcome, report: &Report) -> Option<ReportReply> {
    let CommandOutcome::Refused(CommandError::Restarted { robot, mission, role }) = outcome else { return None };
    info!(%robot, %mission, %role, "robot restarted and has lost the plan: role is released after its lease");
    Some(ReportReply::Ended { epoch: report.epoch, reason: EndReason::Released, current: None })
}

fn reply_not_coordinator(problem: ProposeError) -> ReportReply {
    debug!(%problem, "a report was not committed");
    let coordinator: Option<NodeId> = match problem {
        ProposeError::NotLeader { leader } => leader,
        _ => None,
    };
    ReportReply::NotCoordinator { coordinator }
}

/// Meaning of a report for the present state of the ledger.
enum ReportCase<'a> {
    /// The role has ended for the reporter.
    Ended(EndReason),
    /// The robot reports for the first time with this award, or after a restart.
    Unaccepted,
    /// The ledger does not contain all ended steps.
    NewSteps,
    /// The robot cannot continue.
    Failed(&'a MissionEntry, &'a TaskFailure),
    /// The ledger contains the whole report.
    NoNews(&'a MissionEntry, &'a RoleEntry),
}

/// Returns the next step of handling a report.
pub(super) fn next(entry: Option<&MissionEntry>, report: &Report) -> Step {
    match report_case(entry, report) {
        ReportCase::Ended(reason) => Step::Reply(ended(entry, report, reason)),
        ReportCase::Unaccepted => Step::Commit(accept(report)),
        ReportCase::NewSteps => Step::Commit(progress(report)),
        ReportCase::Failed(entry, failure) if is_postponed(entry, report, failure) => Step::Commit(postpone(report)),
        ReportCase::Failed(_, failure) => Step::Commit(release_failed(report, failure)),
        ReportCase::NoNews(entry, role) => Step::Reply(renewed(entry, role, report)),
    }
}

fn report_case<'a>(entry: Option<&'a MissionEntry>, report: &'a Report) -> ReportCase<'a> {
    let Some(entry) = entry else { return ReportCase::Ended(EndReason::Over) };
    if let Some(reason) = final_reason(&entry.state) {
        return ReportCase::Ended(reason);
    }
    let Some(role) = entry.roles.get(&report.role) else { return ReportCase::Ended(EndReason::Replaced) };
    match (robot_case(entry, role, report), &report.failure) {
        (Some(obstacle), _) => obstacle,
        (None, _) if !report.ended.is_subset(&role.ended) => ReportCase::NewSteps,
        (None, _) if report.outcomes.keys().any(|task| entry.lacks_outcome(&report.role, task)) => ReportCase::NewSteps,
        (None, Some(failure)) => ReportCase::Failed(entry, failure),
        (None, None) => ReportCase::NoNews(entry, role),
    }
}

/// Returns the reason for the end of all awards of a mission in this state; `None` if the mission is active.
pub(super) fn final_reason(state: &MissionState) -> Option<EndReason> {
    match state {
        MissionState::Pending | MissionState::Running => None,
        MissionState::Completed => Some(EndReason::Over),
        MissionState::Failed { .. } => Some(EndReason::Failed),
        MissionState::Canceled { .. } => Some(EndReason::Canceled),
        MissionState::NeedsIntervention { .. } => Some(EndReason::NeedsIntervention),
    }
}

/// Returns the case of a report by a robot that does not hold an accepted role. Nobody holds the role of
/// a person.
fn robot_case<'a>(entry: &MissionEntry, role: &RoleEntry, report: &Report) -> Option<ReportCase<'a>> {
    match &role.holder {
        Some(holder) if holder.epoch != report.epoch || holder.robot != report.robot => {
            Some(ReportCase::Ended(EndReason::Replaced))
        }
        Some(_) if role.phase == RolePhase::Ended => Some(ReportCase::Ended(EndReason::Over)),
        // The role was awarded to the robot before and is promised to it now.
        Some(_) if role.phase == RolePhase::Promised => Some(ReportCase::Ended(EndReason::Released)),
        // A later incarnation of the same robot holds the role.
        Some(holder) if holder.incarnation.is_some_and(|known| known > report.incarnation) => {
            Some(ReportCase::Ended(EndReason::Replaced))
        }
        Some(holder) if holder.incarnation != Some(report.incarnation) => Some(ReportCase::Unaccepted),
        Some(_) => None,
        None if entry.branch == Branch::Recovery => Some(ReportCase::Ended(EndReason::Replaced)),
        None => Some(ReportCase::Ended(EndReason::Released)),
    }
}

fn ended(entry: Option<&MissionEntry>, report: &Report, reason: EndReason) -> ReportReply {
    let holder = entry.and_then(|entry| entry.roles.get(&report.role)?.holder.as_ref());
    ReportReply::Ended { epoch: report.epoch, reason, current: holder.map(|holder| holder.epoch) }
}

fn renewed(entry: &MissionEntry, role: &RoleEntry, report: &Report) -> ReportReply {
    ReportReply::Renewed {
        epoch: report.epoch,
        ended: role.ended.clone(),
        holders: entry.role_robots(),
        signals: entry.signals_to(&report.role),
        outcomes: entry.outcomes_for(&report.role),
        answer: report.question.as_ref().and_then(|asked| answer(entry, report, asked)),
        // The handler adds them.
        orders: Box::default(),
    }
}

/// Returns the answer to the question of a report; `None` while it is open.
fn answer(entry: &MissionEntry, report: &Report, asked: &TaskQuestion) -> Option<QuestionAnswer> {
    let request = entry.question(&report.role, report.epoch, asked)?;
    let (is_answered, text) = match (&request.phase, &request.subject) {
        (PersonRequestPhase::Withdrawn { .. }, _) => return None,
        (PersonRequestPhase::Answered { answer: FinalAnswer::Done, .. }, RequestSubject::Question { answer, .. }) => {
            (true, answer.clone().unwrap_or_default())
        }
        (phase, _) => (false, phase.failure()?),
    };
    Some(QuestionAnswer { task: asked.task.clone(), number: asked.number, is_answered, text })
}

fn accept(report: &Report) -> Command {
    Command::Accept {
        mission: report.mission.clone(),
        role: report.role.clone(),
        epoch: report.epoch,
        incarnation: report.incarnation,
        from_checkpoint: report.from_checkpoint,
    }
}

fn progress(report: &Report) -> Command {
    let Report { mission, role, epoch, ended, outcomes, .. } = report.clone();
    Command::Progress { mission, role, epoch, branch: Branch::default(), ended, outcomes }
}

/// Checks whether the robot returns a role for now in which it could only wait. A role that can start is
/// released instead, so that a robot cannot postpone it again and again.
fn is_postponed(entry: &MissionEntry, report: &Report, failure: &TaskFailure) -> bool {
    failure.kind == FailureKind::Postponed && entry.only_waits(&report.role)
}

fn postpone(report: &Report) -> Command {
    let (mission, role, epoch) = (report.mission.clone(), report.role.clone(), report.epoch);
    Command::Postpone { mission, role, epoch }
}

/// Releases the role. A robot that only leaves the fleet, that gives way, or that has started nothing because
/// its checkpoint failed, may bid again.
fn release_failed(report: &Report, failure: &TaskFailure) -> Command {
    let gave_back = matches!(
        failure.kind,
        FailureKind::Leaving
            | FailureKind::Checkpoint
            | FailureKind::GaveWay
            | FailureKind::Postponed
            | FailureKind::Reassigned
    );
    let (mission, role, epoch) = (report.mission.clone(), report.role.clone(), report.epoch);
    Command::Release {
        mission,
        role,
        epoch,
        cause: failure_cause(report, failure),
        class: (!gave_back).then_some(failure.class),
        moved_nothing: failure.moved_nothing,
        place: report.place.clone(),
        gave_way: matches!(failure.kind, FailureKind::GaveWay | FailureKind::Reassigned),
    }
}

fn failure_cause(report: &Report, failure: &TaskFailure) -> String {
    if failure.kind == FailureKind::Reassigned {
        return format!("{} returned {}: {}", report.robot, report.role, failure.cause);
    }
    let what = failure.task.as_ref().map_or("go on".to_owned(), |task| format!("do {task}"));
    format!("{} as {} could not {what}: {}", report.robot, report.role, failure.cause)
}

#[cfg(test)]
mod tests;
