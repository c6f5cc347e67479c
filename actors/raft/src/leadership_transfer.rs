//! Leadership transfer: a leader passes its leadership to another voter within a few round trips,
//! without the wait for an election timeout.
//!
//! ```text
//!  leader                               target                         other voters
//!    │ stops leading; rejects proposals    │                               │
//!    │ waits until a live voter has all    │                               │
//!    │ releases the vote of its openraft   │                               │
//!    ├── transfer ─────────────────────────┼──────────────────────────────►│ release the vote: not bound to the leader
//!    ◄─────────────────────────────────────┼────────────── a majority ─────┤
//!    ├── transfer ────────────────────────►│ campaigns at once             │
//!    │◄──────────────── vote ──────────────┼─────────────── vote ─────────►│
//! ```
//!
//! openraft 0.9 has no leadership transfer, and its voters reject every candidate for
//! `election_min` after the last contact from their leader. An uncommitted vote for the target in
//! the next term releases them: the vote for the leader is then no longer their latest vote. This
//! vote reaches openraft as an append with that vote, and with a previous entry that no log
//! contains, so that it changes only the vote. In terms of Raft it is a vote for the target,
//! granted before the request. The target still needs the replies of a majority, and each voter
//! compares logs again before it replies. So a transfer that is lost half-way, late or repeated
//! only costs time: it contains the vote of the old leader, and voters that have moved on ignore
//! it.
//!
//! There are never two leaders: the old leader stops counting itself leader before the first
//! message is sent, and records the vote for the target itself, so that its own openraft steps
//! down.

use super::errors::TransferError;
use super::leadership_view::Metrics;
use super::network::RaftClient;
use super::replica::Replica;
use super::types::{Raft, RaftId, StateMachine, Vote};
use consort_protocol::ids::NodeId;
use openraft::raft::AppendEntriesRequest;
use openraft::{CommittedLeaderId, LogId, ServerState};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::time::{Instant, timeout};
use tracing::info;

/// Request of a resigning leader to a voter.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct TransferRequest {
    /// Vote that made the resigning leader.
    pub(super) leader_vote: Vote,
    /// Voter that is to campaign.
    pub(super) target: RaftId,
}

impl TransferRequest {
    /// Returns the vote that the request grants to the target.
    pub(super) fn target_vote(&self) -> Vote {
        Vote::new(self.leader_vote.leader_id().term.saturating_add(1), self.target)
    }
}

/// Term in which this node resigned as leader; 0 for none.
#[derive(Debug, Default)]
pub(super) struct ResignedTerm(AtomicU64);

impl ResignedTerm {
    /// Records that this node no longer leads in `term`, regardless of openraft's state.
    pub(super) fn resign(&self, term: u64) {
        self.0.store(term, Ordering::SeqCst);
    }

    /// Withdraws the resignation: no target was found, and this node stays the leader.
    pub(super) fn withdraw(&self) {
        self.0.store(0, Ordering::SeqCst);
    }

    /// Checks whether this node has resigned in `term`.
    pub(super) fn covers(&self, term: u64) -> bool {
        let resigned = self.0.load(Ordering::SeqCst);
        resigned != 0 && resigned == term
    }
}

/// Makes this node's openraft vote for the target in the next term, if the vote of the resigning
/// leader is still its latest vote. Returns whether it is now free to vote for the target.
pub(super) async fn release_vote<S: StateMachine>(raft: &Raft<S>, request: &TransferRequest) -> bool {
    let vote = raft.server_metrics().borrow().vote;
    if vote != request.leader_vote {
        // It is free already if it has moved on to a later term. It was never bound if it has no
        // vote of this term.
        return vote.leader_id().term > request.leader_vote.leader_id().term;
    }
    let unknown_entry =
        LogId::new(CommittedLeaderId::new(request.leader_vote.leader_id().term, RaftId::default()), u64::MAX / 2);
    let append = AppendEntriesRequest {
        vote: request.target_vote(),
        prev_log_id: Some(unknown_entry),
        entries: vec![],
        leader_commit: None,
    };
    raft.append_entries(append).await.is_ok()
}

/// Sends the transfer to all voters, to the target last: then it can be elected at once.
pub(super) async fn send_transfer(
    client: &RaftClient,
    halves: &[BTreeSet<RaftId>],
    request: &TransferRequest,
    limit: Duration,
) -> bool {
    let mut released = BTreeSet::from([client.me, request.target]);
    let others: BTreeSet<RaftId> = halves.iter().flatten().copied().filter(|voter| !released.contains(voter)).collect();
    client
        .query_until_majority(halves, &mut released, &others, |peer| async move {
            peer.transfer_leadership(request, limit).await
        })
        .await;
    // Continues even without a released majority: the other voters are released by their election
    // timeouts.
    for _ in 0..3 {
        if client.peer(request.target).transfer_leadership(request, limit).await {
            return true;
        }
    }
    false
}

impl<S: StateMachine> Replica<S> {
    /// Transfers leadership to another voter that has the whole log of this node and is elected
    /// within a few round trips. A voter in `avoid` is chosen only if there is no other. From the
    /// call on this node rejects proposals and no longer counts itself leader; it keeps voting and
    /// following. Waits at most `limit` for a voter with the whole log.
    ///
    /// # Errors
    /// [`TransferError`] states whether this node is still the leader.
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
        let others = inner.leadership.borrow().voters.keys().filter(|id| **id != inner.id).count();
        if others == 0 {
            return Err(TransferError::OnlyVoter);
        }
        inner.resigned_term.resign(term);
        inner.leadership.send_modify(|now| {
            if now.term == term {
                *now = now.clone().without_leader();
            }
        });
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
        let (target, latest) = match timeout(limit, chosen).await.unwrap_or(no_target) {
            Ok(chosen) => chosen,
            Err(error) => {
                inner.resigned_term.withdraw();
                return Err(error);
            }
        };
        let membership = latest.membership_config.membership();
        let name = membership.get_node(&target).map(|peer| peer.name.clone());
        let name = name.ok_or(TransferError::Closed)?;
        let request = TransferRequest { leader_vote: vote, target };
        inner.leader_contact.record_own_resignation();
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
        let mut voters = self.inner.leadership.borrow().voters.clone();
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
