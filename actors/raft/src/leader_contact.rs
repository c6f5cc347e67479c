//! Contact of a node with leaders and candidates: the bond of its vote, and its waits.

use super::messages::HeartbeatReply;
use super::settings::APPEND_TIMEOUT;
use super::types::Vote;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// Number of sequential disk syncs from a granted vote until the voters have contact with the new
/// leader, plus 1 in reserve. The winner syncs its own vote and then the first entry of its term,
/// while it serves requests of others.
const SYNCS_TO_LEAD: u32 = 4;

/// Record of contact with leaders and candidates at this node.
#[derive(Debug)]
pub(super) struct LeaderContact(Mutex<ContactState>);

#[derive(Debug, Clone, Copy)]
struct ContactState {
    last_contact: Instant,
    vote_granted_at: Option<Instant>,
    /// Time of the last contact from a leader to which this node is still bound: it grants no other
    /// vote for a while.
    bound_at: Option<Instant>,
    /// Number of votes that openraft may be about to grant, including this node's own candidacy;
    /// and the start of the first of them.
    pending_votes: u32,
    votes_began: Instant,
    /// Time until which this node waits for the candidates it voted for.
    candidate_wait_until: Instant,
    /// Latest vote known to be granted.
    latest_vote: Vote,
    /// Number of appends pending in openraft, and the time at which the last of them began or
    /// ended.
    pending_appends: u32,
    append_progress: Instant,
    resigned_at: Option<Instant>,
}

impl LeaderContact {
    /// Starts as if a leader had made contact just now: this gives an existing leader time to send
    /// a heartbeat.
    pub(super) fn new() -> Self {
        let now = Instant::now();
        LeaderContact(Mutex::new(ContactState {
            last_contact: now,
            vote_granted_at: None,
            // The leader that this node was bound to before the restart is unknown.
            bound_at: Some(now),
            pending_votes: 0,
            votes_began: now,
            candidate_wait_until: now,
            latest_vote: Vote::default(),
            pending_appends: 0,
            append_progress: now,
            resigned_at: None,
        }))
    }

    fn lock(&self) -> MutexGuard<'_, ContactState> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Records contact from the leader elected by `vote`. Returns `false` if `known` or a granted
    /// vote supersedes that leader.
    pub(super) fn record_leader(&self, vote: &Vote, known: &Vote) -> bool {
        self.lock().record_leader(vote, known)
    }

    /// Answers a heartbeat request of a leader. An acknowledgement binds this node as an append
    /// does. So it is given only if this node is not about to vote, and is not stuck.
    pub(super) fn answer_heartbeat(&self, vote: &Vote, known: &Vote) -> HeartbeatReply {
        let mut state = self.lock();
        let busy = state.pending_appends > 0;
        let stuck = busy && state.append_progress.elapsed() >= APPEND_TIMEOUT;
        let follows = state.pending_votes == 0 && !stuck && state.record_leader(vote, known);
        HeartbeatReply { follows, busy }
    }

    /// Marks an append as pending in openraft, until the returned guard is dropped.
    pub(super) fn begin_append(&self) -> PendingAppend<'_> {
        let mut state = self.lock();
        if state.pending_appends == 0 {
            state.append_progress = Instant::now();
        }
        state.pending_appends += 1;
        PendingAppend(self)
    }

    /// Checks whether openraft may grant a vote: this node is bound to no leader. If so, it binds
    /// itself to none until [`LeaderContact::end_vote`].
    pub(super) fn try_begin_vote(&self, election_min: Duration) -> bool {
        let mut state = self.lock();
        let free = state.bound_at.is_none_or(|at| at.elapsed() >= election_min);
        if free && state.pending_votes == 0 {
            state.votes_began = Instant::now();
        }
        state.pending_votes += u32::from(free);
        free
    }

    /// Records the result of the vote request begun by [`LeaderContact::try_begin_vote`].
    pub(super) fn end_vote(&self, granted: Option<Vote>) {
        let mut state = self.lock();
        state.pending_votes -= 1;
        state.candidate_wait_until = state
            .candidate_wait_until
            .max(Instant::now() + state.votes_began.elapsed().min(APPEND_TIMEOUT) * SYNCS_TO_LEAD);
        state.latest_vote = granted
            .map_or(state.latest_vote, |granted| if granted > state.latest_vote { granted } else { state.latest_vote });
    }

    /// Records that a resigning leader has released this node, and that its vote is granted to the
    /// transfer target.
    pub(super) fn record_release(&self, granted: Vote) {
        let mut state = self.lock();
        state.bound_at = None;
        if granted > state.latest_vote {
            state.latest_vote = granted;
        }
    }

    /// Records that the leader has resigned: this node stops waiting for its contact.
    pub(super) fn record_leader_resigned(&self) {
        let mut state = self.lock();
        state.bound_at = None;
        state.last_contact = state.last_contact.checked_sub(Duration::from_secs(60)).unwrap_or(state.last_contact);
    }

    /// Records that a candidate received this node's vote: the candidate needs a few round trips to
    /// become leader.
    pub(super) fn record_vote_granted(&self) {
        self.lock().vote_granted_at = Some(Instant::now());
    }

    /// Records that this node resigns as leader and grants its vote to the transfer target. Another
    /// node is to be elected, either the target or a different one.
    pub(super) fn record_own_resignation(&self) {
        let now = Some(Instant::now());
        let mut state = self.lock();
        (state.vote_granted_at, state.resigned_at) = (now, now);
    }

    /// Checks whether the others have had `timeout` to elect a leader since this node resigned.
    pub(super) fn resignation_is_past(&self, timeout: Duration) -> bool {
        self.lock().resigned_at.is_none_or(|at| at.elapsed() >= timeout)
    }

    pub(super) fn last_contact(&self) -> Instant {
        self.lock().last_contact
    }

    /// Checks whether there was no leader contact for `timeout`, and no candidate that this node
    /// waits for.
    pub(super) fn no_leader_for(&self, timeout: Duration, heartbeat: Duration) -> bool {
        let state = self.lock();
        let waits = state.pending_votes > 0 || state.candidate_wait_until > Instant::now();
        state.last_contact.elapsed() >= timeout
            && !waits
            && state.vote_granted_at.is_none_or(|at| at.elapsed() >= heartbeat)
    }
}

impl ContactState {
    fn record_leader(&mut self, vote: &Vote, known: &Vote) -> bool {
        // A leader's vote is committed: it prevails over candidates of its own term, and over all
        // votes of earlier terms.
        let rank = |vote: &Vote| (vote.leader_id().term, vote.is_committed());
        let is_current = rank(vote) >= rank(known).max(rank(&self.latest_vote));
        if is_current {
            self.last_contact = Instant::now();
            self.bound_at = Some(self.last_contact);
        }
        is_current
    }
}

/// An append that is pending in openraft.
pub(super) struct PendingAppend<'a>(&'a LeaderContact);

impl Drop for PendingAppend<'_> {
    fn drop(&mut self) {
        let mut state = self.0.lock();
        state.pending_appends -= 1;
        state.append_progress = Instant::now();
    }
}
