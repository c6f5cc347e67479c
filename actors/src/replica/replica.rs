//! A node's share in the replicated ledger.

use super::canvass::{self, Ear};
use super::gather::{Gatherer, Proposal};
use super::journal::Journal;
use super::network::{Acks, Heard, Switchboard};
use super::runtime::seed_elections;
use super::serve::Service;
use super::settings::{ReplicaSettings, SettingsError};
use super::store::{self, Applied, MachineStore};
use super::succession::{self, Resigned, Succession};
use super::types::{Epoch, Peer, Raft, RaftId, Reign, StateMachine, epoch_of, reign_of};
use crate::bus::{BusError, SharedBus};
use consort_protocol::codec::{self, CodecError};
use consort_protocol::ids::{ClusterId, NodeId};
use consort_protocol::keys::Keys;
use consort_protocol::mutants::{self, Mutant};
use openraft::error::{
    ChangeMembershipError, CheckIsLeaderError, ClientWriteError, Fatal, ForwardToLeader, InitializeError, RaftError,
};
use openraft::{ChangeMembers, ServerState};
use std::collections::{BTreeMap, BTreeSet};
use std::future::Future;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::task::JoinHandle;
use tokio::time::{Instant, timeout};
use tracing::info;

type Metrics = openraft::RaftMetrics<RaftId, Peer>;

/// Bytes of a message that are left for its frame when it carries one entry of commands.
const FRAME_OVERHEAD: usize = 1024;

/// Bytes that a command may have.
const COMMAND_MAX: usize = codec::LIMIT - FRAME_OVERHEAD;

/// Bytes up to which commands share an entry: a follower must read it, bring it to disk and answer within a heartbeat, on a
/// slow machine too. Entries of 63 KiB did not come through on a machine that was busy with much else.
const SHARED_MAX: usize = 16 * 1024;

/// Who leads, as this node believes. A watch shows the latest belief; a reign that came and went in between is seen
/// by the next one's being greater.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Leadership {
    /// This node's term. It also grows by candidacies that fail.
    pub term: u64,
    /// The reign this node accepts at present, its own included; `None` while it knows of none, or has lost its
    /// majority. A node that is cut off as an observer goes on believing in the last it heard of.
    pub reign: Option<Reign>,
    /// The name of the reign's leader, if this node knows its membership yet.
    pub leader: Option<NodeId>,
    /// Whether this node leads, holds all that was committed before its reign, and has been acknowledged by a majority
    /// not longer ago than [`ReplicaSettings::quorum_silence_max`].
    pub is_me: bool,
    /// Whether this node was elected but hears no majority: it must not act, and a proposal is refused at once.
    pub cut_off: bool,
    /// Who votes.
    pub voters: BTreeMap<RaftId, NodeId>,
    /// While voters are being changed: those that vote in the end. Until then, a majority of the former ones counts too.
    pub changing_to: Option<BTreeSet<RaftId>>,
    /// Who is replicated to without a vote.
    pub observers: BTreeMap<RaftId, NodeId>,
}

impl Leadership {
    fn without_reign(self) -> Leadership {
        Leadership { reign: None, leader: None, is_me: false, cut_off: false, ..self }
    }
}

/// Why a node could not take part. Nothing runs.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// Our own mistake, or that of the configuration.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The journal cannot be read, is not whole, or is of another release.
    #[error("the journal in {place} cannot be taken up: {problem}")]
    Journal {
        /// Where it is.
        place: String,
        /// What is wrong.
        problem: std::io::Error,
    },
    /// The bus is closed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// What openraft says of the stored state.
    #[error("the stored state cannot be taken up: {0}")]
    Raft(#[from] Fatal<RaftId>),
}

/// Why the fleet's first voters were not written down. Nothing was changed.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum BootstrapError {
    /// Ordinary: this was done before, or a leader has been here already.
    #[error("this node already belongs to a fleet")]
    Already,
    /// Our own mistake.
    #[error("{0} is not among the first voters")]
    NotMember(RaftId),
    /// The replica has stopped.
    #[error("the replica has stopped")]
    Closed,
}

