//! How a leader hands its office over before it goes, within a few round trips instead of an election's patience.
//!
//! ```text
//!  leaver                              successor                      other voters
//!    │ no longer leads; refuses proposals  │                               │
//!    │ waits until a live voter has all    │                               │
//!    │ releases its own openraft           │                               │
//!    ├── succeed ──────────────────────────┼──────────────────────────────►│ release: no longer bound to the leaver
//!    ◄─────────────────────────────────────┼────────────── a majority ─────┤
//!    ├── succeed ─────────────────────────►│ stands at once                │
//!    │◄──────────────── vote ──────────────┼─────────────── vote ─────────►│
//! ```
//!
//! openraft 0.9 knows no such thing, and its voters refuse every candidate for `election_min` after their leader's last
//! word. What frees them is an uncommitted vote for the successor in the next term: their leader's word then no longer is
//! their latest vote. It reaches openraft as an append whose vote is that one and whose entry to follow nobody has, so that
//! it changes nothing but the vote. To Raft it is a vote for the successor given before it was asked for; the successor still needs
//! the answers of a majority, and each compares logs again before it gives one. So a succession that is lost half-way, late
//! or repeated costs time only: it names the reign that it ends, and voters that have moved on ignore it.
//!
//! Why there are never two: the leaver stops counting itself leader before the first message goes out, and takes the vote
//! itself, so that its own openraft follows.

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

/// A leader's last word to a voter.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct TransferRequest {
    /// The reign that ends.
    pub(super) leader_vote: Vote,
    /// Who is to stand.
    pub(super) target: RaftId,
}

impl TransferRequest {
    /// The vote that it gives to the successor.
    pub(super) fn target_vote(&self) -> Vote {
        Vote::new(self.leader_vote.leader_id().term.saturating_add(1), self.target)
    }
}

/// The term in which this node led and gave it up; 0 for none.
#[derive(Debug, Default)]
pub(super) struct ResignedTerm(AtomicU64);

impl ResignedTerm {
    /// This node no longer leads in `term`, whatever openraft says.
    pub(super) fn resign(&self, term: u64) {
        self.0.store(term, Ordering::SeqCst);
    }

    /// Nobody could be found to take over: it goes on.
    pub(super) fn withdraw(&self) {
        self.0.store(0, Ordering::SeqCst);
    }

    /// Whether this node has given up the reign of `term`.
    pub(super) fn covers(&self, term: u64) -> bool {
        let resigned = self.0.load(Ordering::SeqCst);
        resigned != 0 && resigned == term
    }
}

/// Makes this node's openraft vote for the successor in the next term, if the reign that ends is still its latest vote.
/// Says whether it is free to vote for the successor now.
pub(super) async fn release_vote<S: StateMachine>(raft: &Raft<S>, word: &TransferRequest) -> bool {
    let vote = raft.server_metrics().borrow().vote;
    if vote != word.leader_vote {
        // It is free already if it has moved on to a later term, and was never bound if it has not heard of this one.
        return vote.leader_id().term > word.leader_vote.leader_id().term;
    }
    let nowhere =
        LogId::new(CommittedLeaderId::new(word.leader_vote.leader_id().term, RaftId::default()), u64::MAX / 2);
    let request = AppendEntriesRequest {
        vote: word.target_vote(),
        prev_log_id: Some(nowhere),
        entries: vec![],
        leader_commit: None,
    };
    raft.append_entries(request).await.is_ok()
}

/// Tells all voters who succeeds, the successor last: then it can be elected at once.
pub(super) async fn proclaim(
    board: &RaftClient,
    halves: &[BTreeSet<RaftId>],
    word: &TransferRequest,
    limit: Duration,
) -> bool {
    let mut free = BTreeSet::from([board.me, word.target]);
    let others: BTreeSet<RaftId> = halves.iter().flatten().copied().filter(|voter| !free.contains(voter)).collect();
    board
        .query_until_majority(
            halves,
            &mut free,
            &others,
            |line| async move { line.transfer_leadership(word, limit).await },
        )
        .await;
    // Whether or not a majority is free: those that are not will be when their patience ends.
    for _ in 0..3 {
        if board.peer(word.target).transfer_leadership(word, limit).await {
            return true;
        }
    }
    false
}

