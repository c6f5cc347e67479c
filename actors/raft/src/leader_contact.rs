//! Contact of a node with leaders and candidates: the bond of its vote, and its waits.

use super::messages::HeartbeatReply;
use super::settings::APPEND_TIMEOUT;
use super::types::{RaftId, Vote, leader_id_of};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;

/// Number of sequential disk syncs from a granted vote until the voters have contact with the new
/// leader, plus 1 in reserve. The winner syncs its own vote and then the first entry of its term,
/// while it serves requests of others.
const SYNCS_TO_LEAD: u32 = 4;

/// Record of contact with leaders and candidates at this node.
#[derive(Debug)]
pub(super) struct LeaderContact {
    state: Mutex<ContactState>,
    /// Leader that this node has lost, until the next contact with a leader.
    lost: watch::Sender<Option<RaftId>>,
}

#[derive(Debug, Clone, Copy)]
struct ContactState {
    last_contact: Instant,
    /// Leader of the last contact; `None` before the first since the start.
    leader: Option<RaftId>,
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
        let state = Mutex::new(ContactState {
            last_contact: now,
            leader: None,
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
        });
        LeaderContact { state, lost: watch::Sender::new(None) }
    }

    fn lock(&self) -> MutexGuard<'_, ContactState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Records contact from the leader elected by `vote`. Returns `false` if `known` or a granted
    /// vote supersedes that leader.
    pub(super) fn record_leader(&self, vote: &Vote, known: &Vote) -> bool {
        self.record_contact(&mut self.lock(), vote, known)
    }

    fn record_contact(&self, state: &mut ContactState, vote: &Vote, known: &Vote) -> bool {
        let is_current = state.record_leader(vote, known);
        if is_current {
            self.lost.send_if_modified(|lost| lost.take().is_some());
        }
        is_current
    }

    /// Answers a heartbeat request of a leader. An acknowledgement binds this node as an append
    /// does. So it is given only if this node is not about to vote, and is not stuck.
    pub(super) fn answer_heartbeat(&self, vote: &Vote, known: &Vote) -> HeartbeatReply {
        let mut state = self.lock();
        let busy = state.pending_appends > 0;
        let stuck = busy && state.append_progress.elapsed() >= APPEND_TIMEOUT;
        let follows = state.pending_votes == 0 && !stuck && self.record_contact(&mut state, vote, known);
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
        self.lock().end_contact();
    }

    /// Records that `leader` is lost: this node is no longer bound to it, and stops waiting for its
    /// contact. Returns `false` if the last contact is from another leader, or not before
    /// `asked_at`. A node that has had no contact since its start may be bound to another leader.
    pub(super) fn record_leader_lost(&self, leader: RaftId, asked_at: Instant) -> bool {
        let mut state = self.lock();
        let is_lost = state.leader == Some(leader) && state.last_contact < asked_at;
        if is_lost {
            state.end_contact();
            self.lost.send_replace(Some(leader));
        }
        is_lost
    }

    /// Checks whether this node has lost `leader`, and has had no contact with a leader since.
    pub(super) fn has_lost(&self, leader: RaftId) -> bool {
        *self.lost.borrow() == Some(leader)
    }

    /// Waits until this node has lost its leader, and returns the leader.
    pub(super) async fn wait_leader_lost(&self) -> RaftId {
        let mut changes = self.lost.subscribe();
        let lost = changes.wait_for(Option::is_some).await.ok().and_then(|lost| *lost);
        match lost {
            Some(leader) => leader,
            None => std::future::pending().await, // never: `self` has the sender
        }
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
            self.leader = leader_id_of(vote).map(|leader_id| leader_id.leader);
        }
        is_current
    }

    /// Ends the bond to the leader, and the wait for its contact.
    fn end_contact(&mut self) {
        self.bound_at = None;
        self.last_contact = self.last_contact.checked_sub(Duration::from_secs(60)).unwrap_or(self.last_contact);
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

#[cfg(test)]
mod tests {
    use super::*;

    const ELECTION_MIN: Duration = Duration::from_millis(300);

    #[tokio::test(start_paused = true)]
    async fn a_lost_leader_binds_no_vote_until_it_makes_contact_again() {
        let [leader, other] = [RaftId(1), RaftId(2)];
        let vote = Vote::new_committed(5, leader);
        let contact = LeaderContact::new();
        let wait = Duration::from_millis(1);
        tokio::time::sleep(wait).await;
        assert!(!contact.record_leader_lost(leader, Instant::now()), "the former leader is unknown after a start");
        assert!(contact.record_leader(&vote, &vote));
        assert!(!contact.record_leader_lost(leader, Instant::now()), "a message has arrived since");
        tokio::time::sleep(wait).await;
        assert!(!contact.record_leader_lost(other, Instant::now()));
        assert!(!contact.try_begin_vote(ELECTION_MIN));

        assert!(contact.record_leader_lost(leader, Instant::now()));
        assert!(contact.has_lost(leader) && !contact.has_lost(other));
        assert_eq!(contact.wait_leader_lost().await, leader);
        assert!(contact.no_leader_for(ELECTION_MIN, wait));

        assert!(contact.record_leader(&vote, &vote));
        assert!(!contact.has_lost(leader) && !contact.no_leader_for(ELECTION_MIN, wait));
        assert!(!contact.try_begin_vote(ELECTION_MIN));
    }
}
