//! Bugs in the handling of robot reports, injected at the bus of the coordinator.

use super::Mutant;
use super::known_ledger::KnownLedger;
use super::message::{decode_report, encoded};
use async_trait::async_trait;
use bytes::Bytes;
use consort_bus::{BusError, Encoding, Query, Replier};
use consort_protocol::codec;
use consort_protocol::lease::EndReason;
use consort_protocol::ledger::{Ledger, MissionEntry, MissionState, RoleEntry};
use consort_protocol::message::{ClusterEnvelope, Report, ReportReply};
use consort_protocol::plan::StepAction;

/// Bug in the handling of reports.
#[derive(Clone, Copy)]
pub(super) enum ReportBug {
    /// A report of an outdated award is renewed.
    RenewOutdated,
    /// In addition, the content of the report is recorded under the award in force.
    RecordOutdated,
    /// A report is answered before its content is committed.
    ReplyBeforeCommit,
}

impl ReportBug {
    /// Returns the bug of a mutant, if the mutant concerns reports at the coordinator.
    pub(super) fn of(mutant: Mutant) -> Option<ReportBug> {
        match mutant {
            Mutant::IgnoreEpoch => Some(ReportBug::RenewOutdated),
            Mutant::RefusedApplied => Some(ReportBug::RecordOutdated),
            Mutant::UncommittedReport => Some(ReportBug::ReplyBeforeCommit),
            _ => None,
        }
    }

    /// Applies the bug to a report that arrives at the coordinator.
    pub(super) fn apply(self, query: Query, ledger: &KnownLedger) -> Query {
        let Some(report) = decode_report(&query.payload) else { return query };
        match self {
            ReportBug::RenewOutdated => renew_outdated(query, report, ledger),
            ReportBug::RecordOutdated => {
                let in_force = ledger.read(|ledger| under_award_in_force(ledger, &report));
                let payload = in_force.and_then(|changed| with_report(&query.payload, &changed));
                let payload = payload.unwrap_or_else(|| query.payload.clone());
                renew_outdated(Query { payload, ..query }, report, ledger)
            }
            ReportBug::ReplyBeforeCommit => match ledger.read(|ledger| reply_to_news(ledger, &report)) {
                Some(reply) => reply_at_once(query, encoded(&reply), Encoding::Wire),
                None => query,
            },
        }
    }
}

fn with_report(payload: &[u8], report: &Report) -> Option<Bytes> {
    let envelope: ClusterEnvelope = codec::decode(payload).ok()?;
    Some(encoded(&ClusterEnvelope { payload: encoded(report).to_vec(), ..envelope }))
}

/// Adds all signals that the role awaits to the reply to its report.
pub(super) fn with_all_signals(ledger: &Ledger, report: &Report, mut reply: ReportReply) -> ReportReply {
    let plan = ledger.mission(&report.mission).and_then(|entry| entry.plan(&report.role));
    if let (ReportReply::Renewed { signals, .. }, Some(plan)) = (&mut reply, plan) {
        let awaited = plan.steps.iter().filter_map(|step| match &step.action {
            StepAction::Wait(signal) => Some(signal.clone()),
            StepAction::Send(_) | StepAction::Task { .. } => None,
        });
        signals.extend(awaited);
    }
    reply
}

/// Returns the role of a report, if its mission is under way.
fn reported_role<'a>(ledger: &'a Ledger, report: &Report) -> Option<(&'a MissionEntry, &'a RoleEntry)> {
    let entry = ledger.mission(&report.mission)?;
    let under_way = matches!(entry.state, MissionState::Pending | MissionState::Running);
    Some((entry, entry.roles.get(&report.role).filter(|_| under_way)?))
}

/// Returns the report as if the present holder of the role had sent it.
fn under_award_in_force(ledger: &Ledger, report: &Report) -> Option<Report> {
    let (_, role) = reported_role(ledger, report)?;
    let holder = role.holder.as_ref()?;
    let (robot, epoch, incarnation) = (holder.robot.clone(), holder.epoch, holder.incarnation?);
    Some(Report { robot, epoch, incarnation, ..report.clone() })
}