impl<S: StateMachine> Replica<S> {
    /// Gives the lead to another voter, which has all that this one has and is elected within a few round trips; to none of
    /// `shunned` unless there is nobody else. From the call on this node refuses proposals and no longer counts itself
    /// leader; it goes on voting and following. Waits `limit` at most for a voter that has everything.
    ///
    /// # Errors
    /// [`HandOverError`] says whether this node still leads.
    pub async fn transfer_leadership(
        &self,
        shunned: &BTreeSet<NodeId>,
        limit: Duration,
    ) -> Result<NodeId, TransferError> {
        let asked_at = Instant::now();
        let pick = |latest: &Metrics| {
            let shunned = if asked_at.elapsed() < limit / 2 { shunned } else { &BTreeSet::new() };
            let near = self.near();
            let all_shunned = near.values().all(|name| shunned.contains(name));
            self.best_successor(latest, near, |name| all_shunned || !shunned.contains(name))
        };
        self.hand_over_by(pick, limit).await
    }

    /// Gives up the lead to one of these voters, or else keeps it.
    ///
    /// # Errors
    /// As for [`hand_over`](Self::hand_over).
    pub async fn transfer_leadership_to(
        &self,
        to: &BTreeSet<NodeId>,
        limit: Duration,
    ) -> Result<NodeId, TransferError> {
        let pick = |latest: &Metrics| self.best_successor(latest, self.near(), |name| to.contains(name));
        self.hand_over_by(pick, limit).await
    }

    async fn hand_over_by(
        &self,
        pick: impl Fn(&Metrics) -> Option<RaftId>,
        limit: Duration,
    ) -> Result<NodeId, TransferError> {
        let inner = &*self.inner;
        let mut metrics = inner.raft.metrics();
        let (vote, leads) = {
            let now = metrics.borrow_and_update();
            (now.vote, now.state == ServerState::Leader)
        };
        if !leads {
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
        let found = async {
            loop {
                let latest = metrics.borrow_and_update().clone();
                if latest.vote != vote {
                    return Err(TransferError::NotLeader);
                }
                if let Some(successor) = pick(&latest) {
                    return Ok((successor, latest));
                }
                metrics.changed().await.map_err(|_| TransferError::Closed)?;
            }
        };
        let nobody = Err(TransferError::NoTargetReady { others, limit });
        let (successor, latest) = match timeout(limit, found).await.unwrap_or(nobody) {
            Ok(found) => found,
            Err(problem) => {
                inner.resigned_term.withdraw();
                return Err(problem);
            }
        };
        let membership = latest.membership_config.membership();
        let name = membership.get_node(&successor).map(|peer| peer.name.clone());
        let name = name.ok_or(TransferError::Closed)?;
        let word = TransferRequest { leader_vote: vote, target: successor };
        inner.leader_contact.record_own_resignation();
        if !release_vote(&inner.raft, &word).await {
            return Err(TransferError::Closed);
        }
        info!(node = %inner.settings.node, term, successor = %name, "hands over");
        match proclaim(&inner.client, membership.get_joint_config(), &word, inner.settings.heartbeat).await {
            true => Ok(name),
            false => Err(TransferError::TargetSilent { target: name }),
        }
    }

    /// The other voters that have answered of late.
    fn near(&self) -> BTreeMap<RaftId, NodeId> {
        let mut voters = self.inner.leadership.borrow().voters.clone();
        voters.retain(|id, _| *id != self.inner.id && self.has_recent_contact(*id));
        voters
    }

    /// Of these voters one that may be it and has the whole log: that of the lowest number.
    fn best_successor(
        &self,
        latest: &Metrics,
        among: BTreeMap<RaftId, NodeId>,
        may: impl Fn(&NodeId) -> bool,
    ) -> Option<RaftId> {
        let replication = latest.replication.as_ref()?;
        let mut ready = among.into_iter().filter(|(id, name)| {
            let matched = replication.get(id).copied().flatten().map(|at| at.index);
            may(name) && matched >= latest.last_log_index
        });
        ready.next().map(|(id, _)| id)
    }
}
