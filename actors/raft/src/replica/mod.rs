//! Replica of the ledger on a node.

mod membership;
mod start;
mod transfer;

use crate::errors::{BootstrapError, ProposeError, not_leader};
use crate::group_commit::Proposal;
use crate::leader_contact::LeaderContact;
use crate::leadership_view::{LeadershipView, ResignedTerm};
use crate::network::RaftClient;
use crate::settings::RaftSettings;
use crate::staleness::AnnouncedCommits;
use crate::storage::StateMachineStore;
use crate::types::{Epoch, Peer, Raft, RaftId, StateMachine, epoch_of};
use consort_bus::BootInstant;
use consort_protocol::codec::{self, CodecError};
use consort_protocol::ids::{ClusterId, NodeId};
use openraft::error::{CheckIsLeaderError, Fatal, InitializeError, RaftError};
use std::collections::BTreeMap;
use std::future::Future;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::task::JoinHandle;
use tokio::time::timeout;

/// Bytes of a message reserved for its frame when it carries a single entry of commands.
const FRAME_OVERHEAD: usize = 1024;

/// Size limit of a command, in bytes.
const COMMAND_MAX: usize = codec::MESSAGE_BYTES_MAX - FRAME_OVERHEAD;

/// Replica of the ledger on this node. Clones share the same replica. When the last clone is
/// dropped, the node stops replying, as in a crash.
pub struct Replica<S: StateMachine> {
    inner: Arc<Inner<S>>,
}

impl<S: StateMachine> Clone for Replica<S> {
    fn clone(&self) -> Self {
        Replica { inner: Arc::clone(&self.inner) }
    }
}

struct Inner<S: StateMachine> {
    id: RaftId,
    settings: RaftSettings,
    raft: Raft<S>,
    machine: StateMachineStore<S>,
    leadership: LeadershipState,
    announced_commits: Arc<AnnouncedCommits>,
    client: RaftClient,
    rejected: Arc<AtomicU64>,
    proposals: mpsc::UnboundedSender<Proposal<S>>,
    tasks: ReplicaTasks,
}

/// Leadership as seen by this node.
struct LeadershipState {
    view: watch::Sender<LeadershipView>,
    quorum_ack: watch::Receiver<Option<BootInstant>>,
    resigned_term: Arc<ResignedTerm>,
    leader_contact: Arc<LeaderContact>,
}

impl LeadershipState {
    /// Withdraws the leader of `term` from the view of this node.
    fn withdraw_leader(&self, term: u64) {
        self.view.send_modify(|now| {
            if now.term == term {
                *now = now.clone().without_leader();
            }
        });
    }
}

/// Tasks around openraft, aborted with the replica.
struct ReplicaTasks {
    group_commit: Task,
    server: Task,
    #[expect(dead_code, reason = "held until the replica is dropped")]
    monitor: Task,
    elections: Task,
    leader_watch: Task,
    heartbeats: Task,
    log_limit: Task,
}

/// Task that is aborted when its owner is dropped.
struct Task(JoinHandle<()>);

impl Task {
    fn spawn(work: impl Future<Output = ()> + Send + 'static) -> Self {
        Task(tokio::spawn(work))
    }
}

impl Drop for Task {
    fn drop(&mut self) {
        self.0.abort();
    }
}

impl<S: StateMachine> Replica<S> {
    /// Returns the Raft id of this node and its store.
    pub fn id(&self) -> RaftId {
        self.inner.id
    }

    /// Bootstraps the cluster with its first voters, and campaigns. Several of these voters may
    /// call it with exactly the same voters; a call with other voters would create a second
    /// cluster.
    ///
    /// # Errors
    /// [`BootstrapError`]: nothing was changed.
    pub async fn bootstrap(&self, members: BTreeMap<RaftId, NodeId>) -> Result<(), BootstrapError> {
        let members: BTreeMap<_, _> = members.into_iter().map(|(id, name)| (id, Peer { name })).collect();
        self.inner.raft.initialize(members).await.map_err(|error| match error {
            RaftError::APIError(InitializeError::NotAllowed(_)) => BootstrapError::AlreadyBootstrapped,
            RaftError::APIError(InitializeError::NotInMembers(_)) => BootstrapError::NotMember(self.inner.id),
            RaftError::Fatal(_) => BootstrapError::Closed,
        })
    }

