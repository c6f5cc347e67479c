//! When there is something to decide, and how it is carried out. Lives as long as its node coordinates.

use super::cluster_snapshot::{ClusterSnapshot, StabilityTracker};
use super::decide::{AutopilotAction, AutopilotInput, decide};
use crate::gossip::SharedKnowledge;
use crate::raft::{MemberError, Replica, TransferError};
use consort_protocol::ids::ClusterId;
use consort_protocol::ledger::Ledger;
use serde_json::{Value, json};
use std::time::Duration;
use tokio::time::Instant;

/// How long a change may take to be committed.
const LIMIT: Duration = Duration::from_secs(2);

/// How long one of those that should lead may take to have the whole log. Meanwhile nobody takes requests.
const HAND_OVER: Duration = Duration::from_millis(200);

/// How long to wait after a change that failed.
const AGAIN: Duration = Duration::from_secs(1);

/// The autopilot of one reign.
pub(crate) struct Autopilot {
    target: usize,
    dead_after: Duration,
    /// A member that has answered within this time is there.
    near: Duration,
    began: Instant,
    /// When something was changed last.
    changed: Instant,
    not_before: Instant,
    busy: bool,
    attendance: StabilityTracker,
    /// When this node last gave the lead away because another was better placed.
    yielded: Option<Instant>,
    latest: Option<(Instant, String)>,
}

/// A change that was carried out, or was not.
pub struct ActionResult {
    change: AutopilotAction,
    outcome: Result<(), ActionError>,
}

/// Why a change was not made.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ActionError {
    /// The ledger's keepers are as they were, or the next leader completes what was begun.
    #[error(transparent)]
    Members(#[from] MemberError),
    /// This node leads as before, or somebody else is elected.
    #[error(transparent)]
    Lead(#[from] TransferError),
}

impl Autopilot {
    /// `yielded` is what [`yielded`](Self::yielded) said at the end of this node's former reign.
    pub(crate) fn new(target: usize, dead_after: Duration, near: Duration, yielded: Option<Instant>) -> Autopilot {
        let now = Instant::now();
        Autopilot {
            target,
            dead_after,
            near,
            began: now,
            changed: now,
            not_before: now,
            busy: false,
            attendance: StabilityTracker::default(),
            yielded,
            latest: None,
        }
    }

    /// The change to begin now. Until [`done`](Self::done) is told of it, there is no other.
    pub(crate) fn next_action(
        &mut self,
        replica: &Replica<Ledger>,
        knowledge: &SharedKnowledge,
    ) -> Option<AutopilotAction> {
        let cluster = (*replica.cluster().borrow())?;
        if self.busy || Instant::now() < self.not_before {
            return None;
        }
        let change = decide(&self.view(replica, knowledge, cluster))?;
        self.busy = true;
        if let AutopilotAction::TransferLeadership { .. } = change {
            self.yielded = Some(Instant::now());
        }
        Some(change)
    }

    /// When this node last gave the lead away because another was better placed.
    pub(crate) fn last_transfer_at(&self) -> Option<Instant> {
        self.yielded
    }

    /// Takes note of what became of a change; gives the reason of one that was made.
    pub(crate) fn complete(&mut self, done: ActionResult) -> Result<String, (String, ActionError)> {
        self.busy = false;
        let reason = done.change.reason().to_owned();
        match done.outcome {
            Ok(()) => {
                self.changed = Instant::now();
                self.latest = Some((self.changed, reason.clone()));
                Ok(reason)
            }
            Err(problem) => {
                self.not_before = Instant::now() + AGAIN;
                Err((reason, problem))
            }
        }
    }

    /// To show.
    pub(crate) fn status(&self) -> Value {
        let latest = self.latest.as_ref().map(|(at, reason)| {
            let age_ms = u64::try_from(at.elapsed().as_millis()).unwrap_or(u64::MAX);
            json!({ "reason": reason, "age_ms": age_ms })
        });
        json!({ "voters_aimed_at": self.target, "changing": self.busy, "latest_change": latest })
    }

    fn view(&mut self, replica: &Replica<Ledger>, knowledge: &SharedKnowledge, cluster: ClusterId) -> AutopilotInput {
        let leadership = replica.leadership().borrow().clone();
        let sight = ClusterSnapshot::take(replica, knowledge, self.near, self.began.elapsed());
        let (mut voters, mut observers) = (sight.members(&leadership.voters), sight.members(&leadership.learners));
        let mut candidates = sight.candidates(&leadership, cluster);
        self.attendance.update([&mut voters, &mut observers, &mut candidates]);
        AutopilotInput {
            me: replica.id(),
            target_voters: self.target,
            dead_after: self.dead_after,
            settle_time: self.dead_after * 3,
            unchanged_for: self.changed.elapsed(),
            since_transfer: self.yielded.map(|at| at.elapsed()),
            voters,
            pending_voters: leadership.pending_voters,
            learners: observers,
            candidates,
        }
    }
}

/// Carries a change out.
pub(crate) async fn perform(replica: Replica<Ledger>, change: AutopilotAction) -> ActionResult {
    let outcome = match &change {
        AutopilotAction::AddLearner { id, node, .. } => {
            replica.add_learner(*id, node.clone(), LIMIT).await.map_err(ActionError::from)
        }
        AutopilotAction::SetVoters { voters, .. } => {
            replica.set_voters(voters.clone(), LIMIT).await.map_err(ActionError::from)
        }
        AutopilotAction::RemoveLearner { id, .. } => {
            replica.remove_learner(*id, LIMIT).await.map_err(ActionError::from)
        }
        AutopilotAction::TransferLeadership { to, .. } => {
            replica.transfer_leadership_to(to, HAND_OVER).await.map(drop).map_err(ActionError::from)
        }
    };
    ActionResult { change, outcome }
}
