//! Replica of the ledger on a node.

use super::election::{self, LeaderContact};
use super::errors::{BootstrapError, MemberError, ProposeError, StartError, member_error, not_leader};
use super::group_commit::{GroupCommitter, Proposal};
use super::leadership_transfer::ResignedTerm;
use super::leadership_view::{LeadershipMonitor, LeadershipView, MetricsFeed};
use super::log_store::{LogStore, with_repair_advice};
use super::network::{LastContacts, LeaderAcks, RaftClient};
use super::runtime::seed_elections;
use super::server::RaftServer;
use super::settings::RaftSettings;
use super::storage::{self, ApplyObserver, StateMachineStore};
use super::types::{Epoch, Peer, Raft, RaftId, StateMachine, epoch_of};
use consort_bus::SharedBus;
use consort_protocol::codec::{self, CodecError};
use consort_protocol::ids::{ClusterId, NodeId};
use consort_protocol::keys::Keys;
use openraft::ChangeMembers;
use openraft::error::{CheckIsLeaderError, Fatal, InitializeError, RaftError};
use std::collections::{BTreeMap, BTreeSet};
use std::future::Future;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::task::JoinHandle;
use tokio::time::{Instant, timeout};
use tracing::info;

/// Bytes of a message reserved for its frame when it carries a single entry of commands.
const FRAME_OVERHEAD: usize = 1024;

/// Size limit of a command, in bytes.
const COMMAND_MAX: usize = codec::MESSAGE_BYTES_MAX - FRAME_OVERHEAD;

/// Size limit, in bytes, up to which commands share an entry. A slow link carries such an entry
/// within half a second, and a follower writes it quickly. With 64 clients that request missions,
/// about six commands share an entry.
const SHARED_ENTRY_MAX: usize = 16 * 1024;

/// Replica of the ledger on this node. Clones share the same replica. When the last clone is
/// dropped, the node stops replying, as in a crash.
pub struct Replica<S: StateMachine> {
    pub(super) inner: Arc<Inner<S>>,
}

impl<S: StateMachine> Clone for Replica<S> {
    fn clone(&self) -> Self {
        Replica { inner: Arc::clone(&self.inner) }
    }
}

pub(super) struct Inner<S: StateMachine> {
    pub(super) id: RaftId,
    pub(super) settings: RaftSettings,
    pub(super) raft: Raft<S>,
    machine: StateMachineStore<S>,
    pub(super) leadership: watch::Sender<LeadershipView>,
    quorum_ack: watch::Receiver<Option<Instant>>,
    pub(super) resigned_term: Arc<ResignedTerm>,
    pub(super) leader_contact: Arc<LeaderContact>,
    pub(super) client: RaftClient,
    rejected: Arc<AtomicU64>,
    proposals: mpsc::UnboundedSender<Proposal<S>>,
    _group_commit: Task,
    _server: Task,
    _monitor: Task,
    _elections: Task,
    _heartbeats: Task,
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
    /// Starts a replica from the state in `log_store`. `seed` determines the randomized election
    /// timeouts; every node needs a different seed.
    ///
    /// # Errors
    /// [`StartError`]: nothing runs.
    pub async fn start(
        settings: RaftSettings,
        bus: SharedBus,
        log_store: Arc<dyn LogStore>,
        seed: u64,
    ) -> Result<Self, StartError> {
        Replica::start_observed(settings, bus, log_store, seed, None).await
    }