    /// Proposes `command`, waits until it is committed and applied, and returns the result of the
    /// state machine. `limit` bounds the whole call: openraft itself would wait for a quorum
    /// without a limit.
    ///
    /// # Errors
    /// [`ProposeError`]: after [`ProposeError::TimedOut`] **the outcome is unknown**.
    pub async fn propose(&self, command: S::Command, limit: Duration) -> Result<S::Outcome, ProposeError> {
        let size = check_size(&command)?;
        self.check_quorum()?;
        self.check_not_resigned()?;
        let (reply, outcome) = oneshot::channel();
        let sent = self.inner.proposals.send(Proposal { command, size, reply });
        sent.map_err(|_| ProposeError::Closed)?;
        match timeout(limit, outcome).await {
            Err(_) => Err(ProposeError::TimedOut { limit }),
            Ok(Err(_)) => Err(ProposeError::Closed),
            Ok(Ok(outcome)) => outcome,
        }
    }

    /// Returns a watch of this node's view of the leadership.
    pub fn leadership(&self) -> watch::Receiver<LeadershipView> {
        self.inner.leadership.view.subscribe()
    }

    /// Returns a watch of the cluster that this replica's ledger belongs to; `None` until the
    /// ledger records it.
    pub fn cluster(&self) -> watch::Receiver<Option<ClusterId>> {
        self.inner.machine.cluster()
    }

    /// Returns the replication lag of each voter and learner behind the end of the log, in entries;
    /// `None` for a member that has not replied in this term. Empty on a node that is not the
    /// leader.
    pub fn replication_lags(&self) -> BTreeMap<RaftId, Option<u64>> {
        let metrics = self.inner.raft.metrics();
        let now = metrics.borrow();
        let last = now.last_log_index.unwrap_or(0);
        let lag = |matched: &openraft::LogId<RaftId>| last.saturating_sub(matched.index);
        let replication = now.replication.iter().flatten();
        replication.map(|(id, matched)| (*id, matched.as_ref().map(lag))).collect()
    }

    /// Returns a watch of the position of the last entry applied on this node.
    pub fn applied(&self) -> watch::Receiver<Epoch> {
        self.inner.machine.applied()
    }

    /// Calls `inspect` with this node's state, which may lag behind the leader's. Applying waits
    /// meanwhile.
    pub fn read<R>(&self, inspect: impl FnOnce(&S) -> R) -> R {
        self.inner.machine.read(inspect)
    }

    /// Same as [`Replica::read`], but also passes the position of the last applied entry.
    pub fn read_with_position<R>(&self, inspect: impl FnOnce(Epoch, &S) -> R) -> R {
        self.inner.machine.read_with_position(inspect)
    }

    /// Returns a copy of this node's state and the position of the last entry applied to it, if
    /// any.
    pub fn copy(&self) -> (Option<Epoch>, S)
    where
        S: Clone,
    {
        self.inner.machine.copy()
    }

    /// Confirms with a majority that this node is still the leader, and waits until it has applied
    /// all entries that were committed at the time of the request. A [`Replica::read`] after that
    /// is linearizable.
    ///
    /// # Errors
    /// [`ProposeError`]; nothing was changed in any case.
    pub async fn ensure_leader(&self, limit: Duration) -> Result<(), ProposeError> {
        let confirmed = async {
            let (committed, _) = self.inner.raft.get_read_log_id().await.map_err(|error| match error {
                RaftError::APIError(CheckIsLeaderError::ForwardToLeader(other)) => not_leader(other),
                RaftError::APIError(CheckIsLeaderError::QuorumNotEnough(_)) => self.no_quorum(),
                RaftError::Fatal(_) => ProposeError::Closed,
            })?;
            let committed = committed.as_ref().map(epoch_of).unwrap_or_default();
            let caught_up = self.applied().wait_for(|applied| *applied >= committed).await.is_ok();
            if caught_up { Ok(()) } else { Err(ProposeError::Closed) }
        };
        timeout(limit, confirmed).await.unwrap_or(Err(ProposeError::TimedOut { limit }))
    }

    /// Returns the age of the newest message that a majority has acknowledged in this term, counted
    /// from the time it was *sent*; `None` for a node that is not elected, or not acknowledged yet.
    ///
    /// Each voter of that majority rejects candidates for `election_min` after *receiving* the
    /// message, so no other leader is elected before this age exceeds `election_min`. The exception
    /// is a majority that has lost this leader: its presence token and its service. In no case was
    /// another leader elected before the message was sent. A suspension of the machine counts.
    /// Heartbeats outside openraft count like its appends, and keep the age small while disks are
    /// slow. While idle, the age is between one round trip and a heartbeat interval plus one round
    /// trip.
    pub fn quorum_ack_age(&self) -> Option<Duration> {
        let has_resigned = self.inner.leadership.resigned_term.covers(self.inner.leadership.view.borrow().term);
        self.inner.leadership.quorum_ack.borrow().filter(|_| !has_resigned).map(|at| at.elapsed())
    }