/// Returns the reply to a report of ended steps as if the ledger contained them, and `None` for
/// another report.
fn reply_to_news(ledger: &Ledger, report: &Report) -> Option<ReportReply> {
    let (entry, role) = reported_role(ledger, report)?;
    let is_current = role.holder.as_ref().is_some_and(|holder| {
        (&holder.robot, holder.epoch, holder.incarnation) == (&report.robot, report.epoch, Some(report.incarnation))
    });
    if !is_current || report.ended.is_subset(&role.ended) {
        return None;
    }
    let epoch = report.epoch;
    if entry.plan(&report.role).map(|plan| plan.steps.len()) == Some(report.ended.len()) {
        return Some(ReportReply::Ended { epoch, reason: EndReason::Over, current: Some(epoch) });
    }
    let (ended, holders) = (report.ended.clone(), entry.role_holders());
    let (signals, outcomes) = Default::default();
    let orders = Box::default();
    Some(ReportReply::Renewed { epoch, ended, holders, signals, outcomes, answer: None, orders })
}

/// Sends `reply`, and passes the query on without a way to reply.
pub(super) fn reply_at_once(query: Query, reply: Bytes, encoding: Encoding) -> Query {
    let (at, replier) = (query.key.clone(), query.replier);
    tokio::spawn(async move { replier.reply(&at, reply, encoding).await });
    Query { replier: Box::new(Silent), ..query }
}

/// Replier that drops all replies.
struct Silent;

#[async_trait]
impl Replier for Silent {
    async fn reply_with_attachment(&self, _: &str, _: Bytes, _: Bytes, _: Encoding) -> Result<(), BusError> {
        Ok(())
    }

    async fn refuse(&self, _: &str) -> Result<(), BusError> {
        Ok(())
    }
}

fn renew_outdated(query: Query, report: Report, ledger: &KnownLedger) -> Query {
    let replier = Box::new(RenewsOutdated { report, ledger: ledger.clone(), inner: query.replier });
    Query { replier, ..query }
}

/// Replier that renews the reported award although another award has replaced it.
struct RenewsOutdated {
    report: Report,
    ledger: KnownLedger,
    inner: Box<dyn Replier>,
}

impl RenewsOutdated {
    fn change(&self, reply: ReportReply) -> ReportReply {
        let reported = self.report.epoch;
        match reply {
            ReportReply::Renewed { ended, holders, signals, outcomes, answer, orders, .. } => {
                ReportReply::Renewed { epoch: reported, ended, holders, signals, outcomes, answer, orders }
            }
            ReportReply::Ended { reason: EndReason::Replaced, current: Some(current), .. } => self
                .ledger
                .read(|ledger| {
                    let (entry, role) = reported_role(ledger, &self.report)?;
                    let (ended, holders) = (role.ended.clone(), entry.role_holders());
                    let role = &self.report.role;
                    let (signals, outcomes) = (entry.signals_to(role), entry.outcomes_for(role));
                    let (answer, orders) = (None, Box::default());
                    Some(ReportReply::Renewed { epoch: reported, ended, holders, signals, outcomes, answer, orders })
                })
                .unwrap_or(ReportReply::Ended { epoch: reported, reason: EndReason::Replaced, current: Some(current) }),
            ReportReply::Ended { reason, current, .. } => ReportReply::Ended { epoch: reported, reason, current },
            ReportReply::NotCoordinator { .. } => reply,
        }
    }
}

#[async_trait]
impl Replier for RenewsOutdated {
    async fn reply_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        attachment: Bytes,
        encoding: Encoding,
    ) -> Result<(), BusError> {
        let payload = codec::decode(&payload).map_or(payload, |reply| encoded(&self.change(reply)));
        self.inner.reply_with_attachment(key, payload, attachment, encoding).await
    }

    async fn refuse(&self, reason: &str) -> Result<(), BusError> {
        self.inner.refuse(reason).await
    }
}
