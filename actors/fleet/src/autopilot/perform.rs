//! Autopilot actions: selection of the next action, and its execution. It exists while its node is
//! the coordinator.

use super::cluster_snapshot::{ClusterSnapshot, StabilityTracker};
use super::decide::{AutopilotAction, AutopilotInput, AutopilotRule};
use consort_gossip::SharedKnowledge;
use consort_protocol::ids::ClusterId;
use consort_protocol::ledger::Ledger;
use consort_protocol::view::{AutopilotView, VoterChange};
use consort_raft::{MemberError, Replica, TransferError};
use std::time::Duration;
use tokio::time::Instant;

/// Time limit for the commit of a membership change.
const CHANGE_TIMEOUT: Duration = Duration::from_secs(2);

/// Time limit for a preferred voter to have the whole log. Meanwhile no node accepts requests.
const TRANSFER_TIMEOUT: Duration = Duration::from_millis(200);

/// Pause after a failed action.
const RETRY_PAUSE: Duration = Duration::from_secs(1);

/// Settings of the autopilot.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AutopilotSettings {
    /// Decision rule.
    pub(crate) rule: AutopilotRule,
    /// Number of voters that the autopilot aims at.
    pub(crate) target_voters: usize,
    /// Time without contact after which the autopilot replaces a voter.
    pub(crate) dead_after: Duration,
    /// Age of the last reply up to which a voter counts as healthy: several heartbeats.
    pub(crate) contact_max: Duration,
}

/// Autopilot of a single leader session.
pub(crate) struct Autopilot {
    settings: AutopilotSettings,
    began: Instant,
    /// Time of the last change.
    changed: Instant,
    not_before: Instant,
    busy: bool,
    stability: StabilityTracker,
    /// Time at which this node last transferred leadership because another voter was more suitable.
    last_transfer_at: Option<Instant>,
    latest: Option<(Instant, String)>,
}

/// Result of an action.
pub(crate) struct ActionResult {
    action: AutopilotAction,
    result: Result<(), ActionError>,
}

/// The action was not completed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ActionError {
    /// The voters are unchanged, or the next leader completes a change that was begun.
    #[error(transparent)]
    Membership(#[from] MemberError),
    /// This node is still the leader, or another node is elected.
    #[error(transparent)]
    Transfer(#[from] TransferError),
}

impl Autopilot {
    /// Creates the autopilot. `last_transfer_at` is the value of
    /// [`last_transfer_at`](Self::last_transfer_at) at the end of this node's previous leader
    /// session.
    pub(crate) fn new(settings: AutopilotSettings, last_transfer_at: Option<Instant>) -> Autopilot {
        let now = Instant::now();
        Autopilot {
            settings,
            began: now,
            changed: now,
            not_before: now,
            busy: false,
            stability: StabilityTracker::default(),
            last_transfer_at,
            latest: None,
        }
    }

    /// Returns the action to begin now. There is no other until [`complete`](Self::complete) is
    /// called with its result.
    pub(crate) fn next_action(
        &mut self,
        replica: &Replica<Ledger>,
        knowledge: &SharedKnowledge,
    ) -> Option<AutopilotAction> {
        let cluster = (*replica.cluster().borrow())?;
        if self.busy || Instant::now() < self.not_before {
            return None;
        }
        let action = (self.settings.rule)(&self.input(replica, knowledge, cluster))?;
        self.busy = true;
        if let AutopilotAction::TransferLeadership { .. } = action {
            self.last_transfer_at = Some(Instant::now());
        }
        Some(action)
    }

    /// Time at which this node last transferred leadership because another voter was more suitable.
    pub(crate) fn last_transfer_at(&self) -> Option<Instant> {
        self.last_transfer_at
    }

    /// Records the result of an action; returns the reason of a completed action.
    pub(crate) fn complete(&mut self, result: ActionResult) -> Result<String, (String, ActionError)> {
        self.busy = false;
        let reason = result.action.reason().to_owned();
        match result.result {
            Ok(()) => {
                self.changed = Instant::now();
                self.latest = Some((self.changed, reason.clone()));
                Ok(reason)
            }
            Err(error) => {
                self.not_before = Instant::now() + RETRY_PAUSE;
                Err((reason, error))
            }
        }
    }

    /// Returns the status for display.
    pub(crate) fn status(&self) -> AutopilotView {
        let latest_change = self.latest.as_ref().map(|(at, reason)| {
            let age_ms = u64::try_from(at.elapsed().as_millis()).unwrap_or(u64::MAX);
            VoterChange { reason: reason.clone(), age_ms }
        });
        AutopilotView { target_voters: self.settings.target_voters, change_in_progress: self.busy, latest_change }
    }

    fn input(&mut self, replica: &Replica<Ledger>, knowledge: &SharedKnowledge, cluster: ClusterId) -> AutopilotInput {
        let leadership = replica.leadership().borrow().clone();
        let snapshot = ClusterSnapshot::take(replica, knowledge, self.settings.contact_max, self.began.elapsed());
        let (mut voters, mut learners) = (snapshot.members(&leadership.voters), snapshot.members(&leadership.learners));
        let mut candidates = snapshot.candidates(&leadership, cluster);
        self.stability.update([&mut voters, &mut learners, &mut candidates]);
        AutopilotInput {
            me: replica.id(),
            target_voters: self.settings.target_voters,
            dead_after: self.settings.dead_after,
            settle_time: self.settings.dead_after * 3,
            unchanged_for: self.changed.elapsed(),
            since_transfer: self.last_transfer_at.map(|at| at.elapsed()),
            voters,
            pending_voters: leadership.pending_voters,
            learners,
            candidates,
        }
    }
}

/// Performs an action.
pub(crate) async fn perform(replica: Replica<Ledger>, action: AutopilotAction) -> ActionResult {
    let result = match &action {
        AutopilotAction::AddLearner { id, node, .. } => {
            replica.add_learner(*id, node.clone(), CHANGE_TIMEOUT).await.map_err(ActionError::from)
        }
        AutopilotAction::SetVoters { voters, .. } => {
            replica.set_voters(voters.clone(), CHANGE_TIMEOUT).await.map_err(ActionError::from)
        }
        AutopilotAction::RemoveLearner { id, .. } => {
            replica.remove_learner(*id, CHANGE_TIMEOUT).await.map_err(ActionError::from)
        }
        AutopilotAction::TransferLeadership { to, .. } => {
            replica.transfer_leadership_to(to, TRANSFER_TIMEOUT).await.map(drop).map_err(ActionError::from)
        }
    };
    ActionResult { action, result }
}
