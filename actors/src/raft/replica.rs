//! A node's share in the replicated ledger.

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
use crate::bus::SharedBus;
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

/// Bytes of a message that are left for its frame when it carries one entry of commands.
const FRAME_OVERHEAD: usize = 1024;

/// Bytes that a command may have.
const COMMAND_MAX: usize = codec::MESSAGE_BYTES_MAX - FRAME_OVERHEAD;

/// Bytes up to which commands share an entry: a slow link carries it within half a second, and a follower is soon through
/// with it. With 64 clients who ask for missions, half a dozen share one.
const SHARED_MAX: usize = 16 * 1024;

/// A node's share in the replicated ledger. Clones are the same share; when the last is dropped, the node falls
/// silent, as in a crash.
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
    acked_at: watch::Receiver<Option<Instant>>,
    pub(super) resigned_term: Arc<ResignedTerm>,
    pub(super) leader_contact: Arc<LeaderContact>,
    pub(super) client: RaftClient,
    refused: Arc<AtomicU64>,
    proposals: mpsc::UnboundedSender<Proposal<S>>,
    _gathering: Task,
    _serving: Task,
    _watching: Task,
    _canvassing: Task,
    _beating: Task,
}

/// A task that ends with its owner.
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
    /// Takes part with what `journal` holds. `seed` decides how long it waits for a leader: nodes need different ones.
    ///
    /// # Errors
    /// [`StartError`]: nothing runs.
    pub async fn start(
        settings: RaftSettings,
        bus: SharedBus,
        journal: Arc<dyn LogStore>,
        seed: u64,
    ) -> Result<Self, StartError> {
        Replica::start_observed(settings, bus, journal, seed, None).await
    }

    /// The same, and tells `applied` of every entry that this copy takes in.
    ///
    /// # Errors
    /// As [`Replica::start`].
    pub async fn start_observed(
        settings: RaftSettings,
        bus: SharedBus,
        journal: Arc<dyn LogStore>,
        seed: u64,
        applied: Option<ApplyObserver<S>>,
    ) -> Result<Self, StartError> {
        let config = settings.to_config()?;
        let id = RaftId::of(&settings.node, journal.identity());
        let (place, advice) = (journal.location(), journal.repair_advice());
        let opened = storage::open::<S>(journal, applied).await;
        let not_whole =
            |problem| StartError::LogStore { location: place, problem: with_repair_advice(problem, advice) };
        let (log, machine) = opened.map_err(not_whole)?;
        let (appended, found) = (log.appended(), log.last());
        let keys = Keys::new(&settings.fleet);
        let queries = bus.serve(&keys.any_raft(id.0)).await?;
        let heard = Arc::<LastContacts>::default();
        let acks = Arc::new(watch::Sender::new(LeaderAcks::default()));
        let muted = Arc::<AtomicBool>::default();
        let board = RaftClient {
            bus,
            keys: keys.clone(),
            me: id,
            cluster: machine.cluster(),
            last_contacts: heard,
            acks: Arc::clone(&acks),
            retry_interval: settings.heartbeat,
            appends_suspended: Arc::clone(&muted),
        };

        // Nothing is awaited between these two: openraft draws its timeout before `new` first waits.
        seed_elections(seed);
        let raft = Raft::<S>::new(id, config, board.clone(), log, machine.clone()).await?;

        let leadership = watch::Sender::new(LeadershipView::default());
        let resigned = Arc::<ResignedTerm>::default();
        let (tell_acked, acked_at) = watch::channel(None);
        let watcher = LeadershipMonitor {
            check_quorum_timeout: settings.check_quorum_timeout,
            election_max: settings.election_max,
            leadership: leadership.clone(),
            resigned_term: Arc::clone(&resigned),
            quorum_ack: tell_acked,
            appends_suspended: muted,
            last_at_start: found,
            election: None,
            metrics_are_new: true,
            quorum_ack_by_metrics: None,
            me: id,
            acks: acks.subscribe(),
            published_inputs: None,
        };
        let watching =
            Task::spawn(watcher.run(MetricsFeed { metrics: raft.metrics(), server_metrics: raft.server_metrics() }));
        let ear = Arc::new(LeaderContact::new());
        let canvass = election::run_elections(raft.clone(), board.clone(), Arc::clone(&ear), settings.clone(), seed);
        let canvassing = Task::spawn(canvass);
        let beating = Task::spawn(election::send_heartbeats(raft.clone(), board.clone(), settings.heartbeat));
        let refused = Arc::<AtomicU64>::default();
        let service = RaftServer {
            me: id,
            raft: raft.clone(),
            leader_contact: Arc::clone(&ear),
            leadership: leadership.subscribe(),
            election_min: settings.election_min,
            heartbeat: settings.heartbeat,
            refused: Arc::clone(&refused),
            keys,
            cluster: machine.cluster(),
            followed: OnceLock::new(),
        };
        let serving = Task::spawn(service.run(queries));
        let (proposals, proposed) = mpsc::unbounded_channel();
        let gatherer = GroupCommitter { raft: raft.clone(), proposals: proposed, appended, size_max: SHARED_MAX };
        let gathering = Task::spawn(gatherer.run());
        info!(node = %settings.node, raft = %id, "takes part in the ledger");
        let inner = Inner {
            id,
            settings,
            raft,
            machine,
            leadership,
            acked_at,
            resigned_term: resigned,
            leader_contact: ear,
            client: board,
            refused,
            proposals,
            _gathering: gathering,
            _serving: serving,
            _watching: watching,
            _canvassing: canvassing,
            _beating: beating,
        };
        Ok(Replica { inner: Arc::new(inner) })
    }

    /// This node and its store, as Raft counts them.
    pub fn id(&self) -> RaftId {
        self.inner.id
    }

    /// Writes down the fleet's first voters, and stands for election. More than one of them may do it, with the very
    /// same voters; other voters would found a second fleet.
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

    /// Has `command` committed and applied, and gives what the state machine answered. The whole takes `limit` at
    /// most: openraft itself would wait for a quorum for ever.
    ///
    /// # Errors
    /// [`ProposeError`]: after [`ProposeError::TimedOut`] **the outcome is unknown**.
    pub async fn propose(&self, command: S::Command, limit: Duration) -> Result<S::Outcome, ProposeError> {
        let size = check_size(&command)?;
        self.refuse_when_cut_off()?;
        self.refuse_when_resigned()?;
        let (answer, heard) = oneshot::channel();
        let proposed = self.inner.proposals.send(Proposal { command, size, reply: answer });
        proposed.map_err(|_| ProposeError::Closed)?;
        match timeout(limit, heard).await {
            Err(_) => Err(ProposeError::TimedOut { limit }),
            Ok(Err(_)) => Err(ProposeError::Closed),
            Ok(Ok(outcome)) => outcome,
        }
    }

    /// Who leads, now and whenever that changes.
    pub fn leadership(&self) -> watch::Receiver<LeadershipView> {
        self.inner.leadership.subscribe()
    }

    /// Which founding of the fleet's ledger this node's copy belongs to, once it says so.
    pub fn cluster(&self) -> watch::Receiver<Option<ClusterId>> {
        self.inner.machine.cluster()
    }

    /// How far behind the end of the log each voter and observer is, in entries; `None` for those that have not answered
    /// in this reign. Empty on a node that does not lead.
    pub fn replication_lags(&self) -> BTreeMap<RaftId, Option<u64>> {
        let metrics = self.inner.raft.metrics();
        let now = metrics.borrow();
        let last = now.last_log_index.unwrap_or(0);
        let lag = |matched: &openraft::LogId<RaftId>| last.saturating_sub(matched.index);
        let replication = now.replication.iter().flatten();
        replication.map(|(id, matched)| (*id, matched.as_ref().map(lag))).collect()
    }

    /// The place of the last entry applied on this node, now and whenever it grows.
    pub fn applied(&self) -> watch::Receiver<Epoch> {
        self.inner.machine.applied()
    }

    /// What `look` sees in this node's state, which may lag behind the leader's. Applying waits meanwhile.
    pub fn read<R>(&self, look: impl FnOnce(&S) -> R) -> R {
        self.inner.machine.read(look)
    }

    /// A copy of this node's state, with the place of the last entry that is in it, if there is one.
    pub fn copy(&self) -> (Option<Epoch>, S)
    where
        S: Clone,
    {
        self.inner.machine.copy()
    }

    /// Asks a majority whether this node still leads, and waits until it has applied all that was committed when
    /// they were asked. A [`Replica::read`] after that is linearizable.
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

    /// How long ago the newest message was *sent* that a majority has acknowledged in this reign; `None` for a node
    /// that is not elected, or not acknowledged yet.
    ///
    /// openraft takes the time at which each `AppendEntries` was sent, keeps the latest acknowledged one per voter
    /// and its own clock for itself, and gives the latest that a majority reaches. No other leader can have been
    /// elected before this age exceeds `election_min`, since each of that majority refuses candidates for so long
    /// after *receiving* the message. It is read from the metrics, rounded so as to seem older (by 1 ms at most). Beats
    /// beside openraft count alike, and keep it small while disks are slow.
    /// Idle, it swings between one round trip and a heartbeat plus one round trip.
    pub fn quorum_ack_age(&self) -> Option<Duration> {
        let resigned = self.inner.resigned_term.covers(self.inner.leadership.borrow().term);
        self.inner.acked_at.borrow().filter(|_| !resigned).map(|at| at.elapsed())
    }

    /// How long ago the last message was sent that each other voter and observer has answered. Only a leader asks
    /// them regularly.
    pub fn last_contacts(&self) -> BTreeMap<RaftId, Option<Duration>> {
        let leadership = self.inner.leadership.borrow();
        let others = leadership.voters.keys().chain(leadership.learners.keys()).filter(|id| **id != self.inner.id);
        others.map(|id| (*id, self.inner.client.last_contacts.of(*id).map(|at| at.elapsed()))).collect()
    }

    /// Questions of other nodes that could not be read or answered, counted since the start.
    pub fn rejected_requests(&self) -> u64 {
        self.inner.refused.load(Ordering::Relaxed)
    }

    /// Stands for election at once. Voters that heard their leader within `election_min` refuse all the same; a
    /// leader does nothing.
    ///
    /// # Errors
    /// [`ProposeError::Closed`].
    pub async fn campaign(&self) -> Result<(), ProposeError> {
        self.inner.raft.trigger().elect().await.map_err(|_| ProposeError::Closed)
    }

    /// Takes a snapshot soon, whether or not it is due.
    ///
    /// # Errors
    /// [`ProposeError::Closed`].
    pub async fn trigger_snapshot(&self) -> Result<(), ProposeError> {
        self.inner.raft.trigger().snapshot().await.map_err(|_| ProposeError::Closed)
    }

    /// Has the ledger replicated to another node, without a vote. Does nothing if that is so already.
    ///
    /// # Errors
    /// [`MemberError`].
    pub async fn add_learner(&self, id: RaftId, name: NodeId, limit: Duration) -> Result<(), MemberError> {
        let node = BTreeMap::from([(id, Peer { name })]);
        self.change(ChangeMembers::AddNodes(node), true, limit).await
    }

    /// Makes `voters` the voters, by joint consensus. Each must be an observer or voter already; those left out are
    /// forgotten. Needs a majority of the old and of the new voters: a dead voter is never removed without a quorum. A leader
    /// that is left out hands over to one of them.
    ///
    /// # Errors
    /// [`MemberError`].
    pub async fn set_voters(&self, voters: BTreeSet<RaftId>, limit: Duration) -> Result<(), MemberError> {
        let stays = voters.contains(&self.inner.id);
        self.change(ChangeMembers::ReplaceAllVoters(voters), false, limit).await?;
        if !stays {
            // openraft has it step down at its next tick, within three seconds. If nobody takes over, that is soon enough.
            let _ = self.transfer_leadership(&BTreeSet::new(), self.inner.settings.election_max).await;
        }
        Ok(())
    }

    /// Forgets an observer.
    ///
    /// # Errors
    /// [`MemberError`].
    pub async fn remove_learner(&self, id: RaftId, limit: Duration) -> Result<(), MemberError> {
        self.change(ChangeMembers::RemoveNodes(BTreeSet::from([id])), true, limit).await
    }

    /// Waits until this replica has given up for good, and says why: its journal could not be read or written. After an
    /// ordinary [`shutdown`](Replica::shutdown), it waits for ever.
    pub async fn wait_failed(&self) -> String {
        // It says so in the last metrics before it ends, and with it this watch.
        let mut standing = self.inner.raft.server_metrics();
        while standing.changed().await.is_ok() {}
        match &self.inner.raft.metrics().borrow().running_state {
            Ok(()) => return "its task has died".to_owned(),
            Err(Fatal::Stopped) => {}
            Err(problem) => return problem.to_string(),
        }
        std::future::pending().await
    }

    /// Stops taking part. The journal is at rest when it returns.
    pub async fn shutdown(&self) {
        // Whoever asked openraft for anything after its end would have it complain.
        let Inner { _gathering, _serving, _canvassing, _beating, .. } = &*self.inner;
        for task in [_gathering, _serving, _canvassing, _beating] {
            task.0.abort();
        }
        // The only error openraft could give is that its task is gone already.
        let _ = self.inner.raft.shutdown().await;
    }

    async fn change(
        &self,
        change: ChangeMembers<RaftId, Peer>,
        retain: bool,
        limit: Duration,
    ) -> Result<(), MemberError> {
        self.refuse_when_cut_off()?;
        self.refuse_when_resigned()?;
        match timeout(limit, self.inner.raft.change_membership(change, retain)).await {
            Err(_) => Err(ProposeError::TimedOut { limit }.into()),
            Ok(Err(error)) => Err(member_error(error)),
            Ok(Ok(_)) => Ok(()),
        }
    }

    fn refuse_when_cut_off(&self) -> Result<(), ProposeError> {
        let cut_off = self.inner.leadership.borrow().lost_quorum;
        if cut_off { Err(self.no_quorum()) } else { Ok(()) }
    }

    fn refuse_when_resigned(&self) -> Result<(), ProposeError> {
        let leadership = self.inner.leadership.borrow();
        if self.inner.resigned_term.covers(leadership.term) {
            return Err(ProposeError::NotLeader { leader: leadership.leader.clone() });
        }
        Ok(())
    }

    /// Whether another node has answered something that was sent within the last two heartbeats.
    pub(super) fn has_recent_contact(&self, id: RaftId) -> bool {
        let heard = self.inner.client.last_contacts.of(id);
        heard.is_some_and(|at| at.elapsed() <= self.inner.settings.heartbeat * 2)
    }

    fn no_quorum(&self) -> ProposeError {
        let leadership = self.inner.leadership.borrow();
        let near = |id: RaftId| id == self.inner.id || self.has_recent_contact(id);
        let reachable = leadership.voters.keys().filter(|id| near(**id)).count();
        ProposeError::NoQuorum { reachable, voters: leadership.voters.len() }
    }
}

/// The command's encoded size in bytes.
fn check_size<C: serde::Serialize>(command: &C) -> Result<usize, ProposeError> {
    match codec::encode(command) {
        Ok(bytes) if bytes.len() <= COMMAND_MAX => Ok(bytes.len()),
        Ok(bytes) => Err(ProposeError::TooLarge { size: bytes.len(), max: COMMAND_MAX }),
        Err(CodecError::TooLarge { size, .. }) => Err(ProposeError::TooLarge { size, max: COMMAND_MAX }),
        Err(error) => Err(ProposeError::Unencodable(error.to_string())),
    }
}