    /// Starts a replica like [`Replica::start`], and calls `applied` for every entry that this
    /// replica applies.
    ///
    /// # Errors
    /// As [`Replica::start`].
    pub async fn start_observed(
        settings: RaftSettings,
        bus: SharedBus,
        log_store: Arc<dyn LogStore>,
        seed: u64,
        applied: Option<ApplyObserver<S>>,
    ) -> Result<Self, StartError> {
        let config = settings.to_config()?;
        let id = RaftId::of(&settings.node, log_store.identity());
        let (location, advice) = (log_store.location(), log_store.repair_advice());
        let opened = storage::open::<S>(log_store, applied).await;
        let start_error = |problem| StartError::LogStore { location, problem: with_repair_advice(problem, advice) };
        let (log, machine) = opened.map_err(start_error)?;
        let (appended, last_at_start) = (log.appended(), log.last());
        let keys = Keys::new(&settings.fleet);
        let queries = bus.serve(&keys.any_raft(id.0)).await?;
        let last_contacts = Arc::<LastContacts>::default();
        let acks = Arc::new(watch::Sender::new(LeaderAcks::default()));
        let appends_suspended = Arc::<AtomicBool>::default();
        let client = RaftClient {
            bus,
            keys: keys.clone(),
            me: id,
            cluster: machine.cluster(),
            last_contacts,
            acks: Arc::clone(&acks),
            retry_interval: settings.heartbeat,
            appends_suspended: Arc::clone(&appends_suspended),
        };

        // No await between these two lines: openraft draws its timeout before the first await of
        // `new`.
        seed_elections(seed);
        let raft = Raft::<S>::new(id, config, client.clone(), log, machine.clone()).await?;

        let leadership = watch::Sender::new(LeadershipView::default());
        let resigned_term = Arc::<ResignedTerm>::default();
        let (quorum_ack_sender, quorum_ack) = watch::channel(None);
        let monitor = LeadershipMonitor {
            check_quorum_timeout: settings.check_quorum_timeout,
            election_max: settings.election_max,
            leadership: leadership.clone(),
            resigned_term: Arc::clone(&resigned_term),
            quorum_ack: quorum_ack_sender,
            appends_suspended,
            last_at_start,
            election: None,
            metrics_are_new: true,
            quorum_ack_by_metrics: None,
            me: id,
            acks: acks.subscribe(),
            published_inputs: None,
        };
        let monitor_task =
            Task::spawn(monitor.run(MetricsFeed { metrics: raft.metrics(), server_metrics: raft.server_metrics() }));
        let leader_contact = Arc::new(LeaderContact::new());
        let elections =
            election::run_elections(raft.clone(), client.clone(), Arc::clone(&leader_contact), settings.clone(), seed);
        let election_task = Task::spawn(elections);
        let heartbeat_task = Task::spawn(election::send_heartbeats(raft.clone(), client.clone(), settings.heartbeat));
        let rejected = Arc::<AtomicU64>::default();
        let server = RaftServer {
            me: id,
            raft: raft.clone(),
            leader_contact: Arc::clone(&leader_contact),
            leadership: leadership.subscribe(),
            election_min: settings.election_min,
            heartbeat: settings.heartbeat,
            rejected: Arc::clone(&rejected),
            keys,
            cluster: machine.cluster(),
            followed: OnceLock::new(),
        };
        let server_task = Task::spawn(server.run(queries));
        let (proposals, proposal_queue) = mpsc::unbounded_channel();
        let committer =
            GroupCommitter { raft: raft.clone(), proposals: proposal_queue, appended, size_max: SHARED_ENTRY_MAX };
        let group_commit = Task::spawn(committer.run());
        info!(node = %settings.node, raft = %id, "replica started");
        let inner = Inner {
            id,
            settings,
            raft,
            machine,
            leadership,
            quorum_ack,
            resigned_term,
            leader_contact,
            client,
            rejected,
            proposals,
            _group_commit: group_commit,
            _server: server_task,
            _monitor: monitor_task,
            _elections: election_task,
            _heartbeats: heartbeat_task,
        };
        Ok(Replica { inner: Arc::new(inner) })
    }

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
        self.inner.leadership.subscribe()
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
    /// openraft takes the time at which each `AppendEntries` was sent, keeps the latest
    /// acknowledged time per voter and its own clock for itself, and reports the latest time that a
    /// majority reaches. No other leader can have been elected before this age exceeds
    /// `election_min`, since each voter of that majority rejects candidates for that long after
    /// *receiving* the message. The value is read from the metrics and rounded up (by 1 ms at
    /// most). Heartbeats outside openraft count in the same way, and keep the age small while disks
    /// are slow. While idle, the age is between one round trip and a heartbeat interval plus one
    /// round trip.
    pub fn quorum_ack_age(&self) -> Option<Duration> {
        let has_resigned = self.inner.resigned_term.covers(self.inner.leadership.borrow().term);
        self.inner.quorum_ack.borrow().filter(|_| !has_resigned).map(|at| at.elapsed())
    }

    /// Returns the age of the last message that each other voter and learner has replied to,
    /// counted from the time it was sent. Only a leader contacts them regularly.
    pub fn last_contacts(&self) -> BTreeMap<RaftId, Option<Duration>> {
        let leadership = self.inner.leadership.borrow();
        let others = leadership.voters.keys().chain(leadership.learners.keys()).filter(|id| **id != self.inner.id);
        others.map(|id| (*id, self.inner.client.last_contacts.of(*id).map(|at| at.elapsed()))).collect()
    }

