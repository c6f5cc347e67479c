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

use super::messages::TransferRequest;
use super::network::RaftClient;
use super::types::{Raft, RaftId, StateMachine, Vote};
use openraft::raft::AppendEntriesRequest;
use openraft::{CommittedLeaderId, LogId};
use std::collections::BTreeSet;
use std::time::Duration;

/// Makes this node's openraft vote for the target in the next term, if the vote of the resigning
/// leader is still its latest vote. Returns whether it is now free to vote for the target.
pub(super) async fn release_vote<S: StateMachine>(raft: &Raft<S>, request: &TransferRequest) -> bool {
    let vote = raft.server_metrics().borrow().vote;
    if vote != request.leader_vote {
        // It is free already if it has moved on to a later term. It was never bound if it has no
        // vote of this term.
        return vote.leader_id().term > request.leader_vote.leader_id().term;
    }
    vote_for(raft, request.target_vote(), request.leader_vote.leader_id().term).await
}

/// Makes this node's openraft vote for a candidate, although it follows the leader of `term`.
/// Returns whether openraft has handled it; it keeps a vote that is later.
pub(super) async fn vote_for<S: StateMachine>(raft: &Raft<S>, candidate: Vote, term: u64) -> bool {
    let unknown_entry = LogId::new(CommittedLeaderId::new(term, RaftId::default()), u64::MAX / 2);
    let append = AppendEntriesRequest {
        vote: candidate,
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