/// Why a command was not acknowledged. Only after [`ProposeError::TimedOut`] is it open what became of it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ProposeError {
    /// Ordinary. It was not proposed here, or was replaced by another leader's entry: it will not happen by this
    /// call.
    #[error("the leader is {}", leader.as_ref().map_or("unknown", NodeId::as_str))]
    NotLeader {
        /// Whom to ask instead, as far as this node knows.
        leader: Option<NodeId>,
    },
    /// This node was elected but hears no majority. It was not proposed.
    #[error("no quorum: {reachable} of {voters} voters reachable")]
    NoQuorum {
        /// Voters that answered something sent within the last two heartbeats, this one included.
        reachable: usize,
        /// All voters.
        voters: usize,
    },
    /// It was proposed and is not committed yet. **Its outcome is unknown**: it may yet be committed, now or by the
    /// next leader. Look for its effect in the ledger, or propose something that may happen twice.
    #[error("not committed within {limit:?}: whether it will be is unknown")]
    TimedOut {
        /// The time it was given.
        limit: Duration,
    },
    /// Our own mistake, or a mission of absurd size. It was not proposed.
    #[error("a command of {size} bytes exceeds the {max} that one message may carry")]
    TooLarge {
        /// Its encoded size.
        size: usize,
        /// The limit.
        max: usize,
    },
    /// It cannot be written down; our own mistake. It was not proposed.
    #[error("the command cannot be encoded: {0}")]
    Unencodable(String),
    /// The replica has stopped, on request or because its journal failed. After a failure the outcome is unknown.
    #[error("the replica has stopped")]
    Closed,
}

/// Why the membership was not changed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MemberError {
    /// As for any other entry of the log; after [`ProposeError::TimedOut`] the change may yet happen.
    #[error(transparent)]
    Propose(#[from] ProposeError),
    /// An earlier change is not committed yet. Nothing was changed; try again later.
    #[error("another change of membership is under way")]
    InProgress,
    /// Our own mistake: a voter must be an observer first. Nothing was changed.
    #[error("{0} is no observer")]
    NotObserver(RaftId),
    /// Our own mistake: somebody must vote. Nothing was changed.
    #[error("no voters would be left")]
    NobodyLeft,
}

/// Why a leader goes without a successor.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum HandOverError {
    /// Ordinary: there is nothing to hand over.
    #[error("this node does not lead")]
    NotLeader,
    /// When this node goes, so does the ledger, until it comes back.
    #[error("this node is the only voter: nobody can take over")]
    Alone,
    /// This node leads on. Ordinary where the others are dead already, or too far behind.
    #[error("none of the other {others} voters had the whole ledger within {limit:?}")]
    NobodyReady {
        /// How many there are.
        others: usize,
        /// How long was waited for one.
        limit: Duration,
    },
    /// This node no longer leads; the others elect one of them when their patience ends.
    #[error("{successor} was to take over and does not answer")]
    Unheard {
        /// Who should have.
        successor: NodeId,
    },
    /// The replica has stopped.
    #[error("the replica has stopped")]
    Closed,
}