    /// Returns the number of requests of other nodes that could not be decoded or served since the
    /// start.
    pub fn rejected_requests(&self) -> u64 {
        self.inner.rejected.load(Ordering::Relaxed)
    }

    /// Campaigns at once. Voters with leader contact within `election_min` still reject; a leader
    /// does nothing.
    ///
    /// # Errors
    /// [`ProposeError::Closed`].
    pub async fn campaign(&self) -> Result<(), ProposeError> {
        self.inner.raft.trigger().elect().await.map_err(|_| ProposeError::Closed)
    }

    /// Requests a snapshot soon, even if it is not due.
    ///
    /// # Errors
    /// [`ProposeError::Closed`].
    pub async fn trigger_snapshot(&self) -> Result<(), ProposeError> {
        self.inner.raft.trigger().snapshot().await.map_err(|_| ProposeError::Closed)
    }

    /// Adds a node as a learner: the ledger is replicated to it, and it does not vote. Does nothing
    /// if it is a member already.
    ///
    /// # Errors
    /// [`MemberError`].
    pub async fn add_learner(&self, id: RaftId, name: NodeId, limit: Duration) -> Result<(), MemberError> {
        let node = BTreeMap::from([(id, Peer { name })]);
        self.change(ChangeMembers::AddNodes(node), true, limit).await
    }

    /// Replaces the voters by `voters`, by joint consensus. Each must be a learner or voter
    /// already; voters left out are removed from the membership. Needs a majority of the old and of
    /// the new voters: a dead voter is never removed without a quorum. A leader that is left out
    /// transfers leadership to one of the new voters.
    ///
    /// # Errors
    /// [`MemberError`].
    pub async fn set_voters(&self, voters: BTreeSet<RaftId>, limit: Duration) -> Result<(), MemberError> {
        let stays = voters.contains(&self.inner.id);
        self.change(ChangeMembers::ReplaceAllVoters(voters), false, limit).await?;
        if !stays {
            // openraft makes it step down at its next tick, within three seconds. If no voter takes
            // over, that is soon enough.
            let _ = self.transfer_leadership(&BTreeSet::new(), self.inner.settings.election_max).await;
        }
        Ok(())
    }

    /// Removes a learner.
    ///
    /// # Errors
    /// [`MemberError`].
    pub async fn remove_learner(&self, id: RaftId, limit: Duration) -> Result<(), MemberError> {
        self.change(ChangeMembers::RemoveNodes(BTreeSet::from([id])), true, limit).await
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

    /// Stops the replica. No write to the log store is in progress when it returns.
    pub async fn shutdown(&self) {
        // A request to openraft after its end would log an error.
        let Inner { _group_commit, _server, _elections, _heartbeats, .. } = &*self.inner;
        for task in [_group_commit, _server, _elections, _heartbeats] {
            task.0.abort();
        }
        // The only possible error: the task of openraft has ended already.
        let _ = self.inner.raft.shutdown().await;
    }

    async fn change(
        &self,
        change: ChangeMembers<RaftId, Peer>,
        retain: bool,
        limit: Duration,
    ) -> Result<(), MemberError> {
        self.check_quorum()?;
        self.check_not_resigned()?;
        match timeout(limit, self.inner.raft.change_membership(change, retain)).await {
            Err(_) => Err(ProposeError::TimedOut { limit }.into()),
            Ok(Err(error)) => Err(member_error(error)),
            Ok(Ok(_)) => Ok(()),
        }
    }

    fn check_quorum(&self) -> Result<(), ProposeError> {
        let lost_quorum = self.inner.leadership.borrow().lost_quorum;
        if lost_quorum { Err(self.no_quorum()) } else { Ok(()) }
    }

    fn check_not_resigned(&self) -> Result<(), ProposeError> {
        let leadership = self.inner.leadership.borrow();
        if self.inner.resigned_term.covers(leadership.term) {
            return Err(ProposeError::NotLeader { leader: leadership.leader.clone() });
        }
        Ok(())
    }

    /// Checks whether another node has replied to a message sent within the last two heartbeat
    /// intervals.
    pub(super) fn has_recent_contact(&self, id: RaftId) -> bool {
        let last_contact = self.inner.client.last_contacts.of(id);
        last_contact.is_some_and(|at| at.elapsed() <= self.inner.settings.heartbeat * 2)
    }

    fn no_quorum(&self) -> ProposeError {
        let leadership = self.inner.leadership.borrow();
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