    /// Returns the staleness of this node's state: a [`Replica::read`] from now on contains
    /// everything that was committed at least that long ago. `None` if this node has neither led nor
    /// followed a leader since its start.
    ///
    /// A follower counts from the arrival of the leader's message, so the delay of that message
    /// comes on top; so does the time for which a leader that lost its majority continues, at most
    /// the check-quorum timeout.
    pub fn staleness(&self) -> Option<Duration> {
        let applied = *self.applied().borrow();
        let leads_since = self.leadership().borrow().term;
        // Until a leader has applied an entry of its own term, it may lack entries of the term before.
        let as_leader = self.quorum_ack_age().filter(|_| applied.term >= leads_since);
        as_leader.or_else(|| self.inner.announced_commits.staleness(applied))
    }

    /// Returns the age of the last message that each other voter and learner has replied to,
    /// counted from the time it was sent. Only a leader contacts them regularly.
    pub fn last_contacts(&self) -> BTreeMap<RaftId, Option<Duration>> {
        let leadership = self.inner.leadership.view.borrow();
        let others = leadership.voters.keys().chain(leadership.learners.keys()).filter(|id| **id != self.inner.id);
        others.map(|id| (*id, self.inner.client.last_contacts.of(*id).map(|at| at.elapsed()))).collect()
    }

    /// Returns the number of requests of other nodes that could not be decoded or served since the
    /// start.
    pub fn rejected_requests(&self) -> u64 {
        self.inner.rejected.load(Ordering::Relaxed)
    }

    /// Waits until this replica has failed for good, and returns the reason: its log store could
    /// not be read or written. After an ordinary [`shutdown`](Replica::shutdown), it never returns.
    pub async fn wait_failed(&self) -> String {
        // The reason is in the last metrics before the core ends. The watch ends with the core.
        let mut server_metrics = self.inner.raft.server_metrics();
        while server_metrics.changed().await.is_ok() {}
        match &self.inner.raft.metrics().borrow().running_state {
            Ok(()) => return "the task of openraft has ended unexpectedly".to_owned(),
            Err(Fatal::Stopped) => {}
            Err(problem) => return problem.to_string(),
        }
        std::future::pending().await
    }

    /// Stops the replica. From the call on this node no longer counts itself leader. No write to the log
    /// store is in progress when it returns.
    pub async fn shutdown(&self) {
        // The other voters elect another leader as soon as nothing serves the requests of this node.
        let term = self.inner.leadership.view.borrow().term;
        self.inner.leadership.resigned_term.resign(term);
        self.inner.leadership.withdraw_leader(term);
        // A request to openraft after its end would log an error.
        let ReplicaTasks { group_commit, server, elections, leader_watch, heartbeats, log_limit, .. } =
            &self.inner.tasks;
        for task in [group_commit, server, elections, leader_watch, heartbeats, log_limit] {
            task.0.abort();
        }
        // The only possible error: the task of openraft has ended already.
        let _ = self.inner.raft.shutdown().await;
    }

    fn check_quorum(&self) -> Result<(), ProposeError> {
        let lost_quorum = self.inner.leadership.view.borrow().lost_quorum;
        if lost_quorum { Err(self.no_quorum()) } else { Ok(()) }
    }

    fn check_not_resigned(&self) -> Result<(), ProposeError> {
        let leadership = self.inner.leadership.view.borrow();
        if self.inner.leadership.resigned_term.covers(leadership.term) {
            return Err(ProposeError::NotLeader { leader: leadership.leader.clone() });
        }
        Ok(())
    }

    /// Checks whether another node has replied to a message sent within the last two heartbeat
    /// intervals.
    fn has_recent_contact(&self, id: RaftId) -> bool {
        let last_contact = self.inner.client.last_contacts.of(id);
        last_contact.is_some_and(|at| at.elapsed() <= self.inner.settings.heartbeat * 2)
    }

    fn no_quorum(&self) -> ProposeError {
        let leadership = self.inner.leadership.view.borrow();
        let in_contact = |id: RaftId| id == self.inner.id || self.has_recent_contact(id);
        let reachable = leadership.voters.keys().filter(|id| in_contact(**id)).count();
        ProposeError::NoQuorum { reachable, voters: leadership.voters.len() }
    }
}

/// Returns the encoded size of the command, in bytes.
fn check_size<C: serde::Serialize>(command: &C) -> Result<usize, ProposeError> {
    match codec::encode(command) {
        Ok(bytes) if bytes.len() <= COMMAND_MAX => Ok(bytes.len()),
        Ok(bytes) => Err(ProposeError::TooLarge { size: bytes.len(), max: COMMAND_MAX }),
        Err(CodecError::TooLarge { size, .. }) => Err(ProposeError::TooLarge { size, max: COMMAND_MAX }),
        Err(error) => Err(ProposeError::Unencodable(error.to_string())),
    }
}