/// A node's share in the replicated ledger. Clones are the same share; when the last is dropped, the node falls
/// silent, as in a crash.
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
    settings: ReplicaSettings,
    raft: Raft<S>,
    machine: MachineStore<S>,
    leadership: watch::Sender<Leadership>,
    acked_at: watch::Receiver<Option<Instant>>,
    resigned: Arc<Resigned>,
    ear: Arc<Ear>,
    board: Switchboard,
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
        settings: ReplicaSettings,
        bus: SharedBus,
        journal: Arc<dyn Journal>,
        seed: u64,
    ) -> Result<Self, StartError> {
        Replica::start_observed(settings, bus, journal, seed, None).await
    }

    /// The same, and tells `applied` of every entry that this copy takes in.
    ///
    /// # Errors
    /// As [`Replica::start`].
    pub async fn start_observed(
        settings: ReplicaSettings,
        bus: SharedBus,
        journal: Arc<dyn Journal>,
        seed: u64,
        applied: Option<Applied<S>>,
    ) -> Result<Self, StartError> {
        let config = settings.to_config()?;
        let id = RaftId::of(&settings.node, journal.identity());
        let place = journal.place();
        let opened = store::open::<S>(journal, applied).await;
        let (log, machine) = opened.map_err(|problem| StartError::Journal { place, problem })?;
        let appended = log.appended();
        let keys = Keys::new(&settings.fleet);
        let queries = bus.serve(&keys.any_raft(id.0)).await?;
        let heard = Arc::<Heard>::default();
        let acks = Arc::new(watch::Sender::new(Acks::default()));
        let muted = Arc::<AtomicBool>::default();
        let board = Switchboard {
            bus,
            keys: keys.clone(),
            me: id,
            cluster: machine.cluster(),
            heard,
            acks: Arc::clone(&acks),
            pause: settings.heartbeat,
            muted: Arc::clone(&muted),
        };

        // Nothing is awaited between these two: openraft draws its timeout before `new` first waits.
        seed_elections(seed);
        let raft = Raft::<S>::new(id, config, board.clone(), log, machine.clone()).await?;

        let leadership = watch::Sender::new(Leadership::default());
        let resigned = Arc::<Resigned>::default();
        let (tell_acked, acked_at) = watch::channel(None);
        let watcher = Watcher {
            silence_max: settings.quorum_silence_max,
            election_max: settings.election_max,
            leadership: leadership.clone(),
            resigned: Arc::clone(&resigned),
            acked: tell_acked,
            muted,
            elected: None,
            fresh: true,
            acked_by_raft: None,
            me: id,
            acks: acks.subscribe(),
        };
        let watching = Task::spawn(watcher.run(raft.metrics()));
        let ear = Arc::new(Ear::new());
        let canvass = canvass::canvass(raft.clone(), board.clone(), Arc::clone(&ear), settings.clone(), seed);
        let canvassing = Task::spawn(canvass);
        let beating = Task::spawn(canvass::beat(raft.clone(), board.clone(), settings.heartbeat));
        let refused = Arc::<AtomicU64>::default();
        let service = Service {
            me: id,
            raft: raft.clone(),
            ear: Arc::clone(&ear),
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
        let gatherer = Gatherer { raft: raft.clone(), proposals: proposed, appended, size_max: SHARED_MAX };
        let gathering = Task::spawn(gatherer.run());
        info!(node = %settings.node, raft = %id, "takes part in the ledger");
        let inner = Inner {
            id,
            settings,
            raft,
            machine,
            leadership,
            acked_at,
            resigned,
            ear,
            board,
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
            RaftError::APIError(InitializeError::NotAllowed(_)) => BootstrapError::Already,
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
        let proposed = self.inner.proposals.send(Proposal { command, size, answer });
        proposed.map_err(|_| ProposeError::Closed)?;
        match timeout(limit, heard).await {
            Err(_) => Err(ProposeError::TimedOut { limit }),
            Ok(Err(_)) => Err(ProposeError::Closed),
            Ok(Ok(outcome)) => outcome,
        }
    }

    /// Who leads, now and whenever that changes.
    pub fn leadership(&self) -> watch::Receiver<Leadership> {
        self.inner.leadership.subscribe()
    }

    /// Which founding of the fleet's ledger this node's copy belongs to, once it says so.
    pub fn cluster(&self) -> watch::Receiver<Option<ClusterId>> {
        self.inner.machine.cluster()
    }

    /// How far behind the end of the log each voter and observer is, in entries; `None` for those that have not answered
    /// in this reign. Empty on a node that does not lead.
    pub fn lags(&self) -> BTreeMap<RaftId, Option<u64>> {
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
    pub fn quorum_age(&self) -> Option<Duration> {
        let resigned = self.inner.resigned.covers(self.inner.leadership.borrow().term);
        self.inner.acked_at.borrow().filter(|_| !resigned).map(|at| at.elapsed())
    }

    /// How long ago the last message was sent that each other voter and observer has answered. Only a leader asks
    /// them regularly.
    pub fn heard(&self) -> BTreeMap<RaftId, Option<Duration>> {
        let leadership = self.inner.leadership.borrow();
        let others = leadership.voters.keys().chain(leadership.observers.keys()).filter(|id| **id != self.inner.id);
        others.map(|id| (*id, self.inner.board.heard.last(*id).map(|at| at.elapsed()))).collect()
    }

    /// Questions of other nodes that could not be read or answered, counted since the start.
    pub fn refused(&self) -> u64 {
        self.inner.refused.load(Ordering::Relaxed)
    }

    /// Stands for election at once. Voters that heard their leader within `election_min` refuse all the same; a
    /// leader does nothing.
    ///
    /// # Errors
    /// [`ProposeError::Closed`].
    pub async fn stand(&self) -> Result<(), ProposeError> {
        self.inner.raft.trigger().elect().await.map_err(|_| ProposeError::Closed)
    }

    /// Takes a snapshot soon, whether or not it is due.
    ///
    /// # Errors
    /// [`ProposeError::Closed`].
    pub async fn snapshot(&self) -> Result<(), ProposeError> {
        self.inner.raft.trigger().snapshot().await.map_err(|_| ProposeError::Closed)
    }

    /// Has the ledger replicated to another node, without a vote. Does nothing if that is so already.
    ///
    /// # Errors
    /// [`MemberError`].
    pub async fn add_observer(&self, id: RaftId, name: NodeId, limit: Duration) -> Result<(), MemberError> {
        let node = BTreeMap::from([(id, Peer { name })]);
        self.change(ChangeMembers::AddNodes(node), true, limit).await
    }

    /// Makes `voters` the voters, by joint consensus. Each must be an observer or voter already; those left out are
    /// forgotten. Needs a majority of the old and of the new voters: a dead voter is never removed without a quorum.
    ///
    /// # Errors
    /// [`MemberError`].
    pub async fn set_voters(&self, voters: BTreeSet<RaftId>, limit: Duration) -> Result<(), MemberError> {
        self.change(ChangeMembers::ReplaceAllVoters(voters), false, limit).await
    }

    /// Forgets an observer.
    ///
    /// # Errors
    /// [`MemberError`].
    pub async fn remove_observer(&self, id: RaftId, limit: Duration) -> Result<(), MemberError> {
        self.change(ChangeMembers::RemoveNodes(BTreeSet::from([id])), true, limit).await
    }

    /// Gives the lead to another voter, which has all that this one has and is elected within a few round trips; to none of
    /// `shunned` unless there is nobody else. From the call on this node refuses proposals and no longer counts itself
    /// leader; it goes on voting and following. Waits `limit` at most for a voter that has everything.
    ///
    /// # Errors
    /// [`HandOverError`] says whether this node still leads.
    pub async fn hand_over(&self, shunned: &BTreeSet<NodeId>, limit: Duration) -> Result<NodeId, HandOverError> {
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
    pub async fn hand_over_to(&self, to: &BTreeSet<NodeId>, limit: Duration) -> Result<NodeId, HandOverError> {
        let pick = |latest: &Metrics| self.best_successor(latest, self.near(), |name| to.contains(name));
        self.hand_over_by(pick, limit).await
    }

    async fn hand_over_by(
        &self,
        pick: impl Fn(&Metrics) -> Option<RaftId>,
        limit: Duration,
    ) -> Result<NodeId, HandOverError> {
        let inner = &*self.inner;
        let mut metrics = inner.raft.metrics();
        let (vote, leads) = {
            let now = metrics.borrow_and_update();
            (now.vote, now.state == ServerState::Leader)
        };
        if !leads {
            return Err(HandOverError::NotLeader);
        }
        let term = vote.leader_id().term;
        let others = inner.leadership.borrow().voters.keys().filter(|id| **id != inner.id).count();
        if others == 0 {
            return Err(HandOverError::Alone);
        }
        inner.resigned.resign(term);
        inner.leadership.send_modify(|now| {
            if now.term == term {
                *now = now.clone().without_reign();
            }
        });
        let found = async {
            loop {
                let latest = metrics.borrow_and_update().clone();
                if latest.vote != vote {
                    return Err(HandOverError::NotLeader);
                }
                if let Some(successor) = pick(&latest) {
                    return Ok((successor, latest));
                }
                metrics.changed().await.map_err(|_| HandOverError::Closed)?;
            }
        };
        let nobody = Err(HandOverError::NobodyReady { others, limit });
        let (successor, latest) = match timeout(limit, found).await.unwrap_or(nobody) {
            Ok(found) => found,
            Err(problem) => {
                inner.resigned.take_back();
                return Err(problem);
            }
        };
        let membership = latest.membership_config.membership();
        let name = membership.get_node(&successor).map(|peer| peer.name.clone());
        let name = name.ok_or(HandOverError::Closed)?;
        let word = Succession { ends: vote, successor };
        inner.ear.note_resigned();
        if !succession::release(&inner.raft, &word).await {
            return Err(HandOverError::Closed);
        }
        info!(node = %inner.settings.node, term, successor = %name, "hands over");
        match succession::proclaim(&inner.board, membership.get_joint_config(), &word, inner.settings.heartbeat).await {
            true => Ok(name),
            false => Err(HandOverError::Unheard { successor: name }),
        }
    }

    /// The other voters that have answered of late.
    fn near(&self) -> BTreeMap<RaftId, NodeId> {
        let near = |id: &RaftId| {
            let heard = self.inner.board.heard.last(*id);
            *id != self.inner.id && heard.is_some_and(|at| at.elapsed() <= self.inner.settings.heartbeat * 2)
        };
        let mut voters = self.inner.leadership.borrow().voters.clone();
        voters.retain(|id, _| near(id));
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

    /// Waits until this replica has given up for good, and says why: its journal could not be read or written. After an
    /// ordinary [`shutdown`](Replica::shutdown), it waits for ever.
    pub async fn failed(&self) -> String {
        let mut metrics = self.inner.raft.metrics();
        loop {
            match &metrics.borrow_and_update().running_state {
                Ok(()) => {}
                Err(Fatal::Stopped) => break,
                Err(problem) => return problem.to_string(),
            }
            if metrics.changed().await.is_err() {
                return "its task has died".to_owned();
            }
        }
        std::future::pending().await
    }

    /// Stops taking part. The journal is at rest when it returns.
    pub async fn shutdown(&self) {
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
            Ok(Err(error)) => Err(write_error(error)),
            Ok(Ok(_)) => Ok(()),
        }
    }

    fn refuse_when_cut_off(&self) -> Result<(), ProposeError> {
        let cut_off = self.inner.leadership.borrow().cut_off;
        if cut_off { Err(self.no_quorum()) } else { Ok(()) }
    }

    fn refuse_when_resigned(&self) -> Result<(), ProposeError> {
        let leadership = self.inner.leadership.borrow();
        if self.inner.resigned.covers(leadership.term) {
            return Err(ProposeError::NotLeader { leader: leadership.leader.clone() });
        }
        Ok(())
    }

    fn no_quorum(&self) -> ProposeError {
        let leadership = self.inner.leadership.borrow();
        let near = |id: &&RaftId| {
            let heard = self.inner.board.heard.last(**id);
            **id == self.inner.id || heard.is_some_and(|at| at.elapsed() <= self.inner.settings.heartbeat * 2)
        };
        let reachable = leadership.voters.keys().filter(near).count();
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

fn not_leader(other: ForwardToLeader<RaftId, Peer>) -> ProposeError {
    ProposeError::NotLeader { leader: other.leader_node.map(|peer| peer.name) }
}

fn write_error(error: RaftError<RaftId, ClientWriteError<RaftId, Peer>>) -> MemberError {
    match error {
        RaftError::APIError(ClientWriteError::ForwardToLeader(other)) => not_leader(other).into(),
        RaftError::APIError(ClientWriteError::ChangeMembershipError(error)) => match error {
            ChangeMembershipError::InProgress(_) => MemberError::InProgress,
            ChangeMembershipError::EmptyMembership(_) => MemberError::NobodyLeft,
            ChangeMembershipError::LearnerNotFound(missing) => MemberError::NotObserver(missing.node_id),
        },
        RaftError::Fatal(_) => ProposeError::Closed.into(),
    }
}

impl ProposeError {
    /// Why an entry of commands was not committed.
    pub(super) fn from_write(error: ClientWriteError<RaftId, Peer>) -> ProposeError {
        match write_error(RaftError::APIError(error)) {
            MemberError::Propose(error) => error,
            MemberError::InProgress | MemberError::NotObserver(_) | MemberError::NobodyLeft => {
                unreachable!("openraft answers so to a change of membership only")
            }
        }
    }
}

/// Turns openraft's metrics into [`Leadership`], doubts it when the majority falls silent, and then mutes the node.
struct Watcher {
    silence_max: Duration,
    election_max: Duration,
    leadership: watch::Sender<Leadership>,
    resigned: Arc<Resigned>,
    acked: watch::Sender<Option<Instant>>,
    muted: Arc<AtomicBool>,
    /// The reign in which this node was elected, if it leads, and since when it knows.
    elected: Option<(Reign, Instant)>,
    /// Whether the metrics are new: the ages in them count from when they came.
    fresh: bool,
    acked_by_raft: Option<Instant>,
    me: RaftId,
    acks: watch::Receiver<Acks>,
}

impl Watcher {
    async fn run(mut self, mut metrics: watch::Receiver<Metrics>) {
        loop {
            self.fresh |= metrics.has_changed().unwrap_or(false);
            let latest = metrics.borrow_and_update().clone();
            if std::mem::take(&mut self.fresh) {
                // Metrics are sent at the instant they are taken, and openraft takes them at every event. Its whole
                // milliseconds round the age down, so one is added.
                let age = latest.millis_since_quorum_ack.map(|ms| Duration::from_millis(ms + 1));
                self.acked_by_raft = age.and_then(|age| Instant::now().checked_sub(age));
            }
            let mut acked = self.acked_by_raft;
            if latest.state == ServerState::Leader {
                let halves = latest.membership_config.membership().get_joint_config();
                acked = acked.max(self.acks.borrow_and_update().majority(&latest.vote, self.me, halves));
            }
            self.acked.send_replace(acked);
            let elected_at = self.note_election(&latest);
            if self.believe_until_changed(&latest, acked, elected_at, &mut metrics).await.is_err() {
                break;
            }
        }
        self.acked.send_replace(None);
        self.leadership.send_modify(|now| {
            *now = Leadership { term: now.term, ..Leadership::default() };
        });
    }

    /// Since when this node leads, if it does.
    fn note_election(&mut self, latest: &Metrics) -> Option<Instant> {
        let reign = reign_of(&latest.vote).filter(|_| latest.state == ServerState::Leader);
        if self.elected.map(|(reign, _)| reign) != reign {
            self.elected = reign.map(|reign| (reign, Instant::now()));
        }
        self.elected.map(|(_, at)| at)
    }

    /// Tells what follows from `latest`, and what no longer does once the majority has been silent for too long.
    async fn believe_until_changed(
        &mut self,
        latest: &Metrics,
        acked: Option<Instant>,
        elected_at: Option<Instant>,
        metrics: &mut watch::Receiver<Metrics>,
    ) -> Result<(), watch::error::RecvError> {
        // A fresh leader has not been acknowledged yet; that is no silence to complain of, for a while.
        let Some(doubt_at) = acked.or(elected_at).map(|at| at + self.silence_max) else {
            self.muted.store(false, Ordering::Relaxed);
            self.tell(latest, Quorum::Unknown);
            return self.news(metrics).await;
        };
        if doubt_at > Instant::now() {
            self.muted.store(false, Ordering::Relaxed);
            self.tell(latest, if acked.is_some() { Quorum::Hears } else { Quorum::Unknown });
            tokio::select! {
                biased;
                changed = self.news(metrics) => return changed,
                () = tokio::time::sleep_until(doubt_at) => {}
            }
        }
        if mutants::is(Mutant::DeafLeader) {
            self.tell(latest, Quorum::Hears);
            return self.news(metrics).await;
        }
        // Metrics come with each beat, so this is looked at often enough.
        self.muted.store(self.falls_silent(doubt_at.elapsed()), Ordering::Relaxed);
        self.tell(latest, Quorum::Silent);
        self.news(metrics).await
    }

    /// Waits for openraft's metrics, or for an answer beside it.
    async fn news(&mut self, metrics: &mut watch::Receiver<Metrics>) -> Result<(), watch::error::RecvError> {
        tokio::select! {
            biased;
            changed = metrics.changed() => {
                self.fresh = true;
                changed
            }
            answered = self.acks.changed() => answered,
        }
    }

    /// Whether a leader says nothing at `doubted` after it began to doubt its majority: four times the longest
    /// election timeout, in which any other majority finds a leader, then once that time aloud, and so on.
    fn falls_silent(&self, doubted: Duration) -> bool {
        let round = self.election_max * 5;
        doubted.as_nanos() % round.as_nanos().max(1) < (self.election_max * 4).as_nanos()
    }

    fn tell(&self, metrics: &Metrics, quorum: Quorum) {
        let mut next = believe(metrics, quorum);
        self.leadership.send_if_modified(|now| {
            // Asked here, under the watch's lock: whoever resigns does so first and then takes that lock.
            if self.resigned.covers(next.term) {
                next = std::mem::take(&mut next).without_reign();
            }
            let changed = *now != next;
            if changed {
                *now = next;
            }
            changed
        });
    }
}

/// What an elected leader knows of its majority.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Quorum {
    /// Not acknowledged yet, or not elected.
    Unknown,
    Hears,
    Silent,
}

/// What a node believes, given openraft's metrics and what is known of its majority.
fn believe(metrics: &Metrics, quorum: Quorum) -> Leadership {
    let running = metrics.running_state.is_ok() && metrics.state != ServerState::Shutdown;
    let reign = reign_of(&metrics.vote).filter(|_| running && metrics.vote.is_committed());
    let elected = running && metrics.state == ServerState::Leader;
    // The first entry of a reign is openraft's blank one: once it is applied, so is all that was committed before.
    let caught_up = reign.is_some() && metrics.last_applied.map(|at| at.leader_id.term) == reign.map(|now| now.term);
    let cut_off = elected && quorum == Quorum::Silent;
    let reign = reign.filter(|_| !cut_off);
    let membership = metrics.membership_config.membership();
    let name = |id: RaftId| membership.get_node(&id).map(|peer| peer.name.clone());
    let named = |ids: Vec<RaftId>| ids.into_iter().filter_map(|id| Some((id, name(id)?))).collect();
    Leadership {
        term: metrics.current_term,
        reign,
        leader: reign.and_then(|reign| name(reign.leader)),
        is_me: elected && caught_up && quorum == Quorum::Hears,
        cut_off,
        voters: named(membership.voter_ids().collect()),
        changing_to: membership.get_joint_config().get(1).cloned(),
        observers: named(membership.learner_ids().collect()),
    }
}
