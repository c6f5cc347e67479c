//! Transfer of the leadership of this node to another voter.

use super::Replica;
use crate::errors::TransferError;
use crate::leadership_transfer::{release_vote, send_transfer};
use crate::leadership_view::ResignedTerm;
use crate::messages::TransferRequest;
use crate::types::{Metrics, RaftId, StateMachine};
use consort_protocol::ids::NodeId;
use openraft::ServerState;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tokio::time::{Instant, timeout};
use tracing::info;

/// Resignation of a leader, which is withdrawn unless a target is found: else openraft would go on
/// as leader of a node that does not lead, and no other node would be elected.
struct Resignation<'a>(Option<&'a ResignedTerm>);

impl<'a> Resignation<'a> {
    fn begin(resigned_term: &'a ResignedTerm, term: u64) -> Resignation<'a> {
        resigned_term.resign(term);
        Resignation(Some(resigned_term))
    }

    /// Keeps the resignation for the rest of the term.
    fn keep(mut self) {
        self.0 = None;
    }
}

impl Drop for Resignation<'_> {
    fn drop(&mut self) {
        if let Some(resigned_term) = self.0 {
            resigned_term.withdraw();
        }
    }
}

impl<S: StateMachine> Replica<S> {
    /// Transfers leadership to another voter that has the whole log of this node and is elected
    /// within a few round trips. A voter in `avoid` is chosen only if there is no other. From the
    /// call on this node rejects proposals and no longer counts itself leader; it keeps voting and
    /// following. Waits at most `limit` for a voter with the whole log.
    ///
    /// # Errors
    /// [`TransferError`] states whether this node is still the leader. It is, too, if the future is
    /// dropped before a voter with the whole log was found.
    pub async fn transfer_leadership(
        &self,
        avoid: &BTreeSet<NodeId>,
        limit: Duration,
    ) -> Result<NodeId, TransferError> {
        let started = Instant::now();
        let choose = |latest: &Metrics| {
            let avoid = if started.elapsed() < limit / 2 { avoid } else { &BTreeSet::new() };
            let candidates = self.recent_contacts();
            let all_avoided = candidates.values().all(|name| avoid.contains(name));
            self.choose_target(latest, candidates, |name| all_avoided || !avoid.contains(name))
        };
        self.transfer_by(choose, limit).await
    }

    /// Transfers leadership to a voter in `targets`, or keeps it.
    ///
    /// # Errors
    /// As for [`transfer_leadership`](Self::transfer_leadership).
    pub async fn transfer_leadership_to(
        &self,
        targets: &BTreeSet<NodeId>,
        limit: Duration,
    ) -> Result<NodeId, TransferError> {
        let choose =
            |latest: &Metrics| self.choose_target(latest, self.recent_contacts(), |name| targets.contains(name));
        self.transfer_by(choose, limit).await
    }

    async fn transfer_by(
        &self,
        choose: impl Fn(&Metrics) -> Option<RaftId>,
        limit: Duration,
    ) -> Result<NodeId, TransferError> {
        let inner = &*self.inner;
        let mut metrics = inner.raft.metrics();
        let (vote, is_leader) = {
            let now = metrics.borrow_and_update();
            (now.vote, now.state == ServerState::Leader)
        };
        if !is_leader {
            return Err(TransferError::NotLeader);
        }
        let term = vote.leader_id().term;
        let others = inner.leadership.view.borrow().voters.keys().filter(|id| **id != inner.id).count();
        if others == 0 {
            return Err(TransferError::OnlyVoter);
        }
        let resignation = Resignation::begin(&inner.leadership.resigned_term, term);
        inner.leadership.withdraw_leader(term);
        let chosen = async {
            loop {
                let latest = metrics.borrow_and_update().clone();
                if latest.vote != vote {
                    return Err(TransferError::NotLeader);
                }
                if let Some(target) = choose(&latest) {
                    return Ok((target, latest));
                }
                metrics.changed().await.map_err(|_| TransferError::Closed)?;
            }
        };
        let no_target = Err(TransferError::NoTargetReady { others, limit });
        let (target, latest) = timeout(limit, chosen).await.unwrap_or(no_target)?;
        let membership = latest.membership_config.membership();
        let name = membership.get_node(&target).map(|peer| peer.name.clone());
        let name = name.ok_or(TransferError::Closed)?;
        let request = TransferRequest { leader_vote: vote, target };
        resignation.keep();
        inner.leadership.leader_contact.record_own_resignation();
        if !release_vote(&inner.raft, &request).await {
            return Err(TransferError::Closed);
        }
        info!(node = %inner.settings.node, term, successor = %name, "transferring leadership");
        match send_transfer(&inner.client, membership.get_joint_config(), &request, inner.settings.heartbeat).await {
            true => Ok(name),
            false => Err(TransferError::TargetSilent { target: name }),
        }
    }

    /// Returns the other voters with recent contact.
    fn recent_contacts(&self) -> BTreeMap<RaftId, NodeId> {
        let mut voters = self.inner.leadership.view.borrow().voters.clone();
        voters.retain(|id, _| *id != self.inner.id && self.has_recent_contact(*id));
        voters
    }

    /// Returns the voter with the lowest id that is allowed and has the whole log.
    fn choose_target(
        &self,
        latest: &Metrics,
        candidates: BTreeMap<RaftId, NodeId>,
        is_allowed: impl Fn(&NodeId) -> bool,
    ) -> Option<RaftId> {
        let replication = latest.replication.as_ref()?;
        let mut ready = candidates.into_iter().filter(|(id, name)| {
            let matched = replication.get(id).copied().flatten().map(|at| at.index);
            is_allowed(name) && matched >= latest.last_log_index
        });
        ready.next().map(|(id, _)| id)
    }
}
