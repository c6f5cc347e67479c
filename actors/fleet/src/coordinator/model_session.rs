//! A leader session for the model check: the decisions of the coordinator about leases, without the
//! actor, the bus and the replicated log around them.

use super::actions::{CoordinatorAction, SessionState};
use super::reconcile::{pending_actions, stop_renewing_released, track_awards};
use super::reports::{QuorumContact, Step, confirm, next, reply_to_refusal};
use super::rounds::Rounds;
use super::scope::Scope;
use consort_protocol::ids::RobotId;
use consort_protocol::lease::{Epoch, LeaseMonitor, LeaseTerms};
use consort_protocol::ledger::{Command, CommandOutcome, Ledger};
use consort_protocol::message::{Report, ReportReply};
use consort_protocol::units::{NodeTime, Seconds};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// A leader session, and its node's copy of the ledger.
#[derive(Debug, Clone)]
pub(crate) struct ModelSession {
    terms: LeaseTerms,
    ledger: Arc<Ledger>,
    monitor: LeaseMonitor,
}

impl ModelSession {
    /// Starts a session. Awards that it finds count as in contact at `now`.
    pub(crate) fn start(terms: LeaseTerms, ledger: Arc<Ledger>, now: NodeTime) -> ModelSession {
        let mut session = ModelSession { terms, ledger, monitor: LeaseMonitor::new(terms) };
        session.follow(now);
        session
    }

    pub(crate) fn ledger(&self) -> &Arc<Ledger> {
        &self.ledger
    }

    /// Adopts a change of the ledger.
    pub(crate) fn apply(&mut self, ledger: Arc<Ledger>, now: NodeTime) {
        self.ledger = ledger;
        self.follow(now);
    }

    fn follow(&mut self, now: NodeTime) {
        track_awards(&self.ledger, &mut self.monitor, now);
    }

    /// Returns the epochs of the roles that are to be released. Their renewal ends, unless
    /// `keeps_renewing`.
    pub(crate) fn release_expired(&mut self, keeps_renewing: bool, now: NodeTime) -> Vec<Epoch> {
        let actions = self.pending_actions(now);
        if !keeps_renewing {
            stop_renewing_released(&actions, &mut self.monitor, now);
        }
        let released = |action| match action {
            CoordinatorAction::ReleaseRole(awarded, _) => Some(awarded.epoch),
            _ => None,
        };
        actions.into_iter().filter_map(released).collect()
    }

    /// Checks whether the coordinator would call for bids.
    pub(crate) fn is_auction_due(&self, now: NodeTime) -> bool {
        self.pending_actions(now).iter().any(|action| matches!(action, CoordinatorAction::CallForBids(_)))
    }

    fn pending_actions(&self, now: NodeTime) -> Vec<CoordinatorAction> {
        let (rounds, notified) = (Rounds::default(), BTreeMap::new());
        let (unfit, charges) = (BTreeMap::new(), BTreeMap::new());
        let state = SessionState {
            lease_monitor: &self.monitor,
            rounds: &rounds,
            notified: &notified,
            unfit: &unfit,
            charges: &charges,
            promises_max: 0,
            ahead: Seconds::ZERO,
        };
        pending_actions(&self.ledger, &state, Scope::All, now, None)
    }

    /// Returns the command that a report requires, or the reply.
    pub(crate) fn next_step(&self, report: &Report) -> Result<ReportReply, Box<Command>> {
        match next(self.ledger.mission(&report.mission), report) {
            Step::Reply(reply) => Ok(reply),
            Step::Commit(command) => Err(Box::new(command)),
        }
    }

    /// Returns the reply to a report whose command had this outcome, if it ends the report.
    pub(crate) fn reply_to_refusal(outcome: &CommandOutcome, report: &Report) -> Option<ReportReply> {
        reply_to_refusal(outcome, report)
    }

    /// Returns the reply that the coordinator sends, `age` after its last contact with a majority.
    pub(crate) fn confirm(&mut self, reply: ReportReply, report: &Report, age: Duration, now: NodeTime) -> ReportReply {
        let quorum = QuorumContact { age: Some(age), age_max: self.terms.leadership_age_max() };
        confirm(reply, report, quorum, &mut self.monitor, || now)
    }

    /// Returns the time since the last contact, and whether the award may be renewed.
    pub(crate) fn contact(&self, epoch: Epoch, robot: &RobotId, now: NodeTime) -> (Duration, bool) {
        (self.monitor.since_contact(epoch, robot, now), self.monitor.clone().renew(epoch, robot, now))
    }
}
